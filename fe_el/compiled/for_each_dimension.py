"""Numba loops that are compiled once for triangles and once for tetrahedra, so that the loops inside a cell are unrolled."""
from types import FunctionType

import numpy as np

from fe_el.compiled.cache import njit

FAST = {"contract", "reassoc", "nsz", "arcp"}  # no finite-math assumption: NaN must stay visible
D, M = 3, 4  # dimension and corners of a cell; :func:`by_dimension` sets them in what it compiles


def by_dimension(function):
    """A function whose first argument is ``dofs`` (cells, corners), compiled for each dimension with D and M as
    constants."""
    versions = {}
    for d in (2, 3):
        copy = FunctionType(function.__code__, {**function.__globals__, "D": d, "M": d + 1}, function.__name__)
        # names of the cache's files
        copy.__qualname__, copy.__module__ = f"{function.__qualname__}_{d}d", function.__module__
        versions[d + 1] = njit(fastmath=FAST)(copy)

    def call(dofs, *arguments):
        # without a sign no index is checked for being negative
        return versions[dofs.shape[1]](dofs.view(np.uint32), *arguments)
    call.__doc__, call.__name__ = function.__doc__, function.__name__
    return call
