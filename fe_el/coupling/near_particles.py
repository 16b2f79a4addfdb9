"""Smoothing near particles only: the rows of the matrix that the smoothing of what is in some cells reaches.

What particles give off is zero in most cells of a jet, and what they feel is asked for where they are. The smoothing's
kernel falls by e over a length l in fine meshes, and faster than that per cell in coarse ones: where the sum along every way
from a filled cell is more than the logarithm of the tolerance, nothing of it is left. There the unknowns are taken as zero;
that is a principal part of the matrix, so the map stays self-adjoint and the polynomial's bounds hold.
"""
from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI

from fe_el.compiled.cache import njit
from fe_el.compiled.for_each_dimension import M, by_dimension
from fe_el.coupling.polynomial import MatrixRows, Part, cut_out
from fe_el.parallel.exchange import Halo, total_of

if TYPE_CHECKING:
    from fe_el.coupling.smoothing import HelmholtzSmoothing

WORTH = 0.7  # share of all nodes, from which on the whole is smoothed
STEPS = 50  # after which cells that particles have left are given up


def ways_between(matrix, nodes, length):
    """(entries,) lengths between neighbouring nodes, as the number of e-folds of the discrete kernel along them.

    On a line of nodes at distance h the kernel falls by acosh(1 + h^2 / (2 l^2)) = 2 asinh(h / (2 l)) from one to the next.
    Edges are those of the cells, as nodes of a periodic mesh have one place only; rounded, so that no sum depends on ranks.
    """
    edge = nodes.corner[:, :, None] - nodes.corner[:, None]
    squares = []
    for elements in (np.einsum("cijk,cijk->cij", edge, edge), np.ones(edge.shape[:3])):
        matrix.values.fill(0.0)
        matrix.add(elements)
        matrix.assemble()
        squares.append(matrix.matrix.getValuesCSR()[2])
    return np.float32(2 * np.arcsinh(np.sqrt(squares[0] / squares[1]) / (2 * length))).astype(float)


@njit
def _walk(start, column, length, limit, way, queue, waiting):
    """Shorten the ways to owned nodes from those that are in the queue; where ``waiting``, a node is in it."""
    owned, first, number = len(start) - 1, 0, len(queue)
    ring = np.empty(max(owned, 1), np.int64)
    ring[:number] = queue
    while number:
        i = ring[first]
        first, number, waiting[i] = (first + 1) % owned, number - 1, False
        for n in range(start[i], start[i + 1]):
            j, there = column[n], way[i] + length[n]
            if j < owned and there < limit and there < way[j]:
                way[j] = there
                if not waiting[j]:
                    waiting[j] = True
                    ring[(first + number) % owned] = j
                    number += 1


@njit
def _from_other_ranks(border, start, column, length, limit, way, waiting):
    """Shorten the ways to owned nodes of the border from those of other ranks, and mark those that changed."""
    owned = len(start) - 1
    for i in border:
        for n in range(start[i], start[i + 1]):
            there = way[column[n]] + length[n]
            if column[n] >= owned and there < limit and there < way[i]:
                way[i], waiting[i] = there, True


@by_dimension
def _mark(dofs, cells, out):
    """Mark the nodes of cells."""
    for c in cells:
        for i in range(M):
            out[dofs[c, i], 0] = 1.0


@by_dimension
def _touched(dofs, active, out):
    """Mark the cells that have an active node."""
    for c in range(len(dofs)):
        for i in range(M):
            out[c] |= active[dofs[c, i]]


@by_dimension
def _load(dofs, cells, volume, field, columns, out):
    """Add the integrals over cells of a field (cells, k) in equal shares to the nodes; ``columns``: a tuple of k numbers, so
    that the compiler knows k."""
    for c in cells:
        share = volume[c] / M
        for i in range(M):
            for k in range(len(columns)):
                out[dofs[c, i], k] += share * field[c, k]


