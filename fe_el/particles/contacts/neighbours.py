"""Neighbour lists with a skin.

Particles are binned in one grid per class of reaches (each twice the one before): every particle searches its own class and
the coarser ones, or is searched by these if they are few, so the cost follows the number of neighbours however wide the
sizes spread.
"""
from typing import NamedTuple

import numpy as np

from fe_el.compiled.borrowed import borrowed
from fe_el.compiled.cache import njit
from fe_el.compiled.direct_calls import Direct
from fe_el.compiled.parts import part
from fe_el.particles.contacts.pair_batches import add_to_batch, batch_for, pairs_in_batch


class Grids(NamedTuple):
    """One grid of boxes per class of sizes."""

    lower: np.ndarray  #: (3,) corner [m]
    size: np.ndarray  #: (classes,) edge of a box [m]
    shape: np.ndarray  #: (classes, 3) boxes
    offset: np.ndarray  #: (classes + 1,) boxes before those of the class


class Cloud(NamedTuple):
    """Particles in the order of their boxes."""

    order: np.ndarray  #: (particles,) which they are
    rows: np.ndarray  #: (particles, 4) position and radius
    start: np.ndarray  #: (boxes + 1,) the first of each box


@njit
def morton_code(x, lower, size):
    """Bits of the box indices of each position, interleaved: boxes that are near in space are near in this order."""
    code = np.zeros(len(x), np.int64)
    for i in range(len(x)):
        for k in range(3):
            index = int((x[i, k] - lower[k]) / size)
            for bit in range(20):
                code[i] |= ((index >> bit) & 1) << (3 * bit + k)
    return code


@njit
def bounds(x):
    """Least and largest coordinates, and their difference, each (3,)."""
    out = np.empty((3, 3))
    for k in range(3):
        low, high = np.inf, -np.inf
        for i in range(len(x)):
            low, high = min(low, x[i, k]), max(high, x[i, k])
        out[0, k], out[1, k], out[2, k] = low, high, high - low
    return out


@njit
def _classes(radius, smallest, count):
    """Size class of each particle, numbered without the empty ones, and the largest radius of each class."""
    level, largest, number = np.empty(len(radius), np.int32), np.zeros(count), np.zeros(count, np.int32)
    for i in range(len(radius)):
        level[i], edge = 0, 2 * smallest
        while level[i] < count - 1 and radius[i] * (1 + 1e-12) >= edge:
            level[i], edge = level[i] + 1, 2 * edge
        largest[level[i]] = max(largest[level[i]], radius[i])
    there = largest > 0
    for k in range(1, count):
        number[k] = number[k - 1] + there[k - 1]
    for i in range(len(radius)):
        level[i] = number[level[i]]
    return level, largest[there]


@part
def _box(x, i, grids, g):
    """Indices of the box of a grid that holds particle i."""
    lower, size, shape = grids.lower, grids.size, grids.shape
    return (min(max(int((x[i, 0] - lower[0]) / size[g]), 0), shape[g, 0] - 1),
            min(max(int((x[i, 1] - lower[1]) / size[g]), 0), shape[g, 1] - 1),
            min(max(int((x[i, 2] - lower[2]) / size[g]), 0), shape[g, 2] - 1))


@Direct
@njit
def _sorted_by_box(x, radius, level, grids):
    """What a :class:`Cloud` holds, of particles of the given classes."""
    m, shape, offset = len(x), grids.shape, grids.offset
    start, box = np.zeros(offset[-1] + 1, np.uint64), np.empty(m, np.uint64)
    order, rows = np.empty(m, np.uint32), np.empty((m, 4))
    for i in range(m):
        g = level[i]
        a, b, c = _box(x, i, grids, g)
        box[i] = offset[g] + (a * shape[g, 1] + b) * shape[g, 2] + c
        start[box[i] + np.uint64(1)] += np.uint64(1)
    for k in range(offset[-1]):
        start[k + 1] += start[k]
    at = start.copy()
    for i in range(m):
        n = at[box[i]]
        at[box[i]] = n + np.uint64(1)
        order[n], rows[n, 0], rows[n, 1], rows[n, 2], rows[n, 3] = i, x[i, 0], x[i, 1], x[i, 2], radius[i]
    return order, rows, start


