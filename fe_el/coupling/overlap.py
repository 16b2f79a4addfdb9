"""Volume that a sphere has in each cell: exact, from the parts of the sphere beyond the facets that it touches."""
import numpy as np
from numba import njit

from fe_el.borrowed import borrowed
from fe_el.coupling.shares import MANY, ListedShares, in_order, order_by_cell
from fe_el.direct_calls import Direct

FAST = {"contract", "reassoc", "nsz", "arcp"}
BALL = 4 * np.pi / 3  # volume of a sphere, in cubed radii
NEGLIGIBLE = 1e-13  # of a sphere: cells that hold less are left out
INWARDS = 1e-8  # of the way to the middle of its cell: how far centres are moved
# Only _visit is put into its caller by numba: with _cut and _inside too it is a fifth faster, but takes 45 s in place of 10
# to compile.
BLOCK = 256  # spheres whose edges are computed in one go
TAN_EIGHTH = np.sqrt(2) - 1  # tangent of an eighth of pi


def _arctangent_series(terms=10):
    """Coefficients c of arctan(q) = q (c_0 + c_1 q^2 + ...) up to tan(pi/8), by Chebyshev interpolation: 1e-15."""
    def ratio(z):
        q = np.sqrt(0.5 * TAN_EIGHTH ** 2 * (z + 1))
        return np.arctan(q) / q
    series = np.polynomial.Chebyshev.interpolate(ratio, terms - 1)
    return tuple(series(np.polynomial.Polynomial([-1.0, 2 / TAN_EIGHTH ** 2])).coef.tolist())


C0, C1, C2, C3, C4, C5, C6, C7, C8, C9 = _arctangent_series()


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _angle(y, x):
    """Angle of the vector (x, y), with y not negative, from the x axis: 0 to pi."""
    a = abs(x)
    large, small = max(a, y), min(a, y)
    fold = small > TAN_EIGHTH * large
    q = (small - large if fold else small) / ((small + large if fold else large) + 1e-300)
    z = q * q
    z2 = z * z
    z4 = z2 * z2
    series = (C0 + C1 * z) + z2 * (C2 + C3 * z) + z4 * ((C4 + C5 * z) + z2 * (C6 + C7 * z) + z4 * (C8 + C9 * z))
    angle = q * series + (0.25 * np.pi if fold else 0.0)
    angle = 0.5 * np.pi - angle if y > a else angle
    return np.pi - angle if x < 0 else angle