@by_dimension
def _means(dofs, cells, values, columns, out):
    """Means over cells of nodal values (nodes, k)."""
    share = 1.0 / M
    for c in cells:
        for k in range(len(columns)):
            total = 0.0
            for i in range(M):
                total += values[dofs[c, i], k]
            out[c, k] = share * total


class NearParticles:
    """Smoothing of fields that come from particles, and for them: :meth:`spread` and its transpose :meth:`back`.

    With P the polynomial on the active rows and m their masses, 1 - P m is the part that P loses of a load at each row: what
    the polynomial loses on all rows, too, d, stays where it is; what is cut off, e = 1 - P m - d, goes to the rim. The map
    from loads to values is P + d/m + e g^T + g e^T - (e.m) g g^T. g has g.m = 1 and is zero but at the rim of the active
    rows, where both are small; so the map is symmetric and keeps integrals and constants to round-off. (All that is lost
    at the rim would be a layer of as much as the tolerance times the depth of a bed, of either sign.)

    Args:
        smoothing (HelmholtzSmoothing): what is cut off.
        filled: mask (owned cells,) of cells with particles; these and their neighbours can give off and feel.
        ways, reach: see :func:`ways_between`, and how long a way may be.
        steps (int): for how many steps cells have been collected.

    Note:
        Collective.
    """

    def __init__(self, smoothing: "HelmholtzSmoothing", filled: np.ndarray, ways: np.ndarray, reach: float,
                 steps: int = 0) -> None:
        self.smoothing, self.mask, self.steps, self.lost, nodes = smoothing, filled, steps, None, smoothing.nodes
        n = nodes.owned_nodes
        marks = self._marked(np.flatnonzero(filled))
        self.served = self._touched(nodes.node_halo.forward(marks))
        self.filled = np.flatnonzero(self.served).astype(np.uint32)
        active = self._shortest(ways, reach)[:n] < reach
        counts = nodes.comm.allreduce(np.array([active.sum(), n]))
        self.whole = bool(counts[0] > WORTH * counts[1])
        if not self.whole:
            self._cut_out(np.flatnonzero(active))
            marks.fill(0.0)
            marks[self.part.at] = 1.0
            self.around = np.flatnonzero(self._touched(nodes.node_halo.forward(marks))).astype(np.uint32)

    def _cut_out(self, at):
        """The part of the matrix in the active rows ``at``, and which of them are at the rim."""
        of, n, m = self.smoothing, self.smoothing.nodes.owned_nodes, len(at)
        number, whole = np.full((of.rows, 1), -1.0), of.matrix_rows
        number[at, 0] = np.arange(m)
        ghosts = np.flatnonzero(of.halo.forward(number)[n:, 0] >= 0)
        halo = Halo.of_requests(of.nodes.comm, m + np.arange(len(ghosts)), of.ghost_owners[ghosts],
                                number[n + ghosts, 0].astype(np.int64))
        number[n + ghosts, 0] = m + np.arange(len(ghosts))
        start, self.rim = np.zeros(m + 1, np.uint64), np.zeros(m)
        column, value = np.empty(len(whole.column), np.uint32), np.empty(len(whole.column))
        at = at.astype(np.uint32)
        cut_out(whole, at, number[:, 0].astype(np.int32), start, column, value, self.rim)
        rows = MatrixRows(start, column[:int(start[-1])].copy(), value[:int(start[-1])].copy(), whole.inverse_diagonal[at])
        self.part = Part(at, rows, halo, m + len(ghosts))

    def _marked(self, cells):
        """Marks (nodes, 1) at the nodes of cells, more than zero also at owned nodes of other ranks' cells."""
        nodes = self.smoothing.nodes
        marks = np.zeros((nodes.nodes, 1))
        _mark(nodes.dofs, cells.astype(np.uint32), marks)
        return nodes.node_halo.reverse_add(marks)

    def _touched(self, marks):
        """Mask of the cells that have a marked node."""
        out = np.zeros(len(self.mask), bool)
        _touched(self.smoothing.nodes.dofs, marks[:, 0] > 0, out)
        return out

    def _shortest(self, lengths, limit):
        """Shortest ways (rows,) from the nodes of the filled cells, on which no node is as far as the limit."""
        of, nodes = self.smoothing, self.smoothing.nodes
        n, rows = nodes.owned_nodes, of.matrix_rows
        waiting, way = self._marked(self.filled)[:n, 0] > 0, np.full(of.rows, np.inf)
        way[:n][waiting] = 0.0
        while True:
            _walk(rows.start, rows.column, lengths, limit, way, np.flatnonzero(waiting), waiting)
            if nodes.comm.size == 1:
                return way
            of.halo.forward(way[:, None])
            _from_other_ranks(of.border, rows.start, rows.column, lengths, limit, way, waiting)
            if not nodes.comm.allreduce(int(waiting.sum())):
                return way

    def cells_of_next(self, filled: np.ndarray) -> np.ndarray | None:
        """Mask of the cells to be served in the next step, whose particles are in the filled ones (a mask); None: the same.

        Cells are collected, so that most steps find all as it was, and some never change anything.
        """
        self.steps += 1
        more = not self.whole and bool((filled & ~self.served).any())
        if self.steps >= STEPS:
            return filled
        return filled | self.mask if total_of(self.smoothing.nodes.comm, int(more)) else None

    def spread(self, field: np.ndarray) -> np.ndarray:
        """Smoothed cell field (owned cells, k) of one that is zero but in the filled cells."""
        return self.smoothing(field) if self.whole else self._smoothed(field, self.filled, self.around)

    def back(self, field: np.ndarray) -> np.ndarray:
        """Smoothed cell field (owned cells, k) in the filled cells; zero in others."""
        return self.smoothing(field) if self.whole else self._smoothed(field, self.around, self.filled)

    def _smoothed(self, field, source, target):
        nodes, out, columns = self.smoothing.nodes, np.zeros_like(field), (0,) * field.shape[1]
        if columns:
            values = np.zeros((nodes.nodes, len(columns)))
            _load(nodes.dofs, source, nodes.volume, field, columns, values)
            self._solve(nodes.node_halo.reverse_add(values))
            _means(nodes.dofs, target, nodes.node_halo.forward(values), columns, out)
        return out

    def _solve(self, values):
        """Loads (nodes, k) become values in place on the active rows; elsewhere they are zero, or no cell that is asked for
        has the node. The first time P m is found, too."""
        of, comm, at, k = self.smoothing, self.smoothing.nodes.comm, self.part.at, values.shape[1]
        load, sums = values[:len(of.mass)], np.zeros((2, k))
        found = of.solve(load if self.lost is not None else np.column_stack([load, of.mass]), self.part)
        if self.lost is None:
            mass, rim = of.mass[at], self.rim
            self.lost = 1 - of.missing[at] * mass - of.scale * found[:, k]
            rim_mass, self.lost_mass, all_mass = comm.allreduce(np.array([rim @ mass, self.lost @ mass, mass.sum()]))
            self.rim = rim / rim_mass if rim_mass else np.full(len(at), 1 / max(all_mass, 1e-300))
        _sums(at, self.lost, self.rim, values, sums)
        comm.Allreduce(MPI.IN_PLACE, sums)
        lost, at_rim = sums
        _fill(at, of.scale, found, of.missing, self.lost, self.rim, (at_rim, lost - self.lost_mass * at_rim), values)


@njit
def _sums(at, lost, rim, load, out):
    """Sums over the active rows of the load times what is lost of it, and times the rim."""
    for n in range(len(at)):
        for k in range(load.shape[1]):
            out[0, k] += lost[n] * load[at[n], k]
            out[1, k] += rim[n] * load[at[n], k]


@njit
def _fill(at, scale, found, missing, lost, rim, along, values):
    """Values from loads, in place; ``along``: factors of what is lost and of the rim."""
    as_lost, at_rim = along
    for n in range(len(at)):
        i = at[n]
        for k in range(values.shape[1]):
            values[i, k] = scale * found[n, k] + missing[i] * values[i, k] + lost[n] * as_lost[k] + rim[n] * at_rim[k]
