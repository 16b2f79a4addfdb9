"""Mapping between particles and cells: which share w_ij of particle i belongs to cell j. The shares of a particle sum to
one."""
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI
from numpy.typing import ArrayLike

from fe_el.checks import numbers
from fe_el.compiled.cache import njit
from fe_el.compiled.parts import part
from fe_el.coupling.overlap import OverlapVolume
from fe_el.coupling.shares import ListedShares
from fe_el.particles.location import INSIDE, walk

if TYPE_CHECKING:
    from fe_el.mesh.cell_mesh import CellMesh

FAST = {"contract", "reassoc", "nsz", "arcp"}
INNER, OUTER = 0.6276065, 0.9085281  # centroids of two shells that share the sphere's volume, in radii


def isotropic_points() -> np.ndarray:
    """Centre, 6 axes and 8 cube corners at two radii: (29, 3), in radii. Second moments are nearly isotropic."""
    axes = np.vstack([np.eye(3), -np.eye(3)])
    corners = np.array([(a, b, c) for a in (1, -1) for b in (1, -1) for c in (1, -1)]) / np.sqrt(3)
    directions = np.vstack([axes, corners])
    return np.vstack([np.zeros((1, 3)), INNER * directions, OUTER * directions])


def cfdem_points() -> np.ndarray:
    """The points of CFDEMcoupling: its corners lie at polar angles of 45 degrees, so the cloud is longer in z: (29, 3)."""
    axes = np.vstack([np.eye(3), -np.eye(3)])
    corners = np.array([(a, b, c * np.sqrt(2)) for a in (1, -1) for b in (1, -1) for c in (1, -1)]) / 2
    directions = np.vstack([axes, corners])
    return np.vstack([np.zeros((1, 3)), INNER * directions, OUTER * directions])


@part(fastmath=FAST)
def _cut_facets(barycentric, c, x, y, z, r, cut, at):
    """Facets of cell c that a sphere reaches, and the barycentric coordinate of its centre there; returns their number."""
    cuts = 0
    for f in range(barycentric.shape[1]):  # the coordinate is the distance to the facet over the height there
        bx, by, bz = barycentric[c, f, 0], barycentric[c, f, 1], barycentric[c, f, 2]
        value = bx * x + by * y + bz * z + barycentric[c, f, 3]
        cut[cuts], at[cuts] = f, value
        cuts += (value < 0.0) | (value * value < r * r * (bx * bx + by * by + bz * bz))
    return cuts


@njit(fastmath=FAST)
def _inside(barycentric, c, x, y, z):
    """Whether a point is in cell c, without a branch."""
    inside = True
    for f in range(barycentric.shape[1]):
        value = barycentric[c, f, 0] * x + barycentric[c, f, 1] * y + barycentric[c, f, 2] * z + barycentric[c, f, 3]
        inside &= value >= INSIDE
    return inside


@part(fastmath=FAST)
def _outside(barycentric, c, r, points, cuts, cut, at, low, out, facet):
    """Points of a sphere outside its cell: fills ``out`` and the facet that each is farthest beyond; returns their
    number."""
    size = points.shape[1]
    for s in range(size):
        low[s] = INSIDE
        facet[s] = -1
    for n in range(cuts):
        bx, by, bz = r * barycentric[c, cut[n], 0], r * barycentric[c, cut[n], 1], r * barycentric[c, cut[n], 2]
        for s in range(size):
            value = at[n] + bx * points[0, s] + by * points[1, s] + bz * points[2, s]
            beyond = value < low[s]
            low[s] = value if beyond else low[s]
            facet[s] = cut[n] if beyond else facet[s]
    number = 0
    for s in range(size):
        out[number] = s
        number += facet[s] >= 0
    return number


