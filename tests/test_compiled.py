"""How loops are compiled, and kept."""
import ast
import gc
import os
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest
from numba.core import event

import fe_el
from fe_el.compiled.cache import njit
from fe_el.compiled.compile_time import compile_seconds
from fe_el.compiled.parts import part

PACKAGE = '''
import numpy as np
from fe_el.compiled import cache
cache.BASE, cache._file = {kept!r}, lambda module: {path!r}
cache._state = lambda path: "state"
from fe_el.compiled.parts import part

@part(fastmath=True)
def square(x):
    return x * x

@part
def squares(x):
    total = 0.0
    for k in range(len(x)):
        total += square(x[k])
    return total

@cache.njit
def norm(x):
    return np.sqrt(squares(x))

if __name__ == "__main__":
    print(norm(np.array([3.0, 4.0])), len(squares.signatures), len(norm.stats.cache_hits))
'''


@part
def twice(x):
    return 2 * x


@part(error_model="numpy")
def twice_over(x, y):
    return twice(x) / y


def test_a_part_is_compiled_into_its_callers():
    @njit
    def one(x):
        return twice_over(x, 4.0) + twice(1)

    @numba.njit
    def other(x):
        return twice_over(x, 0.0)
    assert one(6.0) == 5.0
    assert other(1.0) == np.inf
    assert twice.nopython_signatures and twice_over.nopython_signatures


def test_python_cannot_call_a_part():
    for _ in range(2):  # the second time it has been compiled
        with pytest.raises(KeyError, match="twice is compiled into loops that call it, Python cannot"):
            twice(1.0)


def decorated(function, *words):
    """Whether one of the words is among a function's decorators."""
    return any(word in ast.unparse(d) for d in function.decorator_list for word in words)


def uses(node, compiled=False):
    """Names that are used where Python runs, not the compiler."""
    if isinstance(node, ast.FunctionDef):
        compiled = compiled or decorated(node, "njit", "part", "by_dimension")
    if isinstance(node, ast.Name) and not compiled:
        yield node.id
    for child in ast.iter_child_nodes(node):
        yield from uses(child, compiled)


def test_python_code_of_the_package_calls_no_part():
    package = Path(fe_el.__file__).parent
    files = {".".join(file.relative_to(package.parent).with_suffix("").parts): ast.parse(file.read_text())
             for file in package.rglob("*.py")}
    parts = {module: {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) and decorated(node, "part")}
             for module, tree in files.items()}
    assert sum(map(len, parts.values())) > 50
    for module, tree in files.items():
        known = set(parts[module])
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom):
                known |= {a.asname or a.name for a in node.names if a.name in parts.get(node.module, ())}
        assert not known & set(uses(tree)), module


def test_errors_of_parts_reach_the_caller():
    @part
    def checked(x):
        if x < 0:
            raise ValueError("negative")
        return np.sqrt(x)

    @njit
    def root(x):
        return checked(x)
    assert root(4.0) == 2.0
    with pytest.raises(ValueError, match="negative"):
        root(-1.0)


def test_a_loop_is_kept_with_its_parts(tmp_path):
    script, kept = tmp_path / "loops.py", tmp_path / "kept"
    script.write_text(PACKAGE.format(kept=str(kept), path=str(script)))
    runs = [subprocess.run([sys.executable, script], capture_output=True, text=True, check=True,
                           env={**os.environ, "NUMBA_CACHE_DIR": str(kept)}).stdout.split() for _ in range(2)]
    assert runs == [["5.0", "1", "0"], ["5.0", "0", "1"]]
    assert {name.split(".")[1].split("-")[0] for _, _, files in os.walk(kept) for name in files} == {"norm"}


class Look(event.Listener):
    """Notes at each stage of the compiler whether garbage is collected."""

    def __init__(self, collects):
        self.collects = collects

    def on_start(self, event):
        self.collects.append(gc.isenabled())

    def on_end(self, event):
        self.collects.append(gc.isenabled())


def test_compilation_is_timed_and_garbage_waits():
    collects = []

    @numba.njit  # not kept, so it is compiled here in every run
    def sum_of(x):
        return x.sum() + twice(x[0])
    before = compile_seconds()
    with event.install_listener("numba:run_pass", Look(collects)):
        sum_of.compile((numba.float64[::1],))
    assert len(collects) > 20 and not any(collects) and gc.isenabled()
    assert compile_seconds() > before
    after = compile_seconds()
    sum_of(np.ones(3))
    assert compile_seconds() == after


def test_a_function_that_numba_refuses_leaves_no_trace():
    @njit
    def wrong(x):
        return x.nothing_of_the_kind
    with pytest.raises(numba.core.errors.TypingError):
        wrong(1.0)
    assert gc.isenabled()
