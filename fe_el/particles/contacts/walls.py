"""Contacts with the tagged boundary facets of the mesh.

A sphere touches the wall where its distance to the *surface* has a local minimum: a point on an edge or a vertex counts
only if it is the nearest point of every facet that meets there, and counts once. So no seam between facets is ever felt,
and concave and convex edges are right without special cases. Contacts with one smooth piece of wall are joined, see
:mod:`fe_el.particles.contacts.wall_patches`.
"""

import numpy as np

from fe_el.compiled.cache import njit
from fe_el.compiled.parts import part
from fe_el.particles.contacts.blocks import BLOCK
from fe_el.particles.contacts.law_kernels import FAST
from fe_el.particles.contacts.records import FacetScratch
from fe_el.particles.contacts.wall_blocks import add_contact, finish_block
from fe_el.particles.contacts.wall_patches import holds_feature, join_contacts, patch_scratch


@njit(fastmath=FAST)
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


def facet_frames(corner):
    """First corner, dual edge vectors and unit normal of each facet: (facets, 12); a segment's second edge is out of
    plane."""
    one = corner[:, 1] - corner[:, 0]
    other = corner[:, 2] - corner[:, 0] if corner.shape[1] == 3 else np.tile([0.0, 0.0, 1.0], (len(corner), 1))
    normal = np.cross(one, other)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    duals = [d / (d * edge).sum(1)[:, None] for d, edge in ((np.cross(other, normal), one), (np.cross(normal, one), other))]
    return np.column_stack([corner[:, 0], *duals, normal])


@part(fastmath=FAST, forceinline=True)
def _beyond_edge(frame, f, v, w, square):
    """Whether the foot of a point in the plane of facet f is as far as the root of ``square`` beyond one of its edges."""
    a, b, c, d, e, g = frame[f, 3], frame[f, 4], frame[f, 5], frame[f, 6], frame[f, 7], frame[f, 8]
    u = v + w - 1.0  # beyond the edge that the first corner does not have; those of the others are v = 0 and w = 0
    return (v < 0.0 and v * v >= square * (a * a + b * b + c * c) or w < 0.0 and w * w >= square * (d * d + e * e + g * g)
            or u > 0.0 and u * u >= square * ((a + d) ** 2 + (b + e) ** 2 + (c + g) ** 2))


@part(fastmath=FAST, forceinline=True)
def _from_facet(frame, corner, f, x, y, z, reach):
    """Vector from the nearest point of facet f to a point, with that point's weights; only its length matters beyond
    reach."""
    px, py, pz = x - frame[f, 0], y - frame[f, 1], z - frame[f, 2]
    nx, ny, nz = frame[f, 9], frame[f, 10], frame[f, 11]
    d = nx * px + ny * py + nz * pz
    if abs(d) >= reach:
        return d * nx, d * ny, d * nz, 1.0, 0.0, 0.0
    v = frame[f, 3] * px + frame[f, 4] * py + frame[f, 5] * pz
    w = frame[f, 6] * px + frame[f, 7] * py + frame[f, 8] * pz
    if v >= 0.0 and w >= 0.0 and v + w <= 1.0:  # in front of the face
        return d * nx, d * ny, d * nz, 1.0 - v - w, v, w
    if _beyond_edge(frame, f, v, w, reach * reach - d * d):
        return 2.0 * reach, 0.0, 0.0, 1.0, 0.0, 0.0
    qx, qy, qz, wa, wb, wc = nearest_point(corner[f], x, y, z)
    return x - qx, y - qy, z - qz, wa, wb, wc


def facet_balls(corner):
    """Bounding sphere and unit normal of each facet: (facets, 7), for a quick test before the nearest point."""
    middle = corner.mean(1)
    size = np.sqrt(((corner - middle[:, None]) ** 2).sum(2).max(1))
    last = corner[:, 2] - corner[:, 0] if corner.shape[1] == 3 else np.tile([0.0, 0.0, 1.0], (len(corner), 1))
    normal = np.cross(corner[:, 1] - corner[:, 0], last)
    return np.column_stack([middle, size, normal / np.linalg.norm(normal, axis=1)[:, None]])


def scratch(particle):
    """Memory for the facets near one particle, of those with the given ones of a list."""
    most = int(np.bincount(particle).max(initial=1))
    return FacetScratch(np.empty((most, 3)), np.empty((most, 3)), np.empty(most, np.uint64), np.empty(most, np.bool_),
                        *patch_scratch(most))


