"""Over-filled cells hand their excess to neighbours by a linear map that is its own record, so its transpose exists.

The excess flows like a potential flow: with fluxes g (s_c - s_n) between neighbours, s is the least potential, not negative,
with which every cell fits; s is zero where a cell has room left. That is an obstacle problem. Its solution is unique,
depends
continuously on the contents, and does not depend on any order; fluxes go from high potentials to low ones, so what a cell
hands on is, in the order of the potential, a fraction of all that it ever held.
"""
import numpy as np
from mpi4py import MPI

from fe_el.compiled.cache import njit
from fe_el.parallel.exchange import raise_everywhere, sums_of, total_of

ROUND_OFF = 1e-13  # of what a cell may hold
ITERATIONS = 5000  # of conjugate gradients, for one set of full cells


@njit
def _conductance(barycentric, neighbour, volume, rows, g):
    """Area over distance of the cells of ``rows`` and their neighbours: (rows, d+1), from heights and volumes."""
    d = neighbour.shape[1] - 1
    for k in range(len(rows)):
        c = rows[k]
        for f in range(d + 1):
            b, n = barycentric[c, f], neighbour[c, f]
            area = d * volume[c] * np.sqrt(b[0] * b[0] + b[1] * b[1] + b[2] * b[2])
            g[k, f] = area * area * (d + 1) / (d * (volume[c] + volume[n])) if n >= 0 else 0.0


@njit
def _outflow(neighbour, rows, g, s, out):
    """Fluxes out of the cells of ``rows`` at potential s; returns their product with s."""
    total = 0.0
    for k in range(len(rows)):
        flux = 0.0
        for f in range(neighbour.shape[1]):
            if neighbour[rows[k], f] >= 0:
                flux += g[k, f] * (s[rows[k]] - s[neighbour[rows[k], f]])
        out[k] = flux
        total += flux * s[rows[k]]
    return total


@njit
def _descend(rows, step, direction, change, diagonal, largest, s, residual, sums):
    """A step of conjugate gradients; ``sums``: residual times preconditioned residual, and squared residual over limit."""
    sums[:] = 0.0
    for k in range(len(rows)):
        s[rows[k]] += step * direction[rows[k]]
        residual[k] -= step * change[k]
        sums[0] += residual[k] * residual[k] / diagonal[k]
        sums[1] += (residual[k] / largest[rows[k]]) ** 2


@njit
def _turn(rows, ratio, residual, diagonal, direction):
    for k in range(len(rows)):
        direction[rows[k]] = residual[k] / diagonal[k] + ratio * direction[rows[k]]


@njit
def _fill_neighbours(neighbour, rows, g, s, content, limit, full):
    """Mark cells of ``rows`` that the fluxes into them over-fill; returns how many."""
    new = 0
    for k in range(len(rows)):
        if full[rows[k]]:
            continue
        held = content[rows[k]]
        for f in range(neighbour.shape[1]):
            if neighbour[rows[k], f] >= 0:
                held += g[k, f] * (s[neighbour[rows[k], f]] - s[rows[k]])
        if held > limit[rows[k]] * (1 + 10 * ROUND_OFF):
            full[rows[k]] = True
            new += 1
    return new


@njit
def _ready_moves(neighbour, rows, g, s, content, done, source, target, fraction):
    """Moves out of the cells of ``rows``, by falling potential, that have all they will ever hold; returns their number."""
    moves = 0
    for k in range(len(rows)):
        c, held, ready = rows[k], content[rows[k]], not done[rows[k]]
        for f in range(neighbour.shape[1]):
            n = neighbour[c, f]
            if n >= 0 and s[n] > s[c]:
                held += g[k, f] * (s[n] - s[c])
                ready &= done[n] > 0
        if not ready:
            continue
        done[c] = 1
        for f in range(neighbour.shape[1]):
            n = neighbour[c, f]
            if n >= 0 and s[n] < s[c]:
                source[moves], target[moves], fraction[moves] = c, n, g[k, f] * (s[c] - s[n]) / held
                moves += 1
    return moves


@njit
def _apply(source, target, fraction, field):
    """Moves of a field, in place, one source after the other."""
    for k in range(field.shape[1]):
        whole = 0.0
        for m in range(len(source)):
            if m == 0 or source[m] != source[m - 1]:
                whole = field[source[m], k]
            field[source[m], k] -= fraction[m] * whole
            field[target[m], k] += fraction[m] * whole


@njit
def _apply_transpose(source, target, fraction, field):
    """Transpose of :func:`_apply`."""
    for k in range(field.shape[1]):
        whole = 0.0
        for m in range(len(source) - 1, -1, -1):
            if m == len(source) - 1 or source[m] != source[m + 1]:
                whole = field[source[m], k]
            field[source[m], k] += fraction[m] * (field[target[m], k] - whole)


