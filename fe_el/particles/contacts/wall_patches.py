"""Facets of one smooth piece of wall act on a sphere as one contact, at any refinement.

Flat facets stand for a curved wall, and a sphere in a pipe or a cone touches many of them. Facets that meet at less than
``SMOOTH`` form a patch. Within a patch the overlaps are joined in the energy of the normal force, with E(o) that of one
contact of overlap o:

    E = sum_i E(o_i) / S_i,   S_i = sum_j K_ij (o_j / o_i)^q_ij,

where K_ij falls from 1 to 0 as the angle g between two normals grows from 45 to 75 degrees, and q_ij = 2 / sin^2(g/2), a
power of two and at most ``SHARPEST``, such that a seam is not much stiffer than a contact. Many overlaps of like direction
have the energy of their largest, opposite walls of one patch that of each. Normals of facets are fixed, so the force is the
gradient of an energy, and no motion gains any. It is given to the deepest contact of each direction, which carries damping,
friction and the tangential spring.
"""
import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from fe_el.compiled.parts import part

SMOOTH = np.radians(40)
FLAT = 1e-6  # facets that meet at less lie in one plane [rad]
ONE, TWO = np.cos(np.radians(45)), np.cos(np.radians(75))  # normals at less belong to one contact, at more to two
SHARPEST = 128  # largest exponent: the stiffness in a pipe of many sides is 0.8 % below that of one contact


def smooth_patches(corner, vertex):
    """Patch of each facet, whether it is curved, and flat piece: (facets, 3); and how many patches meet at a vertex at most.
    """
    one, two, angle = _ridges(corner, vertex)
    joined, n = angle < SMOOTH, len(corner)
    (count, patch), (_, flat) = (connected_components(coo_matrix((np.ones(k.sum()), (one[k], two[k])), shape=(n, n)),
                                                      directed=False) for k in (joined, angle <= FLAT))
    curved = np.zeros(count, bool)
    curved[patch[one[joined & (angle > FLAT)]]] = True
    meeting = np.unique(np.column_stack([vertex.ravel(), np.repeat(patch, vertex.shape[1])]), axis=0)[:, 0]
    most = int(np.unique(meeting, return_counts=True)[1].max(initial=1))
    return np.column_stack([patch, curved[patch], flat]).astype(np.int64), most


def _ridges(corner, vertex):
    """Facets on both sides of each edge (in two dimensions vertex) that two facets share, and how much they turn there."""
    n, sides = vertex.shape
    keys = np.stack([np.sort(np.delete(vertex, k, 1), 1) for k in range(sides)], 1).reshape(n * sides, sides - 1)
    off = []
    for k in range(sides):
        rest = np.delete(corner, k, 1)
        arm = corner[:, k] - rest[:, 0]
        if sides == 3:
            edge = rest[:, 1] - rest[:, 0]
            arm = arm - ((arm * edge).sum(1) / (edge * edge).sum(1))[:, None] * edge
        off.append(arm / np.linalg.norm(arm, axis=1)[:, None])
    off = np.stack(off, 1).reshape(n * sides, 3)
    order = np.lexsort(keys.T)
    same = np.flatnonzero((keys[order[1:]] == keys[order[:-1]]).all(1))
    a, b = order[same], order[same + 1]
    return a // sides, b // sides, np.arccos(np.clip(-(off[a] * off[b]).sum(1), -1, 1))


def patch_scratch(most):
    """Memory for the contacts of one particle with facets: see :func:`join_contacts`."""
    return np.empty((most, 13)), np.empty(most, np.int64)


@part
def _likeness(work, i, j):
    """K of two contacts: 1 for one direction, 0 beyond."""
    c = work[i, 0] * work[j, 0] + work[i, 1] * work[j, 1] + work[i, 2] * work[j, 2]
    s = min(max((c - TWO) / (ONE - TWO), 0.0), 1.0)
    return s * s * (3 - 2 * s)


@part
def _weight(work, i, j, ratio):
    """A ratio of overlaps to the power q of two contacts, and q."""
    turn, q = 1 - (work[i, 0] * work[j, 0] + work[i, 1] * work[j, 1] + work[i, 2] * work[j, 2]), 1.0
    while q < SHARPEST and q * turn <= 2:
        ratio, q = min(ratio * ratio, 1e100), 2 * q
    return ratio, q


@part
def join_contacts(near, scratch, facet, facets, centre, radius, hertz):
    """Join the contacts of one particle within each patch; ``facet`` is that of each entry of the list.

    Of the ``near`` facets those that are no longer a ``contact`` are unmarked; the others get the joined ``arm`` and the
    factor of their force in ``work[:, 12]``.
    """
    arm, slot, contact, work, at = scratch.arm, scratch.slot, scratch.contact, scratch.work, scratch.order
    patch, m, several = facets.patch, np.int64(0), False
    for n in range(near):
        work[n, 12], work[n, 11] = 1.0, patch[facet[slot[n]], 0]
        if contact[n]:
            _entry(work, n, arm[n, 0], arm[n, 1], arm[n, 2], radius)
            at[m] = n
            for k in range(m):
                several |= work[at[k], 11] == work[n, 11]
            m += 1
    real = m
    for n in range(near):
        if not contact[n] and patch[facet[slot[n]], 1]:
            m = _add_plane(n, near, m, scratch, facet, facets, centre, radius)
    if m == real and not several:
        return
    _energy_gradient(m, at, hertz, work)
    _leaders(m, at, contact, work)
    for n in at[:m]:
        if contact[n]:
            share = np.sqrt(work[n, 8] ** 2 + work[n, 9] ** 2 + work[n, 10] ** 2)
            factor, depth = share / work[n, 5], work[n, 3]
            if factor > 1:  # a larger overlap in its place: the damping stays that of one contact
                depth, factor = min(depth * factor ** (1 / 1.5 if hertz else 1.0), 0.9 * radius), 1.0
            for q in range(3):
                arm[n, q] = (radius - depth) * (work[n, 8 + q] / share if share > 0 else work[n, q])
            work[n, 12] = factor


