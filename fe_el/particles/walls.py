"""Contacts with the tagged boundary facets of the mesh.

A sphere touches the wall where its distance to the *surface* has a local minimum: a point on an edge or a vertex counts
only if it is the nearest point of every facet that meets there, and counts once. So no seam between facets is ever felt,
and concave and convex edges are right without special cases.
"""

import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from fe_el.particles.law_kernels import BLOCK, FAST, apply_law, constant_rows, material_row

B = BLOCK
MOST = 64  # facets a sphere may touch at once


def wall_candidates(cells, facet_corner, reach):
    """Facets within ``reach`` of each cell: (start, facet)."""
    centre = cells.corner.mean(1)
    radius = np.sqrt(((cells.corner - centre[:, None]) ** 2).sum(2).max(1))
    middle = facet_corner.mean(1)
    size = np.sqrt(((facet_corner - middle[:, None]) ** 2).sum(2).max(1))
    near = cKDTree(middle).query_ball_point(centre, radius + size.max() + reach, return_sorted=True)
    start = np.concatenate([[0], np.cumsum([len(k) for k in near])]).astype(np.int64)
    facet = np.concatenate([np.asarray(k, np.int32) for k in near]).astype(np.int32)
    return _closer(centre, radius + reach, start, facet, facet_corner)


@njit(cache=True)
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


@njit(cache=True, fastmath=FAST)
def nearest_point(corner, x, y, z):
    """Nearest point of a triangle or segment, with its barycentric weights (Ericson, Real-Time Collision Detection)."""
    ax, ay, az = corner[0, 0], corner[0, 1], corner[0, 2]
    bx, by, bz = corner[1, 0] - ax, corner[1, 1] - ay, corner[1, 2] - az
    px, py, pz = x - ax, y - ay, z - az
    d1 = bx * px + by * py + bz * pz
    if len(corner) == 2:
        t = min(max(d1 / (bx * bx + by * by + bz * bz), 0.0), 1.0)
        return ax + t * bx, ay + t * by, az + t * bz, 1.0 - t, t, 0.0
    cx, cy, cz = corner[2, 0] - ax, corner[2, 1] - ay, corner[2, 2] - az
    d2 = cx * px + cy * py + cz * pz
    if d1 <= 0 and d2 <= 0:
        return ax, ay, az, 1.0, 0.0, 0.0
    bb, cc, bc = bx * bx + by * by + bz * bz, cx * cx + cy * cy + cz * cz, bx * cx + by * cy + bz * cz
    d3, d4 = d1 - bb, d2 - bc
    if d3 >= 0 and d4 <= d3:
        return ax + bx, ay + by, az + bz, 0.0, 1.0, 0.0
    d5, d6 = d1 - bc, d2 - cc
    if d6 >= 0 and d5 <= d6:
        return ax + cx, ay + cy, az + cz, 0.0, 0.0, 1.0
    vc = d1 * d4 - d3 * d2
    if vc <= 0 and d1 >= 0 and d3 <= 0:
        t = d1 / (d1 - d3)
        return ax + t * bx, ay + t * by, az + t * bz, 1.0 - t, t, 0.0
    vb = d5 * d2 - d1 * d6
    if vb <= 0 and d2 >= 0 and d6 <= 0:
        t = d2 / (d2 - d6)
        return ax + t * cx, ay + t * cy, az + t * cz, 1.0 - t, 0.0, t
    va = d3 * d6 - d5 * d4
    if va <= 0 and d4 - d3 >= 0 and d5 - d6 >= 0:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return ax + bx + t * (cx - bx), ay + by + t * (cy - by), az + bz + t * (cz - bz), 0.0, 1.0 - t, t
    s = 1.0 / (va + vb + vc)
    v, u = vb * s, vc * s
    return ax + v * bx + u * cx, ay + v * by + u * cy, az + v * bz + u * cz, 1.0 - v - u, v, u


def facet_balls(corner):
    """Bounding sphere and unit normal of each facet: (facets, 7), for a quick test before the nearest point."""
    middle = corner.mean(1)
    size = np.sqrt(((corner - middle[:, None]) ** 2).sum(2).max(1))
    last = corner[:, 2] - corner[:, 0] if corner.shape[1] == 3 else np.tile([0.0, 0.0, 1.0], (len(corner), 1))
    normal = np.cross(corner[:, 1] - corner[:, 0], last)
    return np.column_stack([middle, size, normal / np.linalg.norm(normal, axis=1)[:, None]])


