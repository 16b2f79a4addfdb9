"""Neighbour lists with a skin, and the springs of contacts that survive their renewal.

Particles are binned in one grid per class of diameters (each twice the one before): every particle searches its own class
and the coarser ones, so the cost follows the number of neighbours however wide the size distribution is.
"""
import numpy as np
from numba import njit

NONE = np.uint32(2 ** 32 - 1)  # behind the last particle of a box; without a sign no index is checked for being negative


@njit(cache=True)
def morton_code(x, lower, size):
    """Bits of the box indices of each position, interleaved: boxes that are near in space are near in this order."""
    code = np.zeros(len(x), np.int64)
    for i in range(len(x)):
        for k in range(3):
            index = int((x[i, k] - lower[k]) / size)
            for bit in range(20):
                code[i] |= ((index >> bit) & 1) << (3 * bit + k)
    return code


@njit(cache=True)
def _classes(radius, smallest, count):
    """Size class of each particle, and the largest radius of each class."""
    level, largest = np.empty(len(radius), np.int32), np.zeros(count)
    for i in range(len(radius)):
        level[i] = min(int(np.log2(radius[i] / smallest * (1 + 1e-12))), count - 1)
        largest[level[i]] = max(largest[level[i]], radius[i])
    return level, largest


@njit(cache=True)
def _search(x, radius, level, owned, skin, lower, size, shape, offset, first, second):
    """Fill the pairs closer than the skin, the first one owned; returns their number (beyond the capacity: only counted)."""
    m, grids = len(x), len(size)
    head, following = np.full(offset[grids], NONE, np.uint32), np.empty(m, np.uint32)
    for i in range(m - 1, -1, -1):
        g, b = level[i], 0
        for k in range(3):
            b = b * shape[g, k] + min(max(int((x[i, k] - lower[k]) / size[g]), 0), shape[g, k] - 1)
        b += offset[g]
        following[i], head[b] = head[b], i
    number, at = 0, np.empty(3, np.int64)
    for i in range(m):
        for g in range(level[i], grids):
            for k in range(3):
                at[k] = min(max(int((x[i, k] - lower[k]) / size[g]), 0), shape[g, k] - 1)
            same = g == level[i]  # within a class half of the boxes around will do
            for a in range(at[0] if same else max(at[0] - 1, 0), min(at[0] + 2, shape[g, 0])):
                for b in range(at[1] if same and a == at[0] else max(at[1] - 1, 0), min(at[1] + 2, shape[g, 1])):
                    half = same and a == at[0] and b == at[1]
                    for c in range(at[2] if half else max(at[2] - 1, 0), min(at[2] + 2, shape[g, 2])):
                        j, own = head[offset[g] + (a * shape[g, 1] + b) * shape[g, 2] + c], half and c == at[2]
                        while j != NONE:
                            if (j > i or not own) and (i < owned or j < owned):
                                dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
                                reach = radius[i] + radius[j] + skin
                                if dx * dx + dy * dy + dz * dz < reach * reach:
                                    if number < len(first):
                                        swap = i >= owned
                                        first[number], second[number] = (j, i) if swap else (i, j)
                                    number += 1
                            j = following[j]
    return number


@njit(cache=True)
def _by_first(first, second, owned):
    """The pairs in the order of their first particle."""
    start = np.zeros(owned + 1, np.int64)
    for i in first:
        start[i + 1] += 1
    for i in range(owned):
        start[i + 1] += start[i]
    a, b = np.empty_like(first), np.empty_like(second)
    for k in range(len(first)):
        n = start[first[k]]
        a[n], b[n] = first[k], second[k]
        start[first[k]] += 1
    return a, b


def neighbour_pairs(x, radius, owned, skin):
    """Pairs (first, second) closer than the skin, each once, the first one owned, in the order of the first."""
    empty = np.empty(0, np.int32)
    if owned == 0:
        return empty, empty
    count = int(np.log2(radius.max() / radius.min() * (1 + 1e-12))) + 1
    level, largest = _classes(radius, radius.min(), count)
    lower, extent = x.min(0), np.ptp(x, 0)
    size = 2 * np.maximum(largest, radius.min()) + skin
    shape = np.empty((count, 3), np.int64)
    for g in range(count):
        while (extent / size[g] + 1).prod() > 4 * len(x) + 64:  # sparse clouds: no more boxes than particles need
            size[g] *= 1.3
        shape[g] = (extent / size[g]).astype(np.int64) + 1
    offset = np.concatenate([[0], np.cumsum(shape.prod(1))])
    capacity = 6 * len(x) + 64
    first, second = np.empty(capacity, np.int32), np.empty(capacity, np.int32)
    number = _search(x, radius, level, owned, skin, lower, size, shape, offset, first, second)
    if number > capacity:
        first, second = np.empty(number, np.int32), np.empty(number, np.int32)
        _search(x, radius, level, owned, skin, lower, size, shape, offset, first, second)
    return _by_first(first[:number], second[:number], owned)


@njit(cache=True)
def gaps(x, radius, first, second):
    """Distance of the surfaces of each pair, negative in contact."""
    gap = np.empty(len(first))
    for k in range(len(first)):
        i, j = first[k], second[k]
        dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
        gap[k] = np.sqrt(dx * dx + dy * dy + dz * dz) - radius[i] - radius[j]
    return gap


@njit(cache=True)
def collect_springs(first, partner_id, spring, live, mirror, second, owned, ids):
    """Springs of the live contacts: (particle, partner's id, spring), for both partners where ``mirror`` is set."""
    number = 0
    for k in range(len(first)):
        if live[k]:
            number += 2 if mirror and second[k] < owned else 1
    particle, partner = np.empty(number, np.int64), np.empty(number, np.int64)
    stretch, n = np.empty((number, spring.shape[1])), 0
    for k in range(len(first)):
        if live[k]:
            particle[n], partner[n], stretch[n] = first[k], partner_id[k], spring[k]
            n += 1
            if mirror and second[k] < owned:
                particle[n], partner[n], stretch[n] = second[k], ids[first[k]], -spring[k]
                stretch[n, 3] = spring[k, 3]  # the normal velocity is the same from both sides
                n += 1
    return particle, partner, stretch


@njit(cache=True)
def restore_springs(first, partner_id, owned, particle, partner, stretch, spring, live):
    """Copy collected springs to the contacts of a new list and mark these as live."""
    start = np.zeros(owned + 1, np.int64)
    for i in particle:
        start[i + 1] += 1
    for i in range(owned):
        start[i + 1] += start[i]
    order, at = np.empty(len(particle), np.int64), start.copy()
    for k in range(len(particle)):
        order[at[particle[k]]] = k
        at[particle[k]] += 1
    for k in range(len(first)):
        i = first[k]
        for s in range(start[i], start[i + 1]):
            if partner[order[s]] == partner_id[k]:
                spring[k] = stretch[order[s]]
                live[k] = True
