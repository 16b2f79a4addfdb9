"""Contacts with the tagged boundary facets of the mesh.

A sphere touches the wall where its distance to the *surface* has a local minimum: a point on an edge or a vertex counts
only if it is the nearest point of every facet that meets there, and counts once. So no seam between facets is ever felt,
and concave and convex edges are right without special cases.
"""
import math

import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from fe_el.particles.motion import FAST, contact_force

MOST = 32  # facets a sphere may touch at once


def wall_candidates(cells, facet_corner, reach):
    """Facets within ``reach`` of each cell: (start, facet)."""
    centre = cells.corner.mean(1)
    radius = np.sqrt(((cells.corner - centre[:, None]) ** 2).sum(2).max(1))
    middle = facet_corner.mean(1)
    size = np.sqrt(((facet_corner - middle[:, None]) ** 2).sum(2).max(1))
    tree = cKDTree(middle)
    near = tree.query_ball_point(centre, radius + size.max() + reach, return_sorted=True)
    start = np.concatenate([[0], np.cumsum([len(k) for k in near])]).astype(np.int64)
    return start, np.concatenate([np.asarray(k, np.int32) for k in near]).astype(np.int32)


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


@njit(cache=True)
def wall_list(x, radius, cell, skin, cell_start, cell_facet, corner):
    """Facets within the skin of each particle: (particles near walls, start, facet)."""
    particle, start, facet = [0 for _ in range(0)], [0], [0 for _ in range(0)]
    for i in range(len(cell)):
        before = len(facet)
        for k in range(cell_start[cell[i]], cell_start[cell[i] + 1]):
            f = cell_facet[k]
            qx, qy, qz, _, _, _ = nearest_point(corner[f], x[i, 0], x[i, 1], x[i, 2])
            reach = radius[i] + skin
            if (qx - x[i, 0]) ** 2 + (qy - x[i, 1]) ** 2 + (qz - x[i, 2]) ** 2 < reach * reach:
                facet.append(f)
        if len(facet) > before:
            particle.append(i)
            start.append(len(facet))
    return np.array(particle, dtype=np.int64), np.array(start, dtype=np.int64), np.array(facet, dtype=np.int32)


@njit(cache=True, fastmath=FAST)
def wall_forces(x, v, w, force, torque, radius, inverse_mass, particle, start, facet, spring, corner, vertex, law, h):
    """Add the contact forces of walls; returns the number of contacts."""
    touching, sides = 0, corner.shape[1]
    point, weight, slot = np.empty((MOST, 3)), np.empty((MOST, 3)), np.empty(MOST, np.int64)
    for n in range(len(particle)):
        i, near = particle[n], 0
        for k in range(start[n], start[n + 1]):
            qx, qy, qz, a, b, c = nearest_point(corner[facet[k]], x[i, 0], x[i, 1], x[i, 2])
            d2 = (qx - x[i, 0]) ** 2 + (qy - x[i, 1]) ** 2 + (qz - x[i, 2]) ** 2
            if d2 < radius[i] * radius[i] and near < MOST:
                point[near, 0], point[near, 1], point[near, 2] = qx, qy, qz
                weight[near, 0], weight[near, 1], weight[near, 2] = a, b, c
                slot[near] = k
                near += 1
            elif near == 0 or d2 >= radius[i] * radius[i]:
                spring[k, 0] = spring[k, 1] = spring[k, 2] = 0.0
        for m in range(near):
            k = slot[m]
            if not _is_contact(m, near, slot, facet, vertex, weight, point, 1e-6 * radius[i], sides):
                _hand_over(m, near, slot, facet, vertex, weight, point, spring, 1e-6 * radius[i], sides)
                continue
            dx, dy, dz = x[i, 0] - point[m, 0], x[i, 1] - point[m, 1], x[i, 2] - point[m, 2]
            r = math.sqrt(dx * dx + dy * dy + dz * dz)
            if r == 0.0:
                continue
            nx, ny, nz = dx / r, dy / r, dz / r
            ux = v[i, 0] - r * (w[i, 1] * nz - w[i, 2] * ny)
            uy = v[i, 1] - r * (w[i, 2] * nx - w[i, 0] * nz)
            uz = v[i, 2] - r * (w[i, 0] * ny - w[i, 1] * nx)
            gx, gy, gz, spring[k, 0], spring[k, 1], spring[k, 2] = contact_force(
                nx, ny, nz, radius[i] - r, ux, uy, uz, spring[k, 0], spring[k, 1], spring[k, 2], inverse_mass[i],
                law, h)
            force[i, 0] += gx
            force[i, 1] += gy
            force[i, 2] += gz
            torque[i, 0] += r * (gy * nz - gz * ny)
            torque[i, 1] += r * (gz * nx - gx * nz)
            torque[i, 2] += r * (gx * ny - gy * nx)
            touching += 1
    return touching


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


@njit(cache=True)
def _hand_over(m, near, slot, facet, vertex, weight, point, spring, tolerance, sides):
    """Give the spring of a nearest point that is no contact to the facet the contact has rolled onto."""
    k = slot[m]
    if spring[k, 0] == 0 and spring[k, 1] == 0 and spring[k, 2] == 0:
        return
    for o in range(near):
        s = slot[o]
        if o != m and spring[s, 0] == 0 and spring[s, 1] == 0 and spring[s, 2] == 0 and \
                _is_contact(o, near, slot, facet, vertex, weight, point, tolerance, sides):
            spring[s] = spring[k]
            break
    spring[k] = 0.0
