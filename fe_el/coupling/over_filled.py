"""Over-filled cells hand their excess to neighbours by a linear map that is its own record, so its transpose exists."""
import numpy as np
from numba import njit


@njit(cache=True)
def _spill(neighbour, volume, content, room_for, owned, source, target, fraction):
    """One sweep: where each over-filled owned cell sends which fraction of its content; returns the number of moves."""
    moves = 0
    for c in range(owned):
        if content[c] <= room_for * volume[c] * (1 + 1e-12):
            continue
        excess, room = content[c] - room_for * volume[c], 0.0
        for n in neighbour[c]:
            if n >= 0:
                room += max(room_for * volume[n] - content[n], 0.0)
        for n in neighbour[c]:
            if n < 0 or moves >= len(source):
                continue
            free = max(room_for * volume[n] - content[n], 0.0)
            part = free / room if room > excess else volume[n]
            if room <= excess:  # no room next door: spread by volume, later sweeps carry it on
                total = 0.0
                for o in neighbour[c]:
                    total += volume[o] if o >= 0 else 0.0
                part /= total
            if part > 0:
                source[moves], target[moves], fraction[moves] = c, n, part * excess / content[c]
                moves += 1
    return moves


@njit(cache=True)
def _apply(source, target, fraction, field, out):
    """out += moves of field, content leaving at the same time from all sources."""
    for m in range(len(source)):
        for k in range(field.shape[1]):
            q = fraction[m] * field[source[m], k]
            out[source[m], k] -= q
            out[target[m], k] += q


@njit(cache=True)
def _apply_transpose(source, target, fraction, field, out):
    """Transpose of :func:`_apply`."""
    for m in range(len(source)):
        for k in range(field.shape[1]):
            out[source[m], k] += fraction[m] * (field[target[m], k] - field[source[m], k])


class Spill:
    """The map that takes cell contents to contents that fit.

    Args:
        cells, halo: the cells and the exchange of cell values.
        content: (cells,) solid volume of every cell, halo included [m^3].
        largest (float): solid fraction a cell may hold.

    Attributes:
        over_filled (int): number of over-filled owned cells before.
    """

    def __init__(self, cells, halo, content, largest, sweeps=200):
        self.halo, self.moves, owned = halo, [], cells.owned
        self.over_filled = int((content[:owned] > largest * cells.volume[:owned] * (1 + 1e-12)).sum())
        content = content[:, None].copy()
        for _ in range(sweeps):
            full = int((content[:owned, 0] > largest * cells.volume[:owned] * (1 + 1e-12)).sum())
            if not halo.comm.allreduce(full):
                break
            source, target = np.empty(4 * full, np.int64), np.empty(4 * full, np.int64)
            fraction = np.empty(4 * full)
            m = _spill(cells.neighbour, cells.volume, content[:, 0], largest, owned, source, target, fraction)
            self.moves.append((source[:m].copy(), target[:m].copy(), fraction[:m].copy()))
            content = self._step(content, *self.moves[-1])

    def _step(self, field, source, target, fraction):
        change = np.zeros_like(field)
        _apply(source, target, fraction, field, change)
        self.halo.reverse_add(change)
        return self.halo.forward(field + change)

    def __call__(self, content):
        """Contents (cells, k) after the moves; halo values complete before and after."""
        for move in self.moves:
            content = self._step(content, *move)
        return content

    def transpose(self, field):
        """Transpose of the map, for what cells give back to particles; halo values complete before and after."""
        for source, target, fraction in reversed(self.moves):
            change = np.zeros_like(field)
            _apply_transpose(source, target, fraction, field, change)
            field = self.halo.forward(field + change)
        return field
