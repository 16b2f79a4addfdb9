"""Neighbour lists with a skin, and the tangential springs that survive their renewal."""
import numpy as np
from numba import njit


@njit(cache=True)
def _neighbours(x, radius, owned, skin, lower, size, shape, start, neighbour):
    """Fill the half list of pairs closer than the skin; returns the number of pairs (beyond the capacity: only counted)."""
    m = len(x)
    head, following = np.full(shape.prod(), -1, np.int32), np.empty(m, np.int32)
    box = np.empty((m, 3), np.int32)
    for i in range(m - 1, -1, -1):
        for k in range(3):
            box[i, k] = min(max(int((x[i, k] - lower[k]) / size), 0), shape[k] - 1)
        b = (box[i, 0] * shape[1] + box[i, 1]) * shape[2] + box[i, 2]
        following[i], head[b] = head[b], i
    number = 0
    for i in range(owned):
        start[i] = number
        for a in range(max(box[i, 0] - 1, 0), min(box[i, 0] + 2, shape[0])):
            for b in range(max(box[i, 1] - 1, 0), min(box[i, 1] + 2, shape[1])):
                for c in range(max(box[i, 2] - 1, 0), min(box[i, 2] + 2, shape[2])):
                    j = head[(a * shape[1] + b) * shape[2] + c]
                    while j >= 0:
                        if j > i:
                            dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
                            reach = radius[i] + radius[j] + skin
                            if dx * dx + dy * dy + dz * dz < reach * reach:
                                if number < len(neighbour):
                                    neighbour[number] = j
                                number += 1
                        j = following[j]
    start[owned] = number
    return number


def neighbour_list(x, radius, owned, skin):
    """Half list of neighbours: (start (owned + 1,), neighbour (pairs,)); pair k of i is (i, neighbour[start[i] + k])."""
    start = np.zeros(owned + 1, np.int64)
    if owned == 0:
        return start, np.empty(0, np.int32)
    size = 2 * radius.max() + skin
    lower, extent = x.min(0), np.ptp(x, 0)
    while (extent / size + 1).prod() > 8 * len(x) + 64:  # sparse clouds: no more boxes than particles need
        size *= 1.3
    shape = (extent / size).astype(np.int64) + 1
    neighbour = np.empty(8 * len(x) + 64, np.int32)
    number = _neighbours(x, radius, owned, skin, lower, size, shape, start, neighbour)
    if number > len(neighbour):
        neighbour = np.empty(number, np.int32)
        _neighbours(x, radius, owned, skin, lower, size, shape, start, neighbour)
    return start, neighbour[:number].copy()


@njit(cache=True)
def collect_springs(start, other, ids, spring, owned, of_particle, mirror):
    """Springs that are stretched: (particle, other's id, spring), for both partners where ``mirror`` is set."""
    number = 0
    for k in range(len(other)):
        if spring[k, 0] != 0 or spring[k, 1] != 0 or spring[k, 2] != 0:
            number += 2 if mirror and other[k] < owned else 1
    particle, partner, stretch = np.empty(number, np.int64), np.empty(number, np.int64), np.empty((number, 3))
    number = 0
    for n in range(len(start) - 1):
        i = of_particle[n]
        for k in range(start[n], start[n + 1]):
            if spring[k, 0] != 0 or spring[k, 1] != 0 or spring[k, 2] != 0:
                particle[number], partner[number], stretch[number] = i, ids[other[k]], spring[k]
                number += 1
                if mirror and other[k] < owned:
                    particle[number], partner[number], stretch[number] = other[k], ids[i], -spring[k]
                    number += 1
    return particle, partner, stretch


@njit(cache=True)
def restore_springs(start, other, ids, of_particle, owned, particle, partner, stretch):
    """Springs (pairs, 3) of a new list from collected ones."""
    first = np.zeros(owned + 1, np.int64)
    for i in particle:
        first[i + 1] += 1
    for i in range(owned):
        first[i + 1] += first[i]
    order, at = np.empty(len(particle), np.int64), first.copy()
    for k in range(len(particle)):
        order[at[particle[k]]] = k
        at[particle[k]] += 1
    spring = np.zeros((len(other), 3))
    for n in range(len(start) - 1):
        i = of_particle[n]
        if first[i + 1] == first[i]:
            continue
        for k in range(start[n], start[n + 1]):
            for s in range(first[i], first[i + 1]):
                if partner[order[s]] == ids[other[k]]:
                    spring[k] = stretch[order[s]]
    return spring