@njit
def _shares(barycentric, neighbour, shift, cell, position, radius, points, start, cells, weights):
    """Fill the shares; points (3, points), in radii, that lie outside the domain do not count."""
    number, here, m, size = 0, np.empty(3), barycentric.shape[1], points.shape[1]
    periodic, cut, at, low = len(shift) > 0, np.empty(m + 1, np.int64), np.empty(m + 1), np.empty(size)
    out, facet = np.empty(size + 1, np.int32), np.empty(size, np.int32)
    for i in range(len(cell)):
        start[i] = number
        c, r = cell[i], radius[i]
        cuts = _cut_facets(barycentric, c, position[i, 0], position[i, 1], position[i, 2], r, cut, at) if size > 1 else 0
        beyond = _outside(barycentric, c, r, points, cuts, cut, at, low, out, facet) if cuts > 0 else 0
        own, found = size - beyond, 0
        for n in range(beyond):
            s = out[n]
            f = facet[s]
            target = neighbour[c, f]
            x, y, z = position[i, 0] + r * points[0, s], position[i, 1] + r * points[1, s], position[i, 2] + r * points[2, s]
            if target >= 0 and periodic:
                x, y, z = x + shift[c, f, 0], y + shift[c, f, 1], z + shift[c, f, 2]
            if target < 0 or not _inside(barycentric, target, x, y, z):  # most are in the cell across the facet
                here[0], here[1], here[2] = x, y, z
                target = walk(barycentric, neighbour, shift, target if target >= 0 else c, here, 100)
            if target < 0:
                continue
            if target == c:
                own += 1
                continue
            found += 1
            for k in range(start[i], number + 1):
                if k == number:
                    cells[number], weights[number] = target, 1.0
                    number += 1
                    break
                if cells[k] == target:
                    weights[k] += 1.0
                    break
        if own > 0 or found == 0:
            cells[number], weights[number] = c, max(own, 1)
            number += 1
            found += max(own, 1)
        for k in range(start[i], number):
            weights[k] /= found
    start[len(cell)] = number
    return number


class SatellitePoints(ListedShares):
    """Shares by points inside each particle: w_ij is the fraction of the points inside the domain that lie in cell j.

    A particle that lies wholly inside its cell is not searched.

    Args:
        points: (points, 3) in radii; absent: 29 isotropic ones. See :func:`isotropic_points`, :func:`cfdem_points`.

    Raises:
        ValueError: for points of the wrong shape or outside the particle.
    """

    def __init__(self, points: ArrayLike | None = None) -> None:
        super().__init__()
        self.points = isotropic_points() if points is None else numbers("satellite points", points)
        if self.points.ndim != 2 or self.points.shape[1] != 3 or not (np.linalg.norm(self.points, axis=1) <= 1).all():
            raise ValueError(f"The satellite points have shape {self.points.shape}; give points (points, 3) inside a sphere "
                             f"of "
                             "radius one.")

    def prepare(self, cells: "CellMesh", cell: np.ndarray, position: np.ndarray, radius: np.ndarray) -> None:
        """Find the shares of particles at ``position`` with centre in ``cell``: entries start[i]:start[i+1] of particle
        i."""
        n = len(cell)
        self._reserve(n, n * len(self.points) + 1)
        _shares(cells.barycentric, cells.neighbour, cells.shift, cell, position, radius, np.ascontiguousarray(self.points.T),
                self._start[:n + 1], self._cell, self._weight)
        self._keep(n)


class ParticleCentred(SatellitePoints):
    """All of a particle belongs to the cell of its centre."""

    def __init__(self) -> None:
        super().__init__(np.zeros((1, 3)))


@njit
def _coordinates(barycentric, cell, position, out):
    for i in range(len(cell)):
        total = 0.0
        for f in range(barycentric.shape[1]):
            b = barycentric[cell[i], f]
            out[i, f] = max(b[0] * position[i, 0] + b[1] * position[i, 1] + b[2] * position[i, 2] + b[3], 0.0)
            total += out[i, f]
        for f in range(barycentric.shape[1]):
            out[i, f] /= total


@njit
def _to_vertices(vertex, cell, weight, quantity, out):
    for i in range(len(cell)):
        for f in range(weight.shape[1]):
            for k in range(quantity.shape[1]):
                out[vertex[cell[i], f], k] += weight[i, f] * quantity[i, k]


@njit
def _at_vertices(vertex, cell, weight, values, out):
    for i in range(len(cell)):
        for k in range(values.shape[1]):
            total = 0.0
            for f in range(weight.shape[1]):
                total += weight[i, f] * values[vertex[cell[i], f], k]
            out[i, k] = total


@njit
def cells_to_vertices(vertex, volume, patch, field, out):
    """Volume-weighted means of a cell field around each vertex."""
    for c in range(len(volume)):
        for f in range(vertex.shape[1]):
            for k in range(field.shape[1]):
                out[vertex[c, f], k] += volume[c] / patch[vertex[c, f]] * field[c, k]