def facet_planes(cells):
    """Planes (cells, 4, 4) and neighbours (cells, 4), in two dimensions with a fourth facet far away.

    The distance of a point x inside facet f is p[:3, f] . (x - corner 0) + p[3, f] [m]: small numbers have small errors.
    """
    m, number = cells.neighbour.shape[1], len(cells.volume)
    slope = np.linalg.norm(cells.barycentric[:, :, :3], axis=2)
    plane, neighbour = np.zeros((number, 4, 4)), np.full((number, 4), -1, np.int32)
    plane[:, :3, :m] = (cells.barycentric[:, :, :3] / slope[:, :, None]).transpose(0, 2, 1)
    plane[:, 3, 0], plane[:, 3, m:] = 1 / slope[:, 0], 1e30
    neighbour[:, :m] = cells.neighbour
    return plane, neighbour


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _cut(plane, corner, c, f, x, y, z, r, work, touched, edge, e):
    """Edges at which facet f of cell c ends inside a sphere, written to ``edge`` from e on.

    Row 0 of ``work`` holds the distance of the centre inside the plane of each facet, in radii.

    Returns:
        Their end, -1 if the sphere reaches the facet's plane beside the facet only; and the part of a unit sphere beyond the
        plane, none if the foot of the centre is outside the facet.
    """
    n0, n1, n2, height = plane[c, 0, f], plane[c, 1, f], plane[c, 2, f], work[0, f]
    room, number, beside, above = 1 - height * height, 0, False, True
    for g in range(4):
        cosine = n0 * plane[c, 0, g] + n1 * plane[c, 1, g] + n2 * plane[c, 2, g]
        work[1, g], work[2, g] = work[0, g] - height * cosine, 1 - cosine * cosine
    work[1, f] = 2.0
    for g in range(4):
        touches = work[1, g] * work[1, g] < room * work[2, g]
        beside |= (work[1, g] < 0) & (not touches)
        touched[number] = g
        number += touches
    height, end = abs(height), -1 if beside else e + number
    for n in range(0 if beside else number):
        g, at = touched[n], e + n
        above &= work[1, g] >= 0
        edge[0, at], edge[1, at], edge[2, at] = height, work[1, g], work[2, g]
        edge[3, at], edge[4, at], edge[5, at] = -1e30, 1e30, 1.0
        if corner.shape[1] == 4:  # the edge of the facets f and g joins the other two vertices
            p = np.uint64(0 if f > 0 and g > 0 else (1 if f != 1 and g != 1 else 2))
            q = np.uint64(6 - f - g) - p
            x0, y0, z0 = corner[c, p, 0], corner[c, p, 1], corner[c, p, 2]
            e0, e1, e2 = corner[c, q, 0] - x0, corner[c, q, 1] - y0, corner[c, q, 2] - z0
            along, square = (x0 - x) * e0 + (y0 - y) * e1 + (z0 - z) * e2, e0 * e0 + e1 * e1 + e2 * e2
            edge[3, at], edge[4, at], edge[5, at] = along / r, (along + square) / r, square
    return end, BALL * (0.5 - 0.75 * height + 0.25 * height * height * height) if above else 0.0


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _take_edges(edge, facet, number, beyond):
    """Take from the part beyond each facet's plane what lies beyond its edges: the part in the cone through the facet is
    left.

    Per edge: the part of a unit sphere beyond a plane at distance h, in the directions between a piece of a line in it and
    farther out. The line is t from the foot of the centre in the plane, the piece lies from ``low`` to ``high`` along it and
    inside the sphere. With R = sqrt(h^2 + t^2 + l^2), the integral of (1 - r^3)/3 over the directions between l = 0 and l is
    (2 arctan(h l, t R) - h (3 - h^2) arctan(l, t) + h t l) / 6; the difference of two arcs is one arc.
    """
    for e in range(number):
        h, inside = edge[0, e], edge[1, e] / np.sqrt(edge[2, e])
        t, scale = abs(inside), 1 / np.sqrt(edge[5, e])
        square = h * h + t * t
        half = np.sqrt(max(1 - square, 0.0))
        low, high = max(-half, edge[3, e] * scale), min(half, edge[4, e] * scale)
        high = max(low, high)
        a, b = np.sqrt(square + low * low), np.sqrt(square + high * high)
        arc = _angle(h * t * (high * a - low * b), t * t * a * b + h * h * low * high)
        around = _angle(t * (high - low), t * t + low * high)
        part = (2 * arc - h * (3 - h * h) * around + h * t * (high - low)) / 6
        edge[0, e] = part if inside >= 0 else -part
    for e in range(number):
        beyond[facet[e]] -= edge[0, e]


