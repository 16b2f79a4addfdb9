"""Shares kept as a list: entries start[i]:start[i+1] are the cells of particle i and its shares in them."""
import numpy as np

from fe_el.compiled.cache import njit

FAST = {"contract", "reassoc", "nsz", "arcp"}


@njit
def in_order(order, cell, position, radius, out_cell, out_position, out_radius):
    """Cells, positions and radii in another order."""
    for i in range(len(order)):
        j = order[i]
        out_cell[i], out_radius[i] = cell[j], radius[j]
        for k in range(3):
            out_position[i, k] = position[j, k]


@njit(fastmath=FAST)
def _deposit(start, cell, weight, order, quantity, out):
    ordered = len(order) > 0
    for row in range(len(start) - 1):
        i, k = order[row] if ordered else row, 0
        while k + 3 < quantity.shape[1]:  # columns in fours: one vector instruction each
            a, b, c, d = quantity[i, k], quantity[i, k + 1], quantity[i, k + 2], quantity[i, k + 3]
            for n in range(start[row], start[row + 1]):
                j, w = np.uint64(cell[n]), weight[n]
                out[j, k] += w * a
                out[j, k + 1] += w * b
                out[j, k + 2] += w * c
                out[j, k + 3] += w * d
            k += 4
        while k < quantity.shape[1]:
            a = quantity[i, k]
            for n in range(start[row], start[row + 1]):
                out[np.uint64(cell[n]), k] += weight[n] * a
            k += 1


@njit(fastmath=FAST)
def _gather(start, cell, weight, order, field, out):
    ordered = len(order) > 0
    for row in range(len(start) - 1):
        i, k = order[row] if ordered else row, 0
        while k + 3 < field.shape[1]:
            a = b = c = d = 0.0
            for n in range(start[row], start[row + 1]):
                j, w = np.uint64(cell[n]), weight[n]
                a += w * field[j, k]
                b += w * field[j, k + 1]
                c += w * field[j, k + 2]
                d += w * field[j, k + 3]
            out[i, k], out[i, k + 1], out[i, k + 2], out[i, k + 3] = a, b, c, d
            k += 4
        while k + 1 < field.shape[1]:
            a = b = 0.0
            for n in range(start[row], start[row + 1]):
                j, w = np.uint64(cell[n]), weight[n]
                a += w * field[j, k]
                b += w * field[j, k + 1]
            out[i, k], out[i, k + 1] = a, b
            k += 2
        if k < field.shape[1]:
            a = 0.0
            for n in range(start[row], start[row + 1]):
                a += weight[n] * field[np.uint64(cell[n]), k]
            out[i, k] = a


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