@njit(cache=True)
def _list(x, radius, cell, skin, cell_start, cell_facet, corner, ball, particle, facet):
    number = 0
    for i in range(len(cell)):
        reach = radius[i] + skin
        for k in range(cell_start[cell[i]], cell_start[cell[i] + 1]):
            f = cell_facet[k]
            dx, dy, dz, far = x[i, 0] - ball[f, 0], x[i, 1] - ball[f, 1], x[i, 2] - ball[f, 2], reach + ball[f, 3]
            if dx * dx + dy * dy + dz * dz > far * far or abs(dx * ball[f, 4] + dy * ball[f, 5] + dz * ball[f, 6]) > reach:
                continue
            qx, qy, qz, _, _, _ = nearest_point(corner[f], x[i, 0], x[i, 1], x[i, 2])
            if (qx - x[i, 0]) ** 2 + (qy - x[i, 1]) ** 2 + (qz - x[i, 2]) ** 2 < reach * reach:
                if number < len(particle):
                    particle[number], facet[number] = i, f
                number += 1
    return number


def wall_list(x, radius, cell, skin, cell_start, cell_facet, corner, ball):
    """Facets within the skin of each particle: (particle, facet), in the order of the particles."""
    capacity = 2 * len(cell) + 64
    while True:
        particle, facet = np.empty(capacity, np.int32), np.empty(capacity, np.int32)
        number = _list(x, radius, cell, skin, cell_start, cell_facet, corner, ball, particle, facet)
        if number <= capacity:
            return particle[:number].copy(), facet[:number].copy()
        capacity = number


@njit(cache=True)
def wall_gaps(x, radius, particle, facet, corner):
    """Distance of the surface of each particle of a list from its facet, negative in contact."""
    gap = np.empty(len(particle))
    for k in range(len(particle)):
        i = particle[k]
        qx, qy, qz, _, _, _ = nearest_point(corner[facet[k]], x[i, 0], x[i, 1], x[i, 2])
        gap[k] = np.sqrt((qx - x[i, 0]) ** 2 + (qy - x[i, 1]) ** 2 + (qz - x[i, 2]) ** 2) - radius[i]
    return gap


@njit(cache=True, fastmath=FAST, inline="always")
def gather_wall(b, m, i, px, py, pz, motion, x, state, radius, inverse_mass, spring, at, keep, numbers):
    """Rows of one contact of particle i with the wall point p; ``motion`` is the wall's origin, velocity and rotation."""
    dx, dy, dz = x[i, 0] - px, x[i, 1] - py, x[i, 2] - pz
    b[m], b[m + B], b[m + 2 * B] = dx, dy, dz
    b[m + 3 * B], b[m + 4 * B] = dx * dx + dy * dy + dz * dz, radius[i]
    ox, oy, oz = px - motion[0], py - motion[1], pz - motion[2]
    b[m + 6 * B] = state[i, 1] - motion[3] - (motion[7] * oz - motion[8] * oy)
    b[m + 7 * B] = state[i, 2] - motion[4] - (motion[8] * ox - motion[6] * oz)
    b[m + 8 * B] = state[i, 3] - motion[5] - (motion[6] * oy - motion[7] * ox)
    b[m + 12 * B], b[m + 22 * B] = inverse_mass[i], radius[i]
    b[m + 16 * B], b[m + 34 * B] = spring[at, 3], 0.5 * keep
    for k in range(3):
        b[m + (9 + k) * B] = radius[i] * state[i, 4 + k]
        b[m + (13 + k) * B] = keep * spring[at, k]
    if numbers.rolls > 0:
        for k in range(3):
            b[m + (23 + k) * B] = state[i, 4 + k] - motion[6 + k]
            b[m + (26 + k) * B] = keep * spring[at, 4 + k]


@njit(cache=True, fastmath=FAST)
def finish_block(b, m, h, numbers, uniform, who, at, wall_of, material, wall_material, force, radius, spring,
                 wall_force, deepest):
    """Apply the law to a block of wall contacts and give particles and walls their forces."""
    if not uniform:
        for n in range(m):
            material_row(b, n, numbers, material[who[n]], wall_material[wall_of[n]])
    apply_law(b, m, h, numbers)
    for n in range(m):
        i, k = who[n], at[n]
        deepest[0] = max(deepest[0], 0.5 * b[n + 4 * B] / radius[i])
        for q in range(3):
            spring[k, q] = b[n + (13 + q) * B]
            force[i, q] += b[n + (6 + q) * B]
            wall_force[wall_of[n], q] -= b[n + (6 + q) * B]
            force[i, 4 + q] += radius[i] * b[n + (9 + q) * B]
        spring[k, 3] = b[n + 16 * B]
        if numbers.rolls > 0:
            for q in range(3):
                spring[k, 4 + q] = b[n + (26 + q) * B]
                force[i, 4 + q] += b[n + (23 + q) * B]