@part
def _pairs_with(n, begin, end, rows, order, owned, first, second, number):
    """Pairs of entry n with the entries from begin to end, one of the two owned; returns the number of pairs so far.

    Every candidate is written, and the next one over it unless it is a pair: a branch would be foretold wrongly too often.
    """
    x, y, z, reach, i = rows[n, 0], rows[n, 1], rows[n, 2], rows[n, 3], order[n]
    room = number + (end - begin) < np.uint64(len(first))  # beyond it pairs are only counted
    for k in range(begin, end):
        dx, dy, dz, r, j = rows[k, 0] - x, rows[k, 1] - y, rows[k, 2] - z, rows[k, 3] + reach, order[k]
        if room:
            first[number], second[number] = i, j
        number += np.uint64((dx * dx + dy * dy + dz * dz < r * r) & ((i < owned) | (j < owned)))
    return number


@part
def _few(start, size, offset):
    """Whether the particles of a coarser class are so few that they had better search the finer one: (finer, coarser)."""
    few = np.zeros((len(size), len(size)), np.bool_)
    for g in range(len(size)):
        for coarse in range(g + 1, len(size)):
            fine = float(start[offset[g + 1]] - start[offset[g]])
            number = float(start[offset[coarse + 1]] - start[offset[coarse]])
            few[g, coarse] = number * (size[coarse] / size[g] + 2) ** 2 < 9 * fine  # lines of boxes
    return few


@part
def _pairs_of_few(g, coarse, cloud, grids, owned, first, second, number):
    """Pairs of the particles of a coarser class with those of class g; returns the number of pairs so far."""
    order, rows, start = cloud.order, cloud.rows, cloud.start
    lower, size, shape, offset = grids.lower, grids.size, grids.shape, grids.offset
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for n in range(start[offset[coarse]], start[offset[coarse + 1]]):
        reach = rows[n, 3] + 0.5 * size[g]
        for k in range(3):
            low[k] = max(int((rows[n, k] - reach - lower[k]) / size[g]), 0)
            high[k] = min(int((rows[n, k] + reach - lower[k]) / size[g]), shape[g, k] - 1)
        for a in range(low[0], high[0] + 1):
            for b in range(low[1], high[1] + 1):
                at = offset[g] + (a * shape[g, 1] + b) * shape[g, 2]
                number = _pairs_with(n, start[at + low[2]], start[at + high[2] + 1], rows, order, owned, first, second,
                                     number)
    return number


