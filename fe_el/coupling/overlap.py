"""Volume that a sphere has in each cell: exact, from the parts of the sphere beyond the facets that it touches."""
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fe_el.compiled.borrowed import borrowed
from fe_el.compiled.cache import njit
from fe_el.compiled.direct_calls import Direct
from fe_el.compiled.parts import part
from fe_el.coupling.shares import ListedShares, in_order
from fe_el.coupling.sphere_cuts import FAST, U, place_edges, take_edges
from fe_el.particles.location import MANY, curve_through, order_by_cell

if TYPE_CHECKING:
    from fe_el.mesh.cell_mesh import CellMesh

NEGLIGIBLE = 1e-13  # of a sphere: cells that hold less are left out
INWARDS = 1e-8  # of the way to the middle of its cell: how far centres are moved
BLOCK = 256  # spheres whose edges are computed in one go
RECORD = 32  # numbers of a cell
OTHER = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]], U)  # facets beside each facet
PAIR = np.array([[0, 1, 2], [0, 3, 4], [1, 3, 5], [2, 4, 5]], U)  # and the numbers of these pairs

class CellRecords(NamedTuple):
    """Cells, as :func:`overlap_shares` sees them; see :func:`cell_records`."""

    geometry: np.ndarray  #: (32 cells,)
    neighbour: np.ndarray  #: (4 cells,)
    corner: np.ndarray  #: (cells, d + 1, 3) [m]
    shift: np.ndarray  #: (cells, d + 1, 3) to the neighbour's place in a periodic box [m], or none


class Notes(NamedTuple):
    """Of a cell: the centre inside its facets, in radii, and those that it reaches. Of the facets and edges of a block of
    spheres: what :func:`_visit` notes."""

    inside: np.ndarray  #: (4,)
    reached: np.ndarray  #: (4,)
    geometry: np.ndarray  #: (facets, 5)
    cut: np.ndarray  #: (facets, 3)
    code: np.ndarray  #: (edges,)
    edge: np.ndarray  #: (5, edges)


def cell_records(cells):
    """Geometry (32 cells,) and neighbours (4 cells,) of the cells, in two dimensions with a fourth facet far away.

    Of each cell: the inward unit normals of its four facets (their x, y and z), the distance of facet 0 from corner 0, the
    middle, corner 0 and the distance of facet 3 from it [m]; of facets 01, 02, 03, 12, 13, 23 the cosines between normals
    and the inverses of the sines. Distances are taken from a corner: small ones have small errors.
    """
    m, number = cells.neighbour.shape[1], len(cells.volume)
    slope, (one, other) = np.linalg.norm(cells.barycentric[:, :, :3], axis=2), np.triu_indices(4, 1)
    out, neighbour = np.zeros((number, RECORD)), np.full((number, 4), -1, np.int32)
    normal = np.zeros((number, 4, 3))
    normal[:, :m] = cells.barycentric[:, :, :3] / slope[:, :, None]
    out[:, :12] = normal.transpose(0, 2, 1).reshape(number, 12)
    out[:, 12], out[:, 13:16], out[:, 16:19] = 1 / slope[:, 0], cells.corner.mean(1), cells.corner[:, 0]
    out[:, 19] = 0.0 if m == 4 else 1e30
    out[:, 20:26] = (normal[:, one] * normal[:, other]).sum(2)
    out[:, 26:] = 1 / np.sqrt(np.maximum(1 - out[:, 20:26] ** 2, 1e-30))
    neighbour[:, :m] = cells.neighbour
    return out.ravel(), neighbour.ravel()