@part(fastmath=FAST)
def facet_forces(rows, listed, near_facets, walls, block, numbers, step, h):
    """Add the contact forces of the ``listed`` pairs with wall facets.

    Returns the number of contacts, or -1 - i where the centre of i is on a wall.
    """
    x, radius, particle, facet = rows.x, rows.radius, near_facets.particle, near_facets.facet
    spring, stamp, facets, scratch = near_facets.spring, near_facets.stamp, near_facets.facets, near_facets.scratch
    corner, frame, patch, facet_wall = facets.corner, facets.frame, facets.patch, facets.wall
    arm, weight, slot, contact, work = scratch.arm, scratch.weight, scratch.slot, scratch.contact, scratch.work
    touching, m, entry, total, bad = 0, np.int64(0), 0, len(listed), 0
    while entry < total:
        i, near = particle[listed[entry]], np.uint64(0)
        px, py, pz, r = x[i, 0], x[i, 1], x[i, 2], radius[i]
        while entry < total and particle[listed[entry]] == i:
            k = listed[entry]
            dx, dy, dz, wa, wb, wc = _from_facet(frame, corner, facet[k], px, py, pz, r)
            distance2 = dx * dx + dy * dy + dz * dz
            if distance2 < r * r:
                bad = bad if distance2 > 0 else -1 - np.int64(i)
                arm[near, 0], arm[near, 1], arm[near, 2] = dx, dy, dz
                weight[near, 0], weight[near, 1], weight[near, 2] = wa, wb, wc
                slot[near] = k
                near += np.uint64(1)
            entry += 1
        contact[0], joined = True, False
        if near > 1:
            first, flat = facet[slot[0]], True
            for n in range(near):
                joined |= patch[facet[slot[n]], 1] > 0
                flat &= patch[facet[slot[n]], 2] == patch[first, 2]
            joined &= _contacts_of(near, scratch, facet, facets.vertex, 1e-6 * r) > 1 or not flat  # else nothing to join
            if joined:
                join_contacts(near, scratch, facet, facets, x[i], r, numbers.kind == 1)
            _hand_over(near, slot, arm, contact, spring, stamp, step)
        for n in range(near):
            if contact[n]:
                if m == BLOCK:
                    finish_block(block, m, rows, spring, stamp, walls, numbers, step, h)
                    touching, m = touching + m, 0
                add_contact(block, m, i, slot[n], facet_wall[facet[slot[n]]], arm[n, 0], arm[n, 1], arm[n, 2], r,
                            work[n, 12] if joined else 1.0)
                m += 1
    finish_block(block, m, rows, spring, stamp, walls, numbers, step, h)
    return bad if bad < 0 else touching + m


@part
def _hand_over(near, slot, arm, contact, spring, stamp, step):
    """Give the springs of facets that are no longer the contact to the facet the contact has rolled onto, the nearest."""
    for n in range(near):
        if contact[n] or stamp[slot[n]] != step - 1:
            continue
        to, least = n, np.inf
        for o in range(near):
            far = (arm[o, 0] - arm[n, 0]) ** 2 + (arm[o, 1] - arm[n, 1]) ** 2 + (arm[o, 2] - arm[n, 2]) ** 2
            if contact[o] and stamp[slot[o]] != step - 1 and far < least:
                to, least = o, far
        if to != n:
            spring[slot[to]] = spring[slot[n]]
            stamp[slot[to]] = step - 1


@part
def _contacts_of(near, scratch, facet, vertex, tolerance):
    """Set which nearest points are local minima of the distance to the surface, and the first of their kind; returns how
    many."""
    arm, weight, slot, contact, number = scratch.arm, scratch.weight, scratch.slot, scratch.contact, 0
    for m in range(near):
        contact[m] = True
        for o in range(near):
            if o == m:
                continue
            d2 = (arm[o, 0] - arm[m, 0]) ** 2 + (arm[o, 1] - arm[m, 1]) ** 2 + (arm[o, 2] - arm[m, 2]) ** 2
            if d2 < tolerance * tolerance:
                contact[m] &= o > m
            elif contact[m]:
                contact[m] = not holds_feature(facet[slot[o]], facet[slot[m]], vertex, weight[m])
        number += contact[m]
    return number
