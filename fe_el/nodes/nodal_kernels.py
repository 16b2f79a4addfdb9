"""Numba loops over nodes, and from cells to their nodes, whatever is solved there."""
import numpy as np

from fe_el.compiled.cache import njit
from fe_el.compiled.for_each_dimension import FAST, M, by_dimension


@by_dimension
def scatter(dofs, total, out):
    """Add cell totals in equal shares to the nodes."""
    share = 1.0 / M
    for c in range(len(dofs)):
        for i in range(M):
            for k in range(total.shape[1]):
                out[dofs[c, i], k] += share * total[c, k]


@by_dimension
def add_integrals(dofs, volume, field, out):
    """Add the integrals of a cell field (cells, k) in equal shares to the nodes."""
    share = 1.0 / M
    for c in range(len(dofs)):
        for k in range(field.shape[1]):
            part = share * volume[c] * field[c, k]
            for i in range(M):
                out[dofs[c, i], k] += part


@by_dimension
def add_elements(dofs, place, elements, values):
    """Add element matrices to ``values``."""
    for c in range(len(dofs)):
        for i in range(M):
            for j in range(M):
                values[place[c, i, j]] += elements[c, i, j]


@njit(fastmath=FAST)
def fix_entries(held, diagonal, values, rhs):
    """Right-hand side of the held entries that this rank owns."""
    for i in held:
        if i < len(diagonal):
            rhs[i] = diagonal[i] * values[i]


@njit
def fix_rows(at, row, column, fixed, values, kept, lift, boundary):
    """Replace rows and columns of fixed nodes by a diagonal in the entries ``at``, which go to ``kept`` as they were; what
    columns carried goes to ``lift``."""
    for n in range(len(at)):
        i, j, value = row[n], column[n], values[at[n]]
        kept[n] = value
        if not fixed[i]:
            for k in range(boundary.shape[1]):
                lift[i, k] -= value * boundary[j, k]
        values[at[n]] = abs(value) + 1e-300 if i == j else 0.0


@njit(fastmath=FAST)
def subtract_product(starts, columns, values, u, out):
    """Subtract a matrix, given by rows, times u (nodes, parts) from ``out``."""
    if u.shape[1] == 3:
        for i in range(len(out)):
            a, b, c = 0.0, 0.0, 0.0
            for n in range(starts[i], starts[i + 1]):
                j, value = columns[n], values[n]
                a += value * u[j, 0]
                b += value * u[j, 1]
                c += value * u[j, 2]
            out[i, 0] -= a
            out[i, 1] -= b
            out[i, 2] -= c
        return
    for i in range(len(out)):
        for k in range(u.shape[1]):
            total = 0.0
            for n in range(starts[i], starts[i + 1]):
                total += values[n] * u[columns[n], k]
            out[i, k] -= total


@njit
def add_to_nodes(facet_nodes, values, total):
    """Add the value of each facet to all of its nodes."""
    for f in range(len(facet_nodes)):
        for k in range(facet_nodes.shape[1]):
            total[facet_nodes[f, k]] += values[f]


@njit
def same(a, b):
    """Whether two vectors are equal, entry by entry."""
    for i in range(len(a)):
        if a[i] != b[i]:
            return False
    return True


@njit
def finite(a):
    """Whether all entries of a vector are finite."""
    for value in a:
        if not np.isfinite(value):
            return False
    return True