@part(fastmath=FAST, error_model="numpy", forceinline=True)
def _visit(cells, slot, place, r, number, shares, notes, count, e):
    """Walk from a sphere's cell through the facets that it touches; what a facet's edges take is left to be done.

    Of a facet that ends in the sphere are noted: in ``geometry`` the distance of the centre from its plane in radii, the
    centre and one over the radius, in ``cut`` cell and facet, and the entries that lose and gain the part beyond it. Of an
    edge: in ``code`` the number of the note and the facet beside, and how far inside the foot of the centre is, in radii.

    Returns:
        The number of cells, 0 for more than ``place`` has room for, and the new numbers of notes and edges.
    """
    index, weight = shares
    record, neighbour, shift = cells.geometry, cells.neighbour, cells.shift
    s, list_of, geometry, cut, code, edge = (notes.inside, notes.reached, notes.geometry, notes.cut, notes.code, notes.edge)
    periodic, scale, outside, known, done, fits = len(shift) > 0, 1 / r, U(len(index)) - U(1), U(1), U(0), True
    while fits and done < known:
        c, at, reached = U(index[number + done]), done if periodic else U(0), U(0)
        base, x, y, z = c * U(RECORD), place[at, 0], place[at, 1], place[at, 2]
        dx, dy, dz = x - record[base + U(16)], y - record[base + U(17)], z - record[base + U(18)]
        for f in range(4):
            k = base + U(f)
            s[f] = (record[k] * dx + record[k + U(4)] * dy + record[k + U(8)] * dz) * scale
        s[0] += record[base + U(12)] * scale
        s[3] += record[base + U(19)] * scale
        slot[c] = np.int32(done)
        for f in range(4):  # facets that were met from their other side are done
            target = neighbour[c * U(4) + U(f)]
            before = slot[U(max(target, 0))]
            list_of[reached] = U(f)
            reached += U((abs(s[f]) < 1) & ((target < 0) | (before < 0) | (before > np.int32(done))))
        fits = known + reached <= U(len(place))
        for n in range(reached if fits else U(0)):
            f, last, beside, above = list_of[n], e, False, True
            h = s[f]
            for k in range(3):
                g, pair = OTHER[f, k], base + PAIR[f, k]
                q = (s[g] - h * record[pair + U(20)]) * record[pair + U(26)]
                touches = q * q < 1 - h * h
                beside |= (q < 0) & (not touches)  # the sphere reaches the plane beside the facet
                above &= q >= 0
                edge[1, e], code[e] = q, count * U(4) + g
                e += U(touches)
            e = last if beside else e
            target = neighbour[c * U(4) + f]
            t = U(max(target, 0))
            new = (target >= 0) & (slot[t] < 0) & (not beside)
            there = np.int32(known) if new else slot[t]
            slot[t], index[number + known], weight[number + known] = there, np.int32(t), 0.0
            if periodic and new:
                for k in range(3):
                    place[known, k] = place[done, k] + shift[c, f, k]
            own, behind = number + done, number + U(there) if (target >= 0) & (there >= 0) else outside  # behind a wall
            forward, far = (done == U(0)) | (h >= 0), abs(h)
            source, sink = own if forward else behind, behind if forward else own
            part = 0.5 - 0.75 * far + 0.25 * far * far * far if above & (not beside) else 0.0
            weight[source] -= part
            weight[sink] += part
            geometry[count, 0], geometry[count, 1], geometry[count, 2], geometry[count, 3] = far, x, y, z
            geometry[count, 4] = scale
            cut[count, 0], cut[count, 1], cut[count, 2] = c * U(4) + f, source, sink
            count += U(not beside)
            known += U(new)
        done += U(1)
    for k in range(known):
        slot[U(index[number + U(k)])] = -1
    return known if fits else U(0), count, e


@part(fastmath=FAST, error_model="numpy")
def _keep_parts(raw, first, last, start, index, weight):
    """Shares of the spheres first to last from their parts in the cells, which stand from raw[k] on."""
    end = U(start[first])
    for i in range(last - first):
        total, begin, own = 0.0, end, index[U(raw[i])]
        for k in range(U(raw[i]), U(raw[i + 1])):
            part = weight[k]
            there = part > NEGLIGIBLE
            index[end], weight[end] = index[k], part
            total, end = total + (part if there else 0.0), end + U(there)
        if begin == end:  # hardly anything of the sphere is in the mesh
            total, index[end], weight[end] = 1.0, own, 1.0
            end += U(1)
        total = 1 / total
        for k in range(begin, end):
            weight[k] *= total
        start[first + i + 1] = end


