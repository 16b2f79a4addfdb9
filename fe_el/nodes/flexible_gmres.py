"""Generalised minimal residuals for an operator that is applied by solving something, with any preconditioner."""
import numpy as np


def flexible_gmres(apply, precondition, residual, dot, most, enough):
    """Steps that take a residual r off: r - sum_j y_j A z_j has the least norm of all sums of the z_j (Saad, SIAM J. Sci.
    Comput. 14, 1993, 461).

    Args:
        apply: function of a vector z that gives A z.
        precondition: function of a vector r that gives about A^-1 r, another one each time if it likes.
        residual: (n,) r of this rank.
        dot: function of two vectors that gives their product over all ranks.
        most (int): iterations.
        enough (float): part of the norm of r that may be left.

    Returns:
        (weights y, directions z): two lists; empty ones for a residual of zero, or if the first product is not finite.

    Note:
        Collective.
    """
    size = np.sqrt(dot(residual, residual))
    basis, directions, weights = [residual / size] if size > 0.0 else [], [], np.zeros(0)
    columns = np.zeros((most + 1, most))
    while len(directions) < most and len(basis) > len(directions):
        j = len(directions)
        z = precondition(basis[j])
        product = apply(z)
        for i in range(j + 1):
            columns[i, j] = dot(product, basis[i])
            product = product - columns[i, j] * basis[i]
        columns[j + 1, j] = norm = np.sqrt(dot(product, product))
        if not np.isfinite(norm):
            break
        directions.append(z)
        target = np.zeros(j + 2)
        target[0] = size
        weights = np.linalg.lstsq(columns[:j + 2, :j + 1], target, rcond=None)[0]
        left = np.linalg.norm(target - columns[:j + 2, :j + 1] @ weights)
        if left > enough * size and norm > 0.0:
            basis.append(product / norm)
    return weights, directions