@Direct
@njit
def _search(batch, cloud, grids, owned, first, second):
    """Fill the pairs that reach each other, one of the two owned; returns their number (beyond the capacity: only counted).

    Boxes that follow each other in the last direction follow each other in memory: their particles are one range.
    """
    batch, cloud, grids = borrowed((batch, cloud, grids))
    order, rows, start, size, shape, offset = cloud.order, cloud.rows, cloud.start, grids.size, grids.shape, grids.offset
    number, zero, seven, few = np.uint64(0), np.uint64(0), np.uint64(7), _few(start, size, offset)
    for g in range(len(size)):
        for box in range(offset[g], offset[g + 1]):
            if start[box] == start[box + 1]:
                continue
            line, c = (box - offset[g]) // shape[g, 2], (box - offset[g]) % shape[g, 2]
            a, b = line // shape[g, 1], line % shape[g, 1]
            low, high = max(c - 1, 0), min(c + 2, shape[g, 2])
            m = add_to_batch(zero, start[box], start[box - c + high], cloud, batch)
            for da, db in ((0, 1), (1, -1), (1, 0), (1, 1)):  # within a class half of the boxes around will do
                if a + da < shape[g, 0] and 0 <= b + db < shape[g, 1]:
                    at = offset[g] + ((a + da) * shape[g, 1] + b + db) * shape[g, 2]
                    m = add_to_batch(m, start[at + low], start[at + high], cloud, batch)
            full = (m + seven) // np.uint64(8) * np.uint64(8)
            for k in range(m, full):
                batch.x[k] = np.inf  # what fills up the last eight is near nothing
            for n in range(start[box], start[box + 1]):
                number = pairs_in_batch(n - start[box], full, batch, owned, first, second, number)
                for coarse in range(g + 1, len(size)):
                    if few[g, coarse]:
                        continue
                    p, q, r = _box(rows, n, grids, coarse)
                    low_r, high_r = max(r - 1, 0), min(r + 2, shape[coarse, 2])
                    for i in range(max(p - 1, 0), min(p + 2, shape[coarse, 0])):
                        for j in range(max(q - 1, 0), min(q + 2, shape[coarse, 1])):
                            at = offset[coarse] + (i * shape[coarse, 1] + j) * shape[coarse, 2]
                            number = _pairs_with(n, start[at + low_r], start[at + high_r], rows, order, owned, first, second,
                                                 number)
        for coarse in range(g + 1, len(size)):
            if few[g, coarse]:
                number = _pairs_of_few(g, coarse, cloud, grids, owned, first, second, number)
    return number


@njit
def _by_first(first, second, owned):
    """The pairs, the first one owned, in the order of that."""
    start = np.zeros(owned + 1, np.uint32)
    for k in range(len(first)):
        if first[k] >= owned:
            first[k], second[k] = second[k], first[k]
        start[first[k] + np.uint32(1)] += np.uint32(1)
    for i in range(owned):
        start[i + 1] += start[i]
    a, b = np.empty_like(first), np.empty_like(second)
    for k in range(len(first)):
        n = start[first[k]]
        a[n], b[n] = first[k], second[k]
        start[first[k]] = n + np.uint32(1)
    return a, b


def neighbour_pairs(x, radius, owned, expected=0):
    """Pairs (first, second) of spheres that overlap, each once, the first one owned, in the order of the first.

    Room is made for six a sphere, or ``expected`` pairs; where there are more, they are searched twice.
    """
    if owned == 0:
        return np.empty(0, np.uint32), np.empty(0, np.uint32)
    smallest, biggest = radius.min(), radius.max()
    level, largest = _classes(radius, smallest, int(np.log2(biggest / smallest * (1 + 1e-12))) + 1)
    lower, _, extent = bounds(x)
    size = 2 * largest
    shape = np.empty((len(size), 3), np.int64)
    for g in range(len(size)):
        while (extent / size[g] + 1).prod() > 4 * len(x) + 64:  # sparse clouds: no more boxes than particles need
            size[g] *= 1.3
        shape[g] = (extent / size[g]).astype(np.int64) + 1
    grids = Grids(lower, size, shape, np.concatenate([[0], np.cumsum(shape.prod(1))]))
    cloud = Cloud(*_sorted_by_box(x, radius, level, grids))
    batch = batch_for(cloud.start)
    most = len(x) + 8  # candidates of one particle, in whole eights
    capacity = max(6 * len(x), expected + len(x)) + 64
    first, second = np.empty(capacity, np.uint32), np.empty(capacity, np.uint32)
    number = _search(batch, cloud, grids, owned, first, second)
    if number + most > capacity:
        first, second = (np.empty(number + most, np.uint32) for _ in range(2))
        _search(batch, cloud, grids, owned, first, second)
    return _by_first(first[:number], second[:number], owned)


@njit
def gaps(x, radius, room, first, second):
    """Distance of the surfaces of each pair over the room of both, negative in contact."""
    gap = np.empty(len(first))
    for k in range(len(first)):
        i, j = first[k], second[k]
        dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
        gap[k] = (np.sqrt(dx * dx + dy * dy + dz * dz) - radius[i] - radius[j]) / (room[i] + room[j])
    return gap
