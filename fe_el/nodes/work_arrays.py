"""Arrays that a step needs again and again."""
import numpy as np


class WorkArrays:
    """Hands out arrays by name, the same memory each time, so that a step asks the system for none."""

    def __init__(self):
        self._arrays = {}

    def empty(self, name, *shape):
        """Array with what the last user of the name left in it."""
        array = self._arrays.get(name)
        if array is None or array.shape != shape:
            array = self._arrays[name] = np.empty(shape)
        return array

    def zeros(self, name, *shape):
        """Array of zeros."""
        array = self.empty(name, *shape)
        array.fill(0.0)
        return array

    def other(self, name, than, *shape):
        """One of two arrays of the name, and not ``than``: for what is still read while the next is written."""
        array = self.empty((name, 0), *shape)
        return self.empty((name, 1), *shape) if array is than else array