@part
def _entry(work, n, dx, dy, dz, radius):
    length = np.sqrt(dx * dx + dy * dy + dz * dz) + 1e-300  # the centre may be on the wall
    work[n, 0], work[n, 1], work[n, 2], work[n, 3] = dx / length, dy / length, dz / length, radius - length


@part
def _add_plane(n, near, m, scratch, facet, facets, centre, radius):
    """Add the plane of a facet beyond a concave seam, which is about to become a contact; returns the number of entries.

    Without it the overlap of that facet would come in at once when the particle's nearest point on it leaves the seam.
    """
    slot, weight, work, at = scratch.slot, scratch.weight, scratch.work, scratch.order
    corner, vertex, frame = facets.corner, facets.vertex, facets.frame
    f, deepest, first = facet[slot[n]], 0.0, -1
    nx, ny, nz = frame[f, 9], frame[f, 10], frame[f, 11]
    d = nx * (centre[0] - frame[f, 0]) + ny * (centre[1] - frame[f, 1]) + nz * (centre[2] - frame[f, 2])
    nx, ny, nz, d = (nx, ny, nz, d) if d > 0 else (-nx, -ny, -nz, -d)
    for o in at[:m]:
        if work[o, 11] == work[n, 11]:
            deepest, first = (work[o, 3], o) if work[o, 3] > deepest else (deepest, first)
            if nx * work[o, 0] + ny * work[o, 1] + nz * work[o, 2] > 1 - 1e-10:  # the same plane
                return m
    work[n, 0], work[n, 1], work[n, 2], work[n, 3] = nx, ny, nz, radius - d
    if first < 0 or not 0 < d < radius or _weight(work, n, first, work[n, 3] / deepest)[0] < 1e-9:
        return m
    for o in range(near):
        other = facet[slot[o]]
        if o != n and holds_feature(other, f, vertex, weight[n]):
            side = 0.0
            for b in range(corner.shape[1]):
                side += (nx * (corner[other, b, 0] - frame[f, 0]) + ny * (corner[other, b, 1] - frame[f, 1])
                         + nz * (corner[other, b, 2] - frame[f, 2]))
            if side < -1e-9 * radius:
                return m
    at[m] = n
    return m + 1


@part
def _energy_gradient(m, at, hertz, work):
    """Force along each normal, in ``work[:, 7]``, over that of one contact with the patch's largest overlap.

    Columns: 0-2 normal, 3 overlap, 4 over the patch's largest, 5 force of that overlap alone, 6 sum S, 11 patch.
    """
    power = 2.5 if hertz else 2.0
    for n in at[:m]:
        deepest = 0.0
        for o in at[:m]:
            deepest = max(deepest, work[o, 3] if work[o, 11] == work[n, 11] else 0.0)
        t = max(work[n, 3] / deepest, 1e-12)
        work[n, 4], work[n, 5] = t, t * np.sqrt(t) if hertz else t
    for n in at[:m]:
        work[n, 6] = 1.0
        for o in at[:m]:
            if o != n and work[o, 11] == work[n, 11]:
                work[n, 6] += _likeness(work, n, o) * _weight(work, n, o, work[o, 4] / work[n, 4])[0]
        work[n, 7] = work[n, 5] / work[n, 6]
    for n in at[:m]:
        energy = work[n, 5] * work[n, 4] / power / work[n, 6] ** 2
        for o in at[:m]:
            if o != n and work[o, 11] == work[n, 11]:
                r, exponent = _weight(work, n, o, work[o, 4] / work[n, 4])
                change = energy * _likeness(work, n, o) * exponent * r
                work[n, 7] += change / work[n, 4]
                work[o, 7] -= change / work[o, 4]


@part
def _leaders(m, at, contact, work):
    """Keep the deepest contacts of each direction, and add up the forces of those around each, in ``work[:, 8:11]``."""
    for n in at[:m]:
        contact[n] = False
        work[n, 8], work[n, 9], work[n, 10] = 0.0, 0.0, 0.0
    while True:
        best = -1
        for n in at[:m]:
            if not contact[n] and (best < 0 or work[n, 3] > work[best, 3]):
                alone = True
                for o in at[:m]:
                    alone &= not (contact[o] and work[o, 11] == work[n, 11] and _likeness(work, n, o) > 0.5)
                best = n if alone else best
        if best < 0:
            break
        contact[best] = True
    for n in at[:m]:
        leader, most = n, -2.0
        for o in at[:m]:
            if contact[o] and work[o, 11] == work[n, 11]:
                c = work[n, 0] * work[o, 0] + work[n, 1] * work[o, 1] + work[n, 2] * work[o, 2]
                leader, most = (o, c) if c > most else (leader, most)
        for q in range(3):
            work[leader, 8 + q] += work[n, 7] * work[n, q]


@part
def holds_feature(other, own, vertex, weight):
    """Whether facet ``other`` contains the edge or vertex of facet ``own`` that carries the weights; false for a face."""
    positive, sides = 0, vertex.shape[1]
    for a in range(sides):
        if weight[a] > 1e-12:
            positive += 1
            found = False
            for b in range(sides):
                found |= vertex[other, b] == vertex[own, a]
            if not found:
                return False
    return positive < sides
