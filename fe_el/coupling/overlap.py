"""Volume that a sphere has in each cell: exact, from the parts of the sphere beyond the facets that it touches."""
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fe_el.compiled.borrowed import borrowed
from fe_el.compiled.cache import njit
from fe_el.compiled.direct_calls import Direct
from fe_el.coupling.shares import ListedShares, in_order
from fe_el.coupling.sphere_cuts import CORNER, FAST, FIRST, MIDDLE, RECORD, U, empty_notes, inwards, place_edges, take_edges
from fe_el.coupling.sphere_rooms import BLOCK, LAST, ROOM, empty_rooms, enter, keep, spread
from fe_el.coupling.sphere_walk import keep_walk, walk_through
from fe_el.particles.contacts.blocks import aligned
from fe_el.particles.location import MANY, curve_through, order_by_cell

if TYPE_CHECKING:
    from fe_el.mesh.cell_mesh import CellMesh

NEGLIGIBLE = 1e-13  # of a sphere: cells that hold less are left out
WALL = -8  # behind a facet without a neighbour


class CellRecords(NamedTuple):
    """Cells, as :func:`overlap_shares` sees them; see :func:`cell_records`."""

    geometry: np.ndarray  #: (32 cells,)
    neighbour: np.ndarray  #: (4 cells,) four times the cell behind a facet and the number of the facet there
    fourth: float  #: how far the fourth facet is: 0, or far away [m]
    shift: np.ndarray  #: (cells, d + 1, 3) to the neighbour's place in a periodic box [m], or none


def cell_records(cells):
    """A :class:`CellRecords`, in two dimensions with a fourth facet far away.

    Of each cell: the inward unit normals of its four facets (their x, y and z), the distance of facet 0 from corner 0, that
    corner, the middle and the other corners [m]. Distances are taken from a corner: small ones have small errors.
    """
    m, number = cells.neighbour.shape[1], len(cells.volume)
    slope, out = np.linalg.norm(cells.barycentric[:, :, :3], axis=2), aligned(number, RECORD)
    out[:], neighbour, normal = 0.0, np.full((number, 4), WALL, np.int32), np.zeros((number, 4, 3))
    normal[:, :m] = cells.barycentric[:, :, :3] / slope[:, :, None]
    out[:, :FIRST], out[:, FIRST] = normal.transpose(0, 2, 1).reshape(number, FIRST), 1 / slope[:, 0]
    out[:, CORNER:MIDDLE], out[:, MIDDLE:MIDDLE + 3] = cells.corner[:, 0], cells.corner.mean(1)
    out[:, MIDDLE + 3:MIDDLE + 3 * m] = cells.corner[:, 1:].reshape(number, 3 * m - 3)
    back = (cells.neighbour[cells.neighbour] == np.arange(number)[:, None, None]).argmax(2)  # facets seen from behind
    neighbour[:, :m] = np.where(cells.neighbour < 0, WALL, 4 * cells.neighbour + back)
    return CellRecords(out.ravel(), neighbour.ravel(), 0.0 if m == 4 else 1e30, cells.shift)


@njit(fastmath=FAST, error_model="numpy")
def overlap_shares(cells, slot, limit, scratch, spheres, first, start, index, weight):
    """Fill the shares of the spheres from ``first`` on; returns the first that did not fit into ``index`` or ``limit``.

    A sphere's own cell begins with all of it, and each facet that it touches hands the part of the sphere beyond it, as seen
    from the centre, from the cell before it to the cell behind, at a wall to nowhere; what is left in cells is all there is.
    Spheres are taken in blocks, so that their cells, facets and edges are loops without branches; those in many cells
    come one by one.

    Args:
        cells: a :class:`CellRecords`.
        slot: (cells,) all -1: place in the list of the sphere at hand.
        limit: cells that a sphere may be in.
        scratch: see :func:`scratch_for`.
        spheres: cell, position and radius of each.
    """
    cells, slot, scratch = borrowed((cells, slot, scratch))
    spheres, start, index, weight = borrowed((spheres, start, index, weight))
    rooms, notes = scratch
    (cell, position, radius), needed = spheres, max(U(limit) + U(1), ROOM)
    for begin in range(first, len(cell), BLOCK):
        number, end = min(BLOCK, len(cell) - begin), U(start[begin])
        enter(cells, spheres, begin, number, rooms, notes)
        edges = spread(cells, number, rooms, notes)
        place_edges(cells, notes, edges)
        take_edges(notes, edges, rooms.weight)
        for n in range(number):
            i, own = begin + n, end
            if end + needed > U(len(index)):
                return i
            if rooms.known[n] <= LAST:
                end = keep(U(n), rooms, end, NEGLIGIBLE, index, weight)
            if end == own:  # no room, or hardly anything of the sphere is in the mesh
                index[own], weight[own] = cell[i], 1.0
                inwards(cells, U(cell[i]), position[i, 0], position[i, 1], position[i, 2], radius[i], notes.centre, U(0))
                known, edges = walk_through(cells, slot, U(limit), own, index, weight, notes)
                if known == U(0):
                    return i
                place_edges(cells, notes, edges)
                take_edges(notes, edges, weight)
                end = keep_walk(known, own, NEGLIGIBLE, index, weight)
            start[i + 1] = end
    return len(cell)


def scratch_for(limit):
    """Arrays that :func:`overlap_shares` works on, for spheres in ``limit`` cells at most."""
    return empty_rooms(), empty_notes(max(int(ROOM) * BLOCK, limit))


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
        self._limit, self._scratch = 64, scratch_for(64)
        self._overlap_shares, self._spheres = Direct(overlap_shares), None

    def prepare(self, cells: "CellMesh", cell: np.ndarray, position: np.ndarray, radius: np.ndarray) -> None:
        """Find the shares of particles at ``position`` with centre in ``cell``."""
        n, done = len(cell), 0
        if self._barycentric is not cells.barycentric:
            self._barycentric, self._records = cells.barycentric, cell_records(cells)
            self._slot, self._curve = np.full(len(cells.volume), -1, np.int32), curve_through(cells)
        self._reserve(n, n + self._limit + 1)
        spheres = self._in_order(cell, position, radius)
        while done < n:
            done = self._overlap_shares(self._records, self._slot, self._limit, self._scratch, spheres, done, self._start,
                                        self._cell, self._weight)
            if done < n and self._start[done] + self._limit < len(self._cell):
                self._limit, self._scratch = 2 * self._limit, scratch_for(2 * self._limit)
            elif done < n:
                each = self._start[done] // max(done, 1) + 1
                self._reserve(n, self._start[done] + (n - done) * each + self._limit + 1)
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
