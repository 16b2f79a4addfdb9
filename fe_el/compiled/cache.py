"""numba's cache on disk, with a folder for each state of the sources that a loop is compiled from.

numba compares the file of a function alone: a loop of another file that was compiled into it may have changed unnoticed.
Here the folder's name is made from the file and from those it imports, through all loops, so an edit costs what depends on
it and nothing else, and a new version of the package never meets machine code of an old one. ``NUMBA_CACHE_DIR`` says where;
without it the folder is in the user's cache.
"""
import hashlib
import os
import re
from functools import lru_cache
from pathlib import Path

import numba
from numba.core import config

from fe_el.compiled import compile_time  # noqa: F401 (watches what is compiled)
from fe_el.compiled.parts import Compiler

ROOT = Path(__file__).parents[2]
IMPORT = re.compile(r"^ *(?:from (fe_el[.\w]*) import (.+)|import (fe_el[.\w]*))", re.MULTILINE)
COMPILED = re.compile("njit|compiled.parts|intrinsic")
BASE = config.CACHE_DIR or os.path.join(os.environ.get("XDG_CACHE_HOME", os.path.expanduser("~/.cache")), "fe_el", "numba")


def _file(module):
    path = ROOT / Path(*module.split("."))
    return path.with_suffix(".py") if path.with_suffix(".py").is_file() else None


@lru_cache(None)
def _imports(path):
    """Text of a file, and the files of the package that it imports."""
    text, files = path.read_text(), []
    for package, names, module in IMPORT.findall(text):
        below = [f"{package}.{name.split()[0]}" for name in names.split(",") if name.split()]
        files += [file for file in map(_file, [module or package, *below]) if file]
    return text, files


@lru_cache(None)
def _state(path):
    """Hash of a file and of what its loops are compiled from; a file without loops can only give constants."""
    seen, ahead = {}, [path]
    while ahead:
        file = ahead.pop()
        if file not in seen:
            seen[file], files = _imports(file)
            if file == path or COMPILED.search(seen[file]):
                ahead += files
    return hashlib.md5("".join(seen[file] for file in sorted(seen)).encode()).hexdigest()[:12]


def njit(*function, **options):
    """numba's ``njit(cache=True)`` with the cache described above; takes its options."""
    def compiled(function):
        kept, path = config.CACHE_DIR, _file(function.__module__)
        if path is not None:
            config.CACHE_DIR = os.path.join(BASE, numba.__version__, _state(path))
        try:
            return numba.njit(cache=True, pipeline_class=Compiler, no_cfunc_wrapper=True, **options)(function)
        finally:
            config.CACHE_DIR = kept
    return compiled(*function) if function else compiled
