"""Rows that come and go in arrays of many: in place, in memory with room to grow, so that a step costs what changes."""
import numpy as np


def appended(a, new, room):
    """Array ``a`` with rows ``new`` behind it, in the memory ``room`` if that is what ``a`` lies in and is long enough, or
    in new memory an eighth longer; with that memory."""
    n, m = len(a), len(a) + len(new)
    if room is None or a.base is not room or a.ctypes.data != room.ctypes.data or len(room) < m:
        room = np.empty((m + m // 8, *a.shape[1:]), a.dtype)
        room[:n] = a
    room[n:m] = new
    return room[:m], room


def replaced(a, holes, new, room):
    """Array ``a`` whose rows ``holes`` (rising) are given to rows ``new``; what of these is left comes behind, what of the
    holes is left is filled with the last rows; with its memory, as :func:`appended`."""
    k = min(len(holes), len(new))
    a[holes[:k]] = new[:k]
    if len(new) > k:
        return appended(a, new[k:], room)
    holes, n = holes[k:], len(a) - len(holes) + k
    last = np.ones(len(a) - n, bool)
    last[holes[holes >= n] - n] = False
    a[holes[holes < n]] = a[n:][last]
    return a[:n], room
