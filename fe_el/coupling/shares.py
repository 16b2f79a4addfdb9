"""Shares kept as a list: entries start[i]:start[i+1] are the cells of particle i and its shares in them."""
import numpy as np

from fe_el.compiled.cache import njit
from fe_el.compiled.parts import part

U = np.uint64  # indices without a sign need no test for counting from the end
FAST = {"contract", "reassoc", "nsz", "arcp"}


@njit
def in_order(order, cell, position, radius, out_cell, out_position, out_radius):
    """Cells, positions and radii in another order."""
    for i in range(len(order)):
        j = order[i]
        out_cell[i], out_radius[i] = cell[j], radius[j]
        for k in range(3):
            out_position[i, k] = position[j, k]


# Loops run over the entries of all particles, not over those of each: how many a particle has cannot be foreseen, and at
# each wrong guess a processor starts anew. Every particle has one at least.

@part(fastmath=FAST)
def _next(start, row, n):
    """The row of entry n + 1, if that of entry n is ``row``."""
    return row + U(start[row + U(1)] == n + 1)


@part(fastmath=FAST)
def _deposit_four(start, cell, weight, order, quantity, k, out):
    """Four columns from k on: one vector instruction each."""
    row, ordered = U(0), len(order) > 0
    for n in range(len(cell)):
        i, j, w = U(order[row]) if ordered else row, U(cell[n]), weight[n]
        out[j, k] += w * quantity[i, k]
        out[j, k + 1] += w * quantity[i, k + 1]
        out[j, k + 2] += w * quantity[i, k + 2]
        out[j, k + 3] += w * quantity[i, k + 3]
        row = _next(start, row, n)


@njit(fastmath=FAST)
def _deposit(start, cell, weight, order, quantity, out):
    k, ordered = 0, len(order) > 0
    while k + 3 < quantity.shape[1]:
        _deposit_four(start, cell, weight, order, quantity, k, out)
        k += 4
    for m in range(k, quantity.shape[1]):
        row = U(0)
        for n in range(len(cell)):
            out[U(cell[n]), m] += weight[n] * quantity[U(order[row]) if ordered else row, m]
            row = _next(start, row, n)


@part(fastmath=FAST)
def _gather_six(start, cell, weight, order, field, k, out):
    """Six columns from k on."""
    row, ordered = U(0), len(order) > 0
    a = b = c = d = e = f = 0.0
    for n in range(len(cell)):
        i, j, w = U(order[row]) if ordered else row, U(cell[n]), weight[n]
        a, b, c = a + w * field[j, k], b + w * field[j, k + 1], c + w * field[j, k + 2]
        d, e, f = d + w * field[j, k + 3], e + w * field[j, k + 4], f + w * field[j, k + 5]
        out[i, k], out[i, k + 1], out[i, k + 2], out[i, k + 3], out[i, k + 4], out[i, k + 5] = a, b, c, d, e, f
        last, row = row, _next(start, row, n)
        a, b, c = a if row == last else 0.0, b if row == last else 0.0, c if row == last else 0.0
        d, e, f = d if row == last else 0.0, e if row == last else 0.0, f if row == last else 0.0


@part(fastmath=FAST)
def _gather_four(start, cell, weight, order, field, k, out):
    """Four columns from k on."""
    row, ordered = U(0), len(order) > 0
    a = b = c = d = 0.0
    for n in range(len(cell)):
        i, j, w = U(order[row]) if ordered else row, U(cell[n]), weight[n]
        a, b, c, d = a + w * field[j, k], b + w * field[j, k + 1], c + w * field[j, k + 2], d + w * field[j, k + 3]
        out[i, k], out[i, k + 1], out[i, k + 2], out[i, k + 3] = a, b, c, d
        last, row = row, _next(start, row, n)
        a, b = a if row == last else 0.0, b if row == last else 0.0
        c, d = c if row == last else 0.0, d if row == last else 0.0


@njit(fastmath=FAST)
def _gather(start, cell, weight, order, field, out):
    k, ordered = 0, len(order) > 0
    while k + 3 < field.shape[1]:
        if k + 5 < field.shape[1]:
            _gather_six(start, cell, weight, order, field, k, out)
            k += 6
        else:
            _gather_four(start, cell, weight, order, field, k, out)
            k += 4
    for m in range(k, field.shape[1]):
        row, a = U(0), 0.0
        for n in range(len(cell)):
            a += weight[n] * field[U(cell[n]), m]
            out[U(order[row]) if ordered else row, m] = a
            last, row = row, _next(start, row, n)
            a = a if row == last else 0.0


@njit(fastmath=FAST)
def _concentration(start, cell, weight, order, volume, out):
    ordered = len(order) > 0
    for row in range(len(start) - 1):
        total = 0.0
        for n in range(start[row], start[row + 1]):
            total += weight[n] * weight[n] / volume[cell[n]]
        out[order[row] if ordered else row] = total


class ListedShares:
    """Deposits and gathers by listed shares, in arrays that are made anew only to grow.

    Attributes:
        start: (particles + 1,) first entry of each particle.
        cell, weight: (entries,) cells and shares.
        order: (particles,) the particle whose entries come first, second, ...; empty: as they are.
    """

    def __init__(self):
        self._start, self._cell, self._weight = np.zeros(1, np.int64), np.empty(0, np.int32), np.empty(0)
        self.order = np.empty(0, np.int32)

    def _reserve(self, particles, entries):
        """Make room for so many particles and entries; what is there stays."""
        if len(self._start) <= particles:
            self._start = np.resize(self._start, particles + particles // 8 + 1)
        if len(self._cell) < entries:
            more = entries + entries // 8 - len(self._cell)
            self._cell = np.append(self._cell, np.empty(more, np.int32))
            self._weight = np.append(self._weight, np.empty(more))

    def _keep(self, particles):
        """Show what was filled."""
        number = self._start[particles]
        self.start, self.cell, self.weight = self._start[:particles + 1], self._cell[:number], self._weight[:number]

    def deposit(self, quantity: np.ndarray, out: np.ndarray) -> None:
        """out[j] += sum_i w_ij quantity_i for (particles, k) quantities."""
        _deposit(self.start, self.cell, self.weight, self.order, quantity, out)

    def gather(self, field: np.ndarray, out: np.ndarray) -> None:
        """out[i] = sum_j w_ij field_j for (cells, k) fields."""
        _gather(self.start, self.cell, self.weight, self.order, field, out)

    def concentration(self, volume: np.ndarray) -> np.ndarray:
        """(particles,) sum_j w_ij^2 / volume_j: one over the volume that a particle's force acts in [1/m^3]."""
        out = np.empty(len(self.start) - 1)
        _concentration(self.start, self.cell, self.weight, self.order, volume, out)
        return out