class Spill:
    """The map that takes cell contents to contents that fit.

    Args:
        cells, halo: the cells and the exchange of cell values.
        content: (cells,) solid volume of every cell, halo included [m^3].
        largest (float): solid fraction a cell may hold.

    Attributes:
        over_filled, over_filled_everywhere (int): number of over-filled owned cells before, of this rank and of all.
        moves: rounds of (source, target, fraction), made one after the other; between them ranks exchange what they moved.

    Raises:
        RuntimeError: if the solid does not fit into the cells.

    Note:
        Collective.
    """

    def __init__(self, cells, halo, content, largest):
        self.cells, self.halo, self.moves, owned = cells, halo, [], cells.owned
        self.content, self.limit = np.ascontiguousarray(content), largest * cells.volume
        full = np.zeros(len(content), bool)
        full[:owned] = self.content[:owned] > self.limit[:owned] * (1 + 10 * ROUND_OFF)
        self.over_filled = int(full.sum())
        room = float((self.limit - self.content)[:owned].sum())
        number, room = sums_of(halo.comm, self.over_filled, room)
        self.over_filled_everywhere = int(number)
        if number:
            self._require(room > 0, largest)
            self._require(self._solve(full), largest)
            self._record()

    def _require(self, fits, largest):
        """Raise with the fullest cell if the solid does not fit."""
        owned, message = self.cells.owned, None
        solid = self.content[:owned] / self.cells.volume[:owned]
        fullest = self.halo.comm.allreduce(solid.max(initial=0.0), op=MPI.MAX) if not fits else np.inf
        if len(solid) and solid.max() >= fullest:
            c = int(solid.argmax())
            message = (f"The particles do not fit into the cells around them: cell {c} of rank {self.halo.comm.rank}, at "
                       f"{self.cells.corner[c].mean(0).tolist()}, would have solid fraction {solid[c]:g}, cells may have "
                       f"{largest:g}, and no room is left. Use fewer or smaller particles, a larger mesh, or a larger "
                       "largest_solid_fraction.")
        raise_everywhere(self.halo.comm, RuntimeError, message)

    def _solve(self, full):
        """Least potential with which every cell fits: the set of full cells grows until no cell is over-filled."""
        cells, owned = self.cells, self.cells.owned
        self.potential = np.zeros(len(full))
        while True:
            rows = np.flatnonzero(full[:owned])
            g = np.empty((len(rows), cells.neighbour.shape[1]))
            _conductance(cells.barycentric, cells.neighbour, cells.volume, rows, g)
            if not self._potential(rows, g):
                return False
            near = self._beside(rows)
            g = np.empty((len(near), cells.neighbour.shape[1]))
            _conductance(cells.barycentric, cells.neighbour, cells.volume, near, g)
            new = _fill_neighbours(cells.neighbour, near, g, self.potential, self.content, self.limit, full)
            if not total_of(self.halo.comm, new):
                return True

    def _beside(self, rows):
        """Owned cells beside cells with a potential, theirs or of other ranks."""
        cells = self.cells
        high = np.flatnonzero(self.potential > 0)
        beside = np.unique(cells.neighbour[high])
        return beside[(beside >= 0) & (beside < cells.owned)].astype(np.int64)

    def _potential(self, rows, g):
        """Potential with which the cells of ``rows`` are just full, by conjugate gradients; whether it exists."""
        neighbour, comm, s = self.cells.neighbour, self.halo.comm, self.potential
        diagonal, change, direction, sums = g.sum(1), np.empty(len(rows)), np.zeros(len(s)), np.zeros(2)
        _outflow(neighbour, rows, g, s, change)
        residual = self.content[rows] - self.limit[rows] - change
        change[:] = 0.0
        _descend(rows, 0.0, direction, change, diagonal, self.limit, s, residual, sums)
        old, ratio = self._sum(sums), 0.0
        for _ in range(ITERATIONS):
            if old[1] <= ROUND_OFF ** 2:
                self.halo.forward(s)
                return True
            _turn(rows, ratio, residual, diagonal, direction)
            self.halo.forward(direction)
            slope = total_of(comm, _outflow(neighbour, rows, g, direction, change))
            if not slope > 0:
                return False
            _descend(rows, old[0] / slope, direction, change, diagonal, self.limit, s, residual, sums)
            new = self._sum(sums)
            old, ratio = new, new[0] / old[0]
        return False

    def _sum(self, sums):
        return total_of(self.halo.comm, sums.copy())

    def _record(self):
        """Moves that make the fluxes, in rounds: a rank makes all it can before it waits for what others move."""
        cells, s = self.cells, self.potential
        np.maximum(s, 0.0, out=s)
        rows = np.flatnonzero(s[:cells.owned] > 0)
        rows = rows[np.argsort(-s[rows], kind="stable")]
        g, done = np.empty((len(rows), cells.neighbour.shape[1])), np.zeros(len(s), np.int64)
        _conductance(cells.barycentric, cells.neighbour, cells.volume, rows, g)
        left = 1
        while left:
            source, target, fraction = np.empty(g.size, np.int64), np.empty(g.size, np.int64), np.empty(g.size)
            m = _ready_moves(cells.neighbour, rows, g, s, self.content, done, source, target, fraction)
            self.moves.append((source[:m].copy(), target[:m].copy(), fraction[:m].copy()))
            self.halo.forward(done)
            left = total_of(self.halo.comm, int((done[rows] == 0).sum()))

    def __call__(self, content):
        """Contents (cells, k) after the moves; halo values complete before and after."""
        if not self.moves:
            return content
        content, owned = content.copy(), self.cells.owned
        for move in self.moves:
            content[owned:] = 0.0
            _apply(*move, content)
            self.halo.reverse_add(content)
        return self.halo.forward(content)

    def transpose(self, field):
        """Transpose of the map, for what cells give back to particles; halo values complete before and after."""
        if not self.moves:
            return field
        field = field.copy()
        for move in reversed(self.moves):
            _apply_transpose(*move, field)
            self.halo.forward(field)
        return field
