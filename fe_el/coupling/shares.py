"""Shares kept as a list: entries start[i]:start[i+1] are the cells of particle i and its shares in them."""
import numpy as np
from numba import njit


@njit(cache=True)
def _deposit(start, cell, weight, quantity, out):
    for i in range(len(start) - 1):
        for n in range(start[i], start[i + 1]):
            for k in range(quantity.shape[1]):
                out[cell[n], k] += weight[n] * quantity[i, k]


@njit(cache=True)
def _gather(start, cell, weight, field, out):
    for i in range(len(start) - 1):
        for k in range(field.shape[1]):
            total = 0.0
            for n in range(start[i], start[i + 1]):
                total += weight[n] * field[cell[n], k]
            out[i, k] = total


class ListedShares:
    """Deposits and gathers by listed shares, in arrays that are made anew only to grow.

    Attributes:
        start: (particles + 1,) first entry of each particle.
        cell, weight: (entries,) cells and shares.
    """

    def __init__(self):
        self._start, self._cell, self._weight = np.zeros(1, np.int64), np.empty(0, np.int32), np.empty(0)

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

    def deposit(self, quantity, out):
        """out[j] += sum_i w_ij quantity_i for (particles, k) quantities."""
        _deposit(self.start, self.cell, self.weight, quantity, out)

    def gather(self, field, out):
        """out[i] = sum_j w_ij field_j for (cells, k) fields."""
        _gather(self.start, self.cell, self.weight, field, out)
