"""Several sub-steps in one pass over the memory, for beds that do not fit into the caches.

The particles are sorted by slabs. A slab can make its next sub-step as soon as its neighbours have made the last one, so a few
sub-steps follow each other through the bed like waves, a few slabs apart, and what they need stays in the caches. Every particle
gets its forces in the same order as in one sub-step after the other on the same lists: the results are the same to the last digit.
"""
import numpy as np
from numba import njit

from fe_el.particles import neighbours

FROM = 15000  # particles
SLAB = 500  # particles at least
FINE = 4  # slabs in the reach of a contact
AT_ONCE = 8  # sub-steps at most
IN_CACHE = 32000  # particles, with their contacts
NONE = (np.zeros(1, np.int64),) * 6 + (0, 1)


def slabs(position, period, reach):
    """Number of the slab of each particle, so that particles within ``reach`` are at most ``FINE + 1`` slabs apart.

    Slabs cut the direction that gives the thinnest; where it is periodic, two that are as far from the middle count as one.
    """
    lower, _, extent = neighbours.bounds(position)
    fold = np.array(period) > 0 if period is not None else np.zeros(3, bool)
    axis = int(np.argmax(extent / (1 + fold)))
    most = len(position) * (1 + fold[axis]) / SLAB
    length = period[axis] if fold[axis] else extent[axis]
    count = max(int(min(FINE * length / reach, most)), 1)
    origin = 0.0 if fold[axis] else lower[axis]
    slab = np.clip(((position[:, axis] - origin) / length * count).astype(np.int64), 0, count - 1)
    return np.minimum(slab, count - 1 - slab) if fold[axis] else slab


@njit(cache=True)
def by_slab(first, second, slab, count):
    """The pairs in the order of the later of their two slabs: pairs, where each slab's begin, how far apart slabs may be."""
    start, apart = np.zeros(count + 1, np.int64), 0
    for k in range(len(first)):
        a, b = slab[first[k]], slab[second[k]]
        start[max(a, b) + 1] += 1
        apart = max(apart, abs(a - b))
    for c in range(count):
        start[c + 1] += start[c]
    at, one, two = start.copy(), np.empty_like(first), np.empty_like(second)
    for k in range(len(first)):
        c = max(slab[first[k]], slab[second[k]])
        n = at[c]
        one[n], two[n] = first[k], second[k]
        at[c] = n + 1
    return one, two, start, apart


def at_once(particles, slabs, apart):
    """How many sub-steps may follow each other so that all particles between the first and the last stay in the caches."""
    return int(min(max(IN_CACHE * slabs / (particles * (apart + 1)), 2), AT_ONCE))


@njit(cache=True)
def wave_length(most, room, step, speed, change):
    """How many sub-steps keep displacements within ``room``, with twice the speed and its change there are now: (number, reach)."""
    number, ahead = 1, 0.0
    for n in range(2, most + 1):
        reach = 2 * n * step * (speed + n * change)
        if reach <= room:
            number, ahead = n, reach
    return number, ahead


@njit(cache=True)
def refresh_images(rows, source, shift, owned, x, state, force):
    """Set some of the periodic images to their particles."""
    for k in range(len(rows)):
        n = rows[k]
        i, g = source[n], owned + n
        for q in range(3):
            x[g, q] = x[i, q] + shift[n, q]
            state[g, 1 + q], state[g, 4 + q] = state[i, 1 + q], state[i, 4 + q]
        for q in range(8):
            force[g, q] = 0.0


@njit(cache=True)
def part_of(listed, number, at):
    """Where the entries of each slab begin among the first ``number`` of a list of places in the whole list."""
    out = np.empty(len(at), np.int64)
    for c in range(len(at)):
        low, high = 0, number
        while low < high:
            middle = (low + high) // 2
            if listed[middle] < at[c]:
                low = middle + 1
            else:
                high = middle
        out[c] = low
    return out
