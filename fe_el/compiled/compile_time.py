"""How long numba compiles for, undisturbed by the collection of garbage.

Python looks for cycles of what is no longer needed again and again while the compiler makes new things, and each time goes
through all that there is: it has to wait until a loop is compiled.
"""
import gc
import time

from numba.core import event


class _Watch(event.Listener):
    """Wall time of all compilation so far; that of a loop contains that of the loops it calls."""

    def __init__(self):
        self.seconds, self._depth, self._start, self._collects = 0.0, 0, 0.0, False

    def on_start(self, event):
        if not self._depth:
            self._start, self._collects = time.perf_counter(), gc.isenabled()
            gc.disable()
        self._depth += 1

    def on_end(self, event):
        self._depth -= 1
        if not self._depth:
            self.seconds += time.perf_counter() - self._start
            if self._collects:
                gc.enable()


_watch = _Watch()
event.register("numba:compile", _watch)


def add(seconds):
    """Count what was waited for while another process compiled [s]."""
    _watch.seconds += seconds


def compile_seconds() -> float:
    """Wall time [s] that numba has compiled for in this process, or that was spent waiting for it."""
    return _watch.seconds