@njit(cache=True, fastmath=FAST, error_model="numpy", inline="always")
def _visit(plane, corner, neighbour, shift, slot, place, r, number, index, work, list_of, edge, facet, entry, beyond, count,
           e):
    """Walk from a sphere's cell through the facets that it touches: the cells go to ``index``, from ``number`` on.

    Returns:
        The number of cells, 0 for more than ``place`` has room for, and the new numbers of facets and edges.
    """
    periodic, known, done, fits, scale = len(shift) > 0, 1, 0, True, 1 / r
    while fits and done < known:
        c, at, reached = np.uint64(index[number + done]), done if periodic else 0, 0
        x, y, z = place[at, 0], place[at, 1], place[at, 2]
        dx, dy, dz = x - corner[c, 0, 0], y - corner[c, 0, 1], z - corner[c, 0, 2]
        for f in range(4):
            work[0, f] = (plane[c, 0, f] * dx + plane[c, 1, f] * dy + plane[c, 2, f] * dz + plane[c, 3, f]) * scale
        slot[c] = done
        for f in range(4):  # facets that were met from their other side are done
            target = neighbour[c, f]
            before = slot[np.uint64(max(target, 0))]
            list_of[0, reached] = f
            reached += (abs(work[0, f]) < 1) & ((target < 0) | (before < 0) | (before > done))
        for n in range(reached):
            f = list_of[0, n]
            end, cap = _cut(plane, corner, c, f, x, y, z, r, work, list_of[1], edge, e)
            if end < 0:
                continue
            target, behind = neighbour[c, f], len(index) - 1 - number  # behind a wall: nowhere
            if target >= 0:
                behind = slot[np.uint64(target)]
            if behind < 0:
                if known == len(place):
                    fits = False
                    break
                behind = known
                slot[np.uint64(target)], index[number + known] = known, target
                if periodic:
                    for k in range(3):
                        place[known, k] = place[done, k] + shift[c, f, k]
                known += 1
            forward = done == 0 or work[0, f] >= 0
            entry[count, 0], entry[count, 1] = number + (done if forward else behind), number + (behind if forward else done)
            beyond[count] = cap
            while e < end:
                facet[e] = count
                e += 1
            count += 1
        done += 1
    for k in range(known):
        slot[np.uint64(index[number + k])] = -1
    return known if fits else 0, count, e


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _share_out(entry, beyond, count, raw, first, last, start, index, weight):
    """Shares of the spheres first to last, whose cells stand from raw[k] on, from the parts beyond facets."""
    for k in range(raw[0], raw[last - first]):
        weight[k] = 0.0
    for k in range(last - first):
        weight[raw[k]] = BALL
    for k in range(count):
        weight[entry[k, 0]] -= beyond[k]
        weight[entry[k, 1]] += beyond[k]
    end = start[first]
    for i in range(first, last):
        total, begin, own = 0.0, end, index[raw[i - first]]
        for k in range(raw[i - first], raw[i - first + 1]):
            if weight[k] > NEGLIGIBLE * BALL:
                total, index[end], weight[end] = total + weight[k], index[k], weight[k]
                end += 1
        if begin == end:  # hardly anything of the sphere is in the mesh
            total, index[end], weight[end] = 1.0, own, 1.0
            end += 1
        for k in range(begin, end):
            weight[k] /= total
        start[i + 1] = end


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _inside(plane, corner, c, x, y, z, r):
    """Whether a sphere is wholly inside cell c."""
    x, y, z, inside = x - corner[c, 0, 0], y - corner[c, 0, 1], z - corner[c, 0, 2], True
    for f in range(4):
        inside &= plane[c, 0, f] * x + plane[c, 1, f] * y + plane[c, 2, f] * z + plane[c, 3, f] >= r
    return inside


@njit(cache=True, fastmath=FAST, error_model="numpy")
def overlap_shares(cells, slot, place, scratch, spheres, first, start, index, weight):
    """Fill the shares of the spheres from ``first`` on; returns the first that did not fit into ``index`` or ``place``.

    A sphere's own cell begins with all of it, and each facet that it touches hands the part of the sphere beyond it, as seen
    from the centre, from the cell before it to the cell behind, at a wall to nowhere; what is left in cells is all there is.
    Spheres are taken in blocks, so that the edges of a block are one loop without branches.

    Args:
        cells: planes, corners, neighbours (see :func:`facet_planes`) and shifts of the cells.
        slot: (cells,) all -1: place in the list of the sphere at hand.
        place: (limit, 3) for the centre, as each cell of a periodic mesh sees it; a sphere is in ``limit`` cells at most.
        scratch: see :func:`scratch_for`.
        spheres: cell, position and radius of each.
    """
    cells, slot, place, scratch = borrowed((cells, slot, place, scratch))
    spheres, start, index, weight = borrowed((spheres, start, index, weight))
    plane, corner, neighbour, shift = cells
    cell, position, radius = spheres
    edge, facet, entry, beyond, work, list_of, raw = scratch
    limit, i, fits, most = len(place), first, True, len(facet)
    while fits and i < len(cell):
        begin, number, count, e = i, start[i], 0, 0
        raw[0] = number
        while i < len(cell) and i - begin < BLOCK and e + 6 * limit + 6 <= most:
            fits = number + limit < len(index)
            if not fits:
                break
            index[number] = cell[i]
            known, facets, edges = 1, count, e
            if not _inside(plane, corner, cell[i], position[i, 0], position[i, 1], position[i, 2], radius[i]):
                for k in range(3):  # to a centre on an edge its facets would have no direction
                    middle = 0.0
                    for v in range(corner.shape[1]):
                        middle += corner[cell[i], v, k] / corner.shape[1]
                    place[0, k] = position[i, k] + INWARDS * (middle - position[i, k])
                known, facets, edges = _visit(plane, corner, neighbour, shift, slot, place, radius[i], number, index, work,
                                              list_of, edge, facet, entry, beyond, count, e)
            fits = known > 0
            if not fits:
                break
            i, number, count, e = i + 1, number + known, facets, edges
            raw[i - begin] = number
        _take_edges(edge, facet, e, beyond)
        _share_out(entry, beyond, count, raw, begin, i, start, index, weight)
    return i