@njit(cache=True, fastmath=FAST)
def facet_forces(x, state, force, radius, inverse_mass, material, listed, particle, facet, spring, stamp, step, corner, vertex,
                 facet_wall, motion, wall_material, wall_force, deepest, b, numbers, h):
    """Add the contact forces of the ``listed`` pairs with wall facets.

    Returns the number of contacts, or -1 - i where the centre of i is on a wall.
    """
    touching, sides, m, entry, total, bad = 0, corner.shape[1], 0, 0, len(listed), 0
    point, weight, slot = np.empty((MOST, 3)), np.empty((MOST, 3)), np.empty(MOST, np.uint64)
    contact = np.empty(MOST, np.bool_)
    who, at, wall_of = np.empty(B, np.uint64), np.empty(B, np.uint64), np.empty(B, np.uint64)
    uniform = constant_rows(b, numbers)
    while entry < total:
        i, near = particle[listed[entry]], 0
        while entry < total and particle[listed[entry]] == i:
            k = listed[entry]
            f = facet[k]
            qx, qy, qz, wa, wb, wc = nearest_point(corner[f], x[i, 0], x[i, 1], x[i, 2])
            d2 = (qx - x[i, 0]) ** 2 + (qy - x[i, 1]) ** 2 + (qz - x[i, 2]) ** 2
            if d2 < radius[i] * radius[i] and near < MOST:
                point[near, 0], point[near, 1], point[near, 2] = qx, qy, qz
                weight[near, 0], weight[near, 1], weight[near, 2] = wa, wb, wc
                slot[near] = k
                near += 1
            entry += 1
        if near == 0:
            continue
        moved = False
        for n in range(near):
            contact[n] = near == 1 or _is_contact(n, near, slot, facet, vertex, weight, point, 1e-6 * radius[i], sides)
            moved |= not contact[n] and stamp[slot[n]] == step - 1
        if moved:
            _hand_over(near, slot, contact, spring, stamp, step)
        for n in range(near):
            if contact[n]:
                s = slot[n]
                who[m], at[m], wall_of[m] = i, s, facet_wall[facet[s]]
                gather_wall(b, m, i, point[n, 0], point[n, 1], point[n, 2], motion[wall_of[m]], x, state, radius,
                            inverse_mass, spring, s, 1.0 if stamp[s] == step - 1 else 0.0, numbers)
                if not b[m + 3 * B] > 0:
                    bad = -1 - i
                stamp[s] = step
                m += 1
        if m >= B - MOST:
            finish_block(b, m, h, numbers, uniform, who, at, wall_of, material, wall_material, force, radius, spring,
                         wall_force, deepest)
            touching, m = touching + m, 0
    finish_block(b, m, h, numbers, uniform, who, at, wall_of, material, wall_material, force, radius, spring,
                 wall_force, deepest)
    return bad if bad < 0 else touching + m


@njit(cache=True)
def _hand_over(near, slot, contact, spring, stamp, step):
    """Give the springs of facets that are no longer the contact to the facet the contact has rolled onto."""
    for n in range(near):
        if contact[n] or stamp[slot[n]] != step - 1:
            continue
        for o in range(near):
            if contact[o] and stamp[slot[o]] != step - 1:
                spring[slot[o]] = spring[slot[n]]
                stamp[slot[o]] = step - 1
                break


@njit(cache=True)
def _is_contact(m, near, slot, facet, vertex, weight, point, tolerance, sides):
    """Whether nearest point m is a local minimum of the distance to the surface, and the first of its kind."""
    for o in range(near):
        if o == m:
            continue
        d2 = (point[o, 0] - point[m, 0]) ** 2 + (point[o, 1] - point[m, 1]) ** 2 + (point[o, 2] - point[m, 2]) ** 2
        if d2 < tolerance * tolerance:
            if o < m:
                return False
            continue
        if _holds_feature(facet[slot[o]], facet[slot[m]], vertex, weight[m], sides):
            return False
    return True


@njit(cache=True)
def _holds_feature(other, own, vertex, weight, sides):
    """Whether facet ``other`` contains the edge or vertex of facet ``own`` that carries the weights; false for a face."""
    positive = 0
    for a in range(sides):
        if weight[a] > 1e-12:
            positive += 1
            found = False
            for b in range(sides):
                found |= vertex[other, b] == vertex[own, a]
            if not found:
                return False
    return positive < sides
