"""A long compilation in a process of its own, on a second core, while the run compiles what it needs before that.

Done for a loop that is not in the cache yet, where there is a core to spare. The process has neither dolfinx nor MPI, and a
cache of its own, because two processes that write to the same list of compiled versions can mix them up. What it has made
moves to the run's cache in the end. If it fails, or is killed, the run compiles the loop itself.
"""
import atexit
import importlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from fe_el.compiled import compile_time
from fe_el.compiled.cache import BASE, ROOT
from fe_el.compiled.direct_calls import Direct

PATIENCE = 300  # seconds
START = """import sys
sys.path[:] = [sys.argv[1], *filter(None, sys.path)]  # not the folder that the run was started in
import types
sys.modules["fe_el.dolfinx_api"] = none = types.ModuleType("none")
none.__getattr__ = lambda name: None
import mpi4py
mpi4py.rc.initialize = False
from fe_el.compiled.ahead import compile_for
compile_for(*sys.argv[2:])
"""


def cores():
    """How many this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Ahead(Direct):
    """A compiled function whose types are known before it is called.

    Args:
        module, name: where this object is found.
        dispatcher: what ``njit`` returns.
        kinds: function that gives the types of its arguments.
    """

    def __init__(self, module, name, dispatcher, kinds):
        super().__init__(dispatcher)
        self.place, self.kinds, self.process, self.folder = (module, name), kinds, None, None

    def files(self):
        """What the cache has of it: machine code, then the list of it."""
        function = self.dispatcher.py_func
        names = f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}-*.nb[ci]"
        return sorted(Path(self.dispatcher.stats.cache_path).glob(names))

    def begin(self, wanted=True):
        """Start to compile it, if that is wanted and of use. A run on several ranks has no core to spare."""
        if not wanted or self.process or self.dispatcher.signatures or cores() < 2 or self.files():
            return
        try:
            os.makedirs(BASE, exist_ok=True)
            self.folder = tempfile.mkdtemp(prefix="ahead-", dir=BASE)
            self.process = subprocess.Popen(
                [sys.executable, "-c", START, str(ROOT), *self.place, self.dispatcher.stats.cache_path],
                stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                env={**os.environ, "NUMBA_CACHE_DIR": self.folder})
        except (OSError, TypeError):  # no Python to start
            shutil.rmtree(self.folder or "", ignore_errors=True)
            return
        atexit.register(self._end, 0)

    def _end(self, patience):
        """Wait for the process, and end it where it takes longer."""
        process, self.process = self.process, None
        if process is None:
            return
        try:
            process.wait(patience)
        except subprocess.TimeoutExpired:
            pass
        finally:  # also where the user interrupts
            process.kill()
            process.wait()
            process.stdin.close()
            shutil.rmtree(self.folder, ignore_errors=True)

    def __call__(self, *arguments):
        if self.process is not None:
            tick = time.perf_counter()
            self._end(PATIENCE)
            compile_time.add(time.perf_counter() - tick)
        return super().__call__(*arguments)


def _end_with_parent(folder):
    """End this process as soon as its parent has closed its input, or is gone."""
    os.read(0, 1)
    shutil.rmtree(folder, ignore_errors=True)
    os.kill(os.getpid(), signal.SIGKILL)


def compile_for(module, name, folder):
    """What the process does: compile, and move the result to another cache's folder."""
    own = os.environ["NUMBA_CACHE_DIR"]
    threading.Thread(target=_end_with_parent, args=(own,), daemon=True).start()
    loop = getattr(importlib.import_module(module), name)
    loop.dispatcher.compile(tuple(loop.kinds()))
    os.makedirs(folder, exist_ok=True)
    for file in loop.files():
        if file.suffix == ".nbi":  # no old list may name the new code
            (Path(folder) / file.name).unlink(missing_ok=True)
    for file in loop.files():
        os.replace(file, Path(folder) / file.name)
    shutil.rmtree(own, ignore_errors=True)