@njit
def _vertices_to_cells(vertex, volume, patch, values, out):
    for c in range(len(volume)):
        for f in range(vertex.shape[1]):
            for k in range(values.shape[1]):
                out[c, k] += volume[c] / patch[vertex[c, f]] * values[vertex[c, f], k]


class HatKernel:
    """Shares by P1 hat functions: continuous in time, also when a particle crosses a facet.

    A particle gives its barycentric coordinate to each vertex of its cell, and each vertex shares that out to its cells by
    their volume: w_ij = sum_v lambda_v(x_i) V_j / (volume of the cells at v). The reach is about one cell, whatever the
    particle's size.
    """

    def prepare(self, cells: "CellMesh", cell: np.ndarray, position: np.ndarray, radius: np.ndarray) -> None:
        """Coordinates of every particle in its cell."""
        self.cells, self.cell = cells, cell.copy()
        self.weight = np.empty((len(cell), cells.vertex.shape[1]))
        _coordinates(cells.barycentric, cell, position, self.weight)
        self.patch = patch_volume(cells)

    def deposit(self, quantity: np.ndarray, out: np.ndarray) -> None:
        """out[j] += sum_i w_ij quantity_i for (particles, k) quantities."""
        values = np.zeros((len(self.patch), quantity.shape[1]))
        _to_vertices(self.cells.local_vertex, self.cell, self.weight, quantity, values)
        _vertices_to_cells(self.cells.local_vertex, self.cells.volume, self.patch, values, out)

    def gather(self, field: np.ndarray, out: np.ndarray) -> None:
        """out[i] = sum_j w_ij field_j for (cells, k) fields."""
        values = np.zeros((len(self.patch), field.shape[1]))
        cells_to_vertices(self.cells.local_vertex, self.cells.volume, self.patch, field, values)
        _at_vertices(self.cells.local_vertex, self.cell, self.weight, values, out)


class WellMixed:
    """Every particle fills the whole domain evenly: no clusters, for the analytic limits of laws and schemes.

    Note:
        Collective.
    """

    def __init__(self, comm: MPI.Comm = MPI.COMM_WORLD) -> None:
        self.comm = comm

    def prepare(self, cells: "CellMesh", cell: np.ndarray, position: np.ndarray, radius: np.ndarray) -> None:
        """Each cell's part of the domain."""
        self.part = np.where(np.arange(len(cells.volume)) < cells.owned, cells.volume, 0.0)
        self.part /= self.comm.allreduce(self.part.sum())

    def deposit(self, quantity: np.ndarray, out: np.ndarray) -> None:
        """out[j] += V_j / V sum_i quantity_i for (particles, k) quantities."""
        out += self.part[:, None] * self.comm.allreduce(quantity.sum(0))

    def gather(self, field: np.ndarray, out: np.ndarray) -> None:
        """out[i] = sum_j V_j / V field_j for (cells, k) fields."""
        out[:] = self.comm.allreduce(self.part @ field)


class LinearInterpolation(HatKernel):
    """Values at particles by linear interpolation between vertex means of a cell field."""


def patch_volume(cells: "CellMesh") -> np.ndarray:
    """(vertices,) volume of the cells around each local vertex."""
    return np.bincount(cells.local_vertex.ravel(), np.repeat(cells.volume, cells.local_vertex.shape[1]),
                       len(cells.vertex_start) - 1)


MAPPINGS: dict[str, Callable[[], Any]] = {
    "overlap_volume": OverlapVolume, "satellite_points": SatellitePoints,
    "cfdem_points": lambda: SatellitePoints(cfdem_points()), "particle_centred": ParticleCentred, "hat": HatKernel,
    "well_mixed": WellMixed}


def mapping_of(choice: str | Any) -> Any:
    """A mapping from its name, or the object itself.

    Raises:
        ValueError: for an unknown name.
    """
    if isinstance(choice, str):
        if choice not in MAPPINGS:
            raise ValueError(f"There is no mapping {choice!r}; use one of {sorted(MAPPINGS)} or pass an object.")
        return MAPPINGS[choice]()
    if not all(hasattr(choice, name) for name in ("prepare", "deposit", "gather")):
        raise ValueError(f"{choice!r} is no mapping; it needs the methods prepare, deposit and gather.")
    return choice
