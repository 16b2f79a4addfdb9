"""Calls of compiled functions with long tuples of arrays, step after step, without a leak.

Numba's dispatcher loses the text by which it recognises the type of an argument whenever that is long: 50 to 100 bytes for
each tuple of more than four arrays, named or not, in every call.
"""
import numpy as np

FLAGS = 0x1 | 0x2 | 0x100 | 0x400  # of an array: in the order of C, of Fortran, aligned, writeable


def _add_kinds(arguments, kinds):
    """Append what decides which compiled version takes some arguments."""
    for argument in arguments:
        if isinstance(argument, np.ndarray):
            kinds.append(argument.dtype.num << 16 | argument.ndim << 12 | argument.flags.num & FLAGS)
        elif isinstance(argument, tuple):
            kinds += type(argument), len(argument)
            _add_kinds(argument, kinds)
        else:
            kinds.append(type(argument))


class Direct:
    """A compiled function that finds its compiled version by itself once it has been called with arguments of the same
    kinds.

    Args:
        dispatcher: what ``njit`` returns.
    """

    def __init__(self, dispatcher):
        self.dispatcher, self._entries = dispatcher, {}

    def __call__(self, *arguments):
        kinds = []
        _add_kinds(arguments, kinds)
        kinds = tuple(kinds)
        entry = self._entries.get(kinds)
        if entry is not None:
            return entry(*arguments)
        result = self.dispatcher(*arguments)
        signature = tuple(self.dispatcher.typeof_pyval(a) for a in arguments)
        if signature in self.dispatcher.overloads:  # it may have converted some
            self._entries[kinds] = self.dispatcher.overloads[signature].entry_point
        return result
