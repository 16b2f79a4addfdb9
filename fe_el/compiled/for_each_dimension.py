"""Numba loops that are compiled once for triangles and once for tetrahedra, so that the loops inside a cell are unrolled."""
from types import FunctionType

import numpy as np

from fe_el.compiled.cache import njit
from fe_el.compiled.direct_calls import Direct

FAST = {"contract", "reassoc", "nsz", "arcp"}  # no finite-math assumption: NaN must stay visible
D, M = 3, 4  # dimension and corners of a cell; :func:`by_dimension` sets them in what it compiles


def by_dimension(function):
    """A function whose first argument is ``dofs`` (cells, corners), or a record that has them, compiled for each dimension
    with D and M as constants. Of records it should have ``dofs`` without a sign: no index is then checked for being
    negative."""
    versions = {}
    for d in (2, 3):
        copy = FunctionType(function.__code__, {**function.__globals__, "D": d, "M": d + 1}, function.__name__)
        # names of the cache's files
        copy.__qualname__, copy.__module__ = f"{function.__qualname__}_{d}d", function.__module__
        versions[d + 1] = Direct(njit(fastmath=FAST)(copy))

    def call(cells, *arguments):
        if isinstance(cells, np.ndarray):
            return versions[cells.shape[1]](cells.view(np.uint32), *arguments)
        return versions[cells.dofs.shape[1]](cells, *arguments)
    call.__doc__, call.__name__ = function.__doc__, function.__name__
    return call
