"""Facets of walls near each particle: first those near each cell, plane by plane, then those near the particles in it."""
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from fe_el.compiled.cache import njit
from fe_el.compiled.direct_calls import Direct
from fe_el.particles.contacts.walls import facet_frames, nearest_point

PLANES = 8  # of a cell at most, whose facets are taken together


class NearCells(NamedTuple):
    """Facets near each cell; those in one plane follow each other."""

    start: np.ndarray  #: (cells + 1,)
    facet: np.ndarray  #: (entries,)
    after: np.ndarray  #: (entries,) for the first in a plane the entry behind the last, else the next
    slack: float  #: how far facets may be out of the plane of the first [m]
    edge: np.ndarray  #: (facets, 3, 4) inward normal of each edge, and how far inside the facet's middle is [m]


def wall_candidates(cells, facet_corner, ball, reach):
    """Facets, with their balls, within ``reach`` of each cell (NearCells)."""
    centre = cells.corner.mean(1)
    radius = np.sqrt(((cells.corner - centre[:, None]) ** 2).sum(2).max(1))
    middle = facet_corner.mean(1)
    size = np.sqrt(((facet_corner - middle[:, None]) ** 2).sum(2).max(1))
    near = cKDTree(middle).query_ball_point(centre, radius + size.max() + reach, return_sorted=True)
    start = np.concatenate([[0], np.cumsum([len(k) for k in near])]).astype(np.int64)
    facet = np.concatenate([np.asarray(k, np.int32) for k in near]).astype(np.int32)
    start, facet = _closer(centre, radius + reach, start, facet, facet_corner)
    slack = 1e-6 * reach
    return NearCells(start, *_by_plane(start, facet, facet_corner, ball, slack), slack, _edges(facet_corner, middle))


def _edges(corner, middle):
    """Edges of triangles; of a segment those of a triangle beside it, which is as far from any point in its plane."""
    frame = facet_frames(corner)
    inward = np.stack([frame[:, 3:6], frame[:, 6:9], -frame[:, 3:6] - frame[:, 6:9]], 1)
    inward /= np.linalg.norm(inward, axis=2)[:, :, None]
    inside = ((middle[:, None] - corner[:, [0, 0, 1]]) * inward).sum(2)
    return np.concatenate([inward, inside[:, :, None]], 2)


@njit
def _closer(centre, reach, start, facet, corner):
    """Keep the facets whose nearest point is within reach of each centre."""
    new, kept, number = np.zeros_like(start), np.empty_like(facet), 0
    for c in range(len(centre)):
        x, y, z = centre[c]
        for k in range(start[c], start[c + 1]):
            qx, qy, qz, _, _, _ = nearest_point(corner[facet[k]], x, y, z)
            if (qx - x) ** 2 + (qy - y) ** 2 + (qz - z) ** 2 <= reach[c] * reach[c]:
                kept[number] = facet[k]
                number += 1
        new[c + 1] = number
    return new, kept[:number].copy()


@njit
def _by_plane(start, facet, corner, ball, slack):
    """The facets of each cell in the order of their planes, and what to go on with where a plane is out of reach."""
    out, after, plane, first = np.empty_like(facet), np.empty_like(facet), np.empty_like(facet), np.empty(PLANES, np.int64)
    for c in range(len(start) - 1):
        planes, n = 0, start[c]
        for k in range(start[c], start[c + 1]):
            plane[k], f = planes, facet[k]
            for m in range(planes):
                apart = 0.0
                for q in range(corner.shape[1]):
                    height = 0.0
                    for i in range(3):
                        height += (corner[f, q, i] - ball[first[m], i]) * ball[first[m], 4 + i]
                    apart = max(apart, abs(height))
                if apart <= slack:
                    plane[k] = m
                    break
            if plane[k] == planes < PLANES:
                first[planes] = f
                planes += 1
        for m in range(PLANES + 1):  # the last: all others
            begin = n
            for k in range(start[c], start[c + 1]):
                if plane[k] == m:
                    out[n], after[n] = facet[k], n + 1
                    n += 1
            if m < PLANES and n > begin:
                after[begin] = n
    return out, after


@njit
def _list(x, reach_of, cell, near, corner, ball, particle, facet, distance):
    number, start, near_facet, after, slack, edge = 0, near.start, near.facet, near.after, near.slack, near.edge
    for i in range(len(cell)):
        reach, k, end, first, px, py, pz = reach_of[i], start[cell[i]], start[cell[i] + 1], number, x[i, 0], x[i, 1], x[i, 2]
        while k < end:
            f, n = near_facet[k], number
            dx, dy, dz, far = px - ball[f, 0], py - ball[f, 1], pz - ball[f, 2], reach + ball[f, 3]
            height = abs(dx * ball[f, 4] + dy * ball[f, 5] + dz * ball[f, 6])
            k = after[k] if height > reach + slack else k + 1
            if height > reach or dx * dx + dy * dy + dz * dz > far * far:
                continue
            beyond = 0.0
            for q in range(3):
                inside = dx * edge[f, q, 0] + dy * edge[f, q, 1] + dz * edge[f, q, 2] + edge[f, q, 3]
                beyond = max(beyond, -inside)
            square = height * height + beyond * beyond  # at least
            if beyond > 0.0 and square < reach * reach:
                qx, qy, qz, _, _, _ = nearest_point(corner[f], px, py, pz)
                square = (qx - px) ** 2 + (qy - py) ** 2 + (qz - pz) ** 2
            if square < reach * reach:
                if number < len(particle):
                    while n > first and facet[n - 1] > f:  # planes may come in another order than facets
                        facet[n], distance[n] = facet[n - 1], distance[n - 1]
                        n -= 1
                    particle[number], facet[n], distance[n] = i, f, np.sqrt(square)
                number += 1
    return number


_direct_list = Direct(_list)


@njit
def wall_gaps(particle, distance, radius, room):
    """Distance of the surface of each entry's particle from its facet over the room of the particle."""
    gap = np.empty(len(particle))
    for n in range(len(particle)):
        i = particle[n]
        gap[n] = (distance[n] - radius[i]) / room[i]
    return gap


def wall_list(x, reach, cell, near, corner, ball):
    """Facets within reach (particles,) [m] of each particle, of those near its cell (NearCells).

    Returns:
        particle and facet, in the order of these, and the distance of the centre [m].
    """
    capacity = 2 * len(cell) + 64
    while True:
        particle, facet, distance = np.empty(capacity, np.int32), np.empty(capacity, np.int32), np.empty(capacity)
        number = _direct_list(x, reach, cell, near, corner, ball, particle, facet, distance)
        if number <= capacity:
            return particle[:number].copy(), facet[:number].copy(), distance[:number].copy()
        capacity = number