def scratch_for(limit):
    """Arrays that :func:`overlap_shares` works on, for spheres in ``limit`` cells at most."""
    most = max(8 * limit, 1024)  # a sphere has 2 facets per cell and 3 edges per facet at most
    return (np.empty((6, most)), np.empty(most, np.int64), np.empty((most, 2), np.int64), np.empty(most), np.empty((3, 4)),
            np.empty((2, 5), np.int64), np.empty(BLOCK + 1, np.int64))


class OverlapVolume(ListedShares):
    """Shares by overlap: w_ij is the part of particle i's sphere inside the mesh that lies in cell j, exactly.

    Continuous in place and time, without points and axes, for particles of any size beside the cells. In two dimensions the
    spheres stand in prisms above the triangles. See Strobl, Formella & Poeschel, J. Comput. Phys. 311 (2016) 158, for
    overlaps by inclusion and exclusion; here each facet that a sphere touches is computed once, for the two cells beside it.
    Many particles that lie in memory without order are taken cell by cell.
    """

    def __init__(self):
        super().__init__()
        self._barycentric, self._place, self._scratch = None, np.empty((64, 3)), scratch_for(64)
        self._overlap_shares, self._spheres = Direct(overlap_shares), None

    def prepare(self, cells, cell, position, radius):
        """Find the shares of particles at ``position`` with centre in ``cell``."""
        n, done = len(cell), 0
        if self._barycentric is not cells.barycentric:
            self._barycentric, (self._plane, self._neighbour) = cells.barycentric, facet_planes(cells)
            self._slot = np.full(len(cells.volume), -1, np.int32)
        self._reserve(n, n + len(self._place) + 1)
        spheres, around = self._in_order(cell, position, radius), (self._plane, cells.corner, self._neighbour, cells.shift)
        while done < n:
            done = self._overlap_shares(around, self._slot, self._place, self._scratch, spheres, done, self._start,
                                        self._cell, self._weight)
            if done < n and self._start[done] + len(self._place) < len(self._cell):
                self._place, self._scratch = np.empty((2 * len(self._place), 3)), scratch_for(2 * len(self._place))
            elif done < n:
                each = self._start[done] // max(done, 1) + 1
                self._reserve(n, self._start[done] + (n - done) * each + len(self._place) + 1)
        self._keep(n)

    def _in_order(self, cell, position, radius):
        """Cells, positions and radii, cell by cell where that pays."""
        self.order = order_by_cell(cell, len(self._slot)) if len(cell) >= MANY else np.empty(0, np.int32)
        if not len(self.order):
            return cell, position, radius
        if self._spheres is None or len(self._spheres[0]) != len(cell):
            self._spheres = np.empty_like(cell), np.empty_like(position), np.empty_like(radius)
        in_order(self.order, cell, position, radius, *self._spheres)
        return self._spheres