@njit(fastmath=FAST, error_model="numpy")
def overlap_shares(cells, slot, place, scratch, spheres, first, start, index, weight):
    """Fill the shares of the spheres from ``first`` on; returns the first that did not fit into ``index`` or ``place``.

    A sphere's own cell begins with all of it, and each facet that it touches hands the part of the sphere beyond it, as seen
    from the centre, from the cell before it to the cell behind, at a wall to nowhere; what is left in cells is all there is.
    Spheres are taken in blocks, so that the edges of a block are one loop without branches.

    Args:
        cells: a :class:`CellRecords`.
        slot: (cells,) all -1: place in the list of the sphere at hand.
        place: (limit, 3) for the centre, as each cell of a periodic mesh sees it; a sphere is in ``limit`` cells at most.
        scratch: see :func:`scratch_for`.
        spheres: cell, position and radius of each.
    """
    cells, slot, place, scratch = borrowed((cells, slot, place, scratch))
    spheres, start, index, weight = borrowed((spheres, start, index, weight))
    record, (cell, position, radius), (notes, raw) = cells.geometry, spheres, scratch
    limit, i, fits, most = len(place), first, True, len(notes.geometry)
    while fits and i < len(cell):
        begin, number, count, e = i, U(start[i]), U(0), U(0)
        raw[0] = number
        while i < len(cell) and i - begin < BLOCK and count + U(4 * limit) < U(most):
            fits = number + U(limit) < U(len(index))
            if not fits:
                break
            index[number], weight[number], middle = cell[i], 1.0, U(cell[i]) * U(RECORD) + U(13)
            for k in range(3):  # to a centre on an edge its facets would have no direction
                place[0, k] = position[i, k] + INWARDS * (record[middle + U(k)] - position[i, k])
            known, count, e = _visit(cells, slot, place, radius[i], number, (index, weight), notes, count, e)
            fits = known > U(0)
            if not fits:
                break
            i, number = i + 1, number + known
            raw[i - begin] = number
        place_edges(cells.corner, notes, e)
        take_edges(notes.edge, notes.cut, notes.code, e, weight)
        _keep_parts(raw, begin, i, start, index, weight)
    return i


def scratch_for(limit):
    """Arrays that :func:`overlap_shares` works on, for spheres in ``limit`` cells at most."""
    most = max(8 * limit, 1024)  # facets of a block that end inside spheres: up to four of each cell, with three edges
    notes = Notes(np.empty(4), np.empty(4, U), np.empty((most, 5)), np.empty((most, 3), U), np.empty(3 * most, U),
                  np.empty((5, 3 * most)))
    return notes, np.empty(BLOCK + 1, U)


class OverlapVolume(ListedShares):
    """Shares by overlap: w_ij is the part of particle i's sphere inside the mesh that lies in cell j, exactly.

    Continuous in place and time, without points and axes, for particles of any size beside the cells. In two dimensions the
    spheres stand in prisms above the triangles. See Strobl, Formella & Poeschel, J. Comput. Phys. 311 (2016) 158, for
    overlaps by inclusion and exclusion; here each facet that a sphere touches is computed once, for the two cells beside it.
    Many particles that lie in memory without order are taken cell by cell.
    """

    def __init__(self) -> None:
        super().__init__()
        self._barycentric: np.ndarray | None = None
        self._place, self._scratch = np.empty((64, 3)), scratch_for(64)
        self._overlap_shares, self._spheres = Direct(overlap_shares), None

    def prepare(self, cells: "CellMesh", cell: np.ndarray, position: np.ndarray, radius: np.ndarray) -> None:
        """Find the shares of particles at ``position`` with centre in ``cell``."""
        n, done = len(cell), 0
        if self._barycentric is not cells.barycentric:
            self._barycentric, (self._geometry, self._neighbour) = cells.barycentric, cell_records(cells)
            self._slot, self._curve = np.full(len(cells.volume), -1, np.int32), curve_through(cells)
        self._reserve(n, n + len(self._place) + 1)
        spheres = self._in_order(cell, position, radius)
        around = CellRecords(self._geometry, self._neighbour, cells.corner, cells.shift)
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
        self.order = order_by_cell(cell, position, self._curve) if len(cell) >= MANY else np.empty(0, np.int32)
        if not len(self.order):
            return cell, position, radius
        if self._spheres is None or len(self._spheres[0]) != len(cell):
            self._spheres = np.empty_like(cell), np.empty_like(position), np.empty_like(radius)
        in_order(self.order, cell, position, radius, *self._spheres)
        return self._spheres
