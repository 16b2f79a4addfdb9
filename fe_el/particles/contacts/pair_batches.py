"""Pairs among the particles of a box and those around it, by vector instructions."""
from typing import NamedTuple

import numpy as np

from fe_el.compiled.cache import njit
from fe_el.compiled.parts import part


class Batch(NamedTuple):
    """Particles of a box and of half of those around it, side by side, so that their distances are vector instructions."""

    number: np.ndarray  #: (most,) which they are
    x: np.ndarray  #: (most,) [m]
    y: np.ndarray
    z: np.ndarray
    reach: np.ndarray
    near: np.ndarray  #: (most,) whether the particle at hand reaches them
    eights: np.ndarray  #: (most / 8,) the same, eight at a time


@njit
def batch_for(start):
    """A batch with room for all particles of a box and the boxes around it."""
    crowd = np.uint64(0)
    for box in range(len(start) - 1):
        crowd = max(crowd, start[box + 1] - start[box])
    most = (14 * crowd // 8 + 2) * 8
    x, y, z, reach = np.empty(most), np.empty(most), np.empty(most), np.empty(most)
    near = np.empty(most, np.uint8)
    return Batch(np.empty(most, np.uint32), x, y, z, reach, near, near.view(np.uint64))


@part
def add_to_batch(m, begin, end, cloud, batch):
    """Put the entries from begin to end of a cloud behind m others; returns how many there are now."""
    rows, order, number, x, y, z, reach = cloud.rows, cloud.order, batch.number, batch.x, batch.y, batch.z, batch.reach
    for k in range(begin, end):
        number[m], x[m], y[m], z[m], reach[m] = order[k], rows[k, 0], rows[k, 1], rows[k, 2], rows[k, 3]
        m += np.uint64(1)
    return m


@part
def pairs_in_batch(q, m, batch, owned, first, second, number):
    """Pairs of entry q of a batch with those behind it, one of the two owned; returns the number of pairs so far.

    The m entries, a multiple of eight, are tested without a branch; most of the eights hold no pair and are passed over.
    """
    one, eight, which, near, eights = np.uint64(1), np.uint64(8), batch.number, batch.near, batch.eights
    px, py, pz, pr = batch.x, batch.y, batch.z, batch.reach
    x, y, z, reach, i, begin = px[q], py[q], pz[q], pr[q], which[q], (q + one) // eight * eight
    for k in range(begin, m):
        dx, dy, dz, r = px[k] - x, py[k] - y, pz[k] - z, pr[k] + reach
        near[k] = dx * dx + dy * dy + dz * dz < r * r
    for k in range(begin, q + one):
        near[k] = 0
    room = number + (m - begin) < np.uint64(len(first))  # beyond it pairs are only counted
    for e in range(begin // eight, m // eight):
        if eights[e]:
            for k in range(eight * e, eight * (e + one)):
                j = which[k]
                if room:
                    first[number], second[number] = i, j
                number += np.uint64(near[k] & ((i < owned) | (j < owned)))
    return number
