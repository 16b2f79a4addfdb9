"""Eddy viscosities of large-eddy simulation, from the cell-wise gradient of the nodal velocity.

A closure is any callable ``closure(fluid, u)`` that gives the (cells,) eddy viscosity [m^2/s] of the nodal velocity u
(nodes, d). The filter width D is the cube root of the cell's volume, in two dimensions the square root of its area.
"""
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from fe_el.checks import positive_number
from fe_el.compiled.cache import njit
from fe_el.compiled.for_each_dimension import FAST, D, by_dimension

if TYPE_CHECKING:
    from fe_el.fluid.volume_averaged_navier_stokes import VolumeAveragedNavierStokes


@njit(fastmath=FAST)
def _velocity_gradient(gradient, u, nodes, d, g):
    """Fill g[i, j] = d u_j / d x_i [1/s] of one cell."""
    for i in range(d):
        for j in range(d):
            total = 0.0
            for v in range(d + 1):
                total += gradient[v, i] * u[nodes[v], j]
            g[i, j] = total


@by_dimension
def _smagorinsky(dofs, gradient, u, width, constant, out):
    """(C D)^2 sqrt(2 S:S)."""
    g = np.empty((D, D))
    for c in range(len(dofs)):
        _velocity_gradient(gradient[c], u, dofs[c], D, g)
        strain = 0.0
        for i in range(D):
            for j in range(D):
                s = 0.5 * (g[i, j] + g[j, i])
                strain += s * s
        out[c] = (constant * width[c]) ** 2 * np.sqrt(2 * strain)


@by_dimension
def _vreman(dofs, gradient, u, width, constant, out):
    """c sqrt(B / g:g), B the sum of the principal minors of b = D^2 g^T g."""
    g, b = np.empty((D, D)), np.empty((D, D))
    for c in range(len(dofs)):
        _velocity_gradient(gradient[c], u, dofs[c], D, g)
        square, trace, norm = 0.0, 0.0, 0.0
        for i in range(D):
            for j in range(D):
                total = 0.0
                for m in range(D):
                    total += g[m, i] * g[m, j]
                b[i, j] = width[c] * width[c] * total
                square += g[i, j] * g[i, j]
                norm += b[i, j] * b[i, j]
            trace += b[i, i]
        out[c] = constant * np.sqrt(max(0.5 * (trace * trace - norm), 0.0) / max(square, 1e-300))


@by_dimension
def _wale(dofs, gradient, u, width, constant, out):
    """(C D)^2 (s:s)^(3/2) / ((S:S)^(5/2) + (s:s)^(5/4)), s the deviator of the symmetric part of g^2."""
    g, q = np.empty((D, D)), np.empty((D, D))
    for c in range(len(dofs)):
        _velocity_gradient(gradient[c], u, dofs[c], D, g)
        strain, size, trace = 0.0, 0.0, 0.0
        for i in range(D):
            for j in range(D):
                s = 0.5 * (g[i, j] + g[j, i])
                strain += s * s
                total = 0.0
                for k in range(D):
                    total += g[i, k] * g[k, j]
                q[i, j] = total
            trace += q[i, i]
        for i in range(D):
            for j in range(D):
                s = 0.5 * (q[i, j] + q[j, i]) - (trace / 3 if i == j else 0.0)
                size += s * s
        root = np.sqrt(size)
        below = strain * strain * np.sqrt(strain) + size * np.sqrt(root)
        out[c] = (constant * width[c]) ** 2 * size * root / max(below, 1e-300)


class _Closure:
    """An eddy viscosity with one constant and a loop over cells."""

    name: str
    loop: Callable[..., None]

    def __init__(self, constant):
        self.constant = positive_number(f"{self.name} constant", constant)

    def __call__(self, fluid: "VolumeAveragedNavierStokes", u: np.ndarray) -> np.ndarray:
        """(cells,) eddy viscosity [m^2/s]."""
        out, width = np.empty(fluid.num_cells), fluid.h / (2 ** 0.5 if fluid.dimension == 2 else 6 ** (1 / 3))
        self.loop(fluid.dofs, fluid.gradient, u, width, self.constant, out)
        return out


class Smagorinsky(_Closure):
    """nu_t = (C D)^2 sqrt(2 S:S) (Smagorinsky 1963); not zero in laminar shear or at walls.

    Args:
        constant (float): C.

    Raises:
        ValueError: for a constant that is not positive.
    """

    name, loop = "Smagorinsky", staticmethod(_smagorinsky)

    def __init__(self, constant: float = 0.17) -> None:
        super().__init__(constant)


class Vreman(_Closure):
    """nu_t = c sqrt(B / g:g) with B the second invariant of D^2 g^T g (Vreman 2004); zero in plane shear.

    Args:
        constant (float): c, about 2.5 times the square of Smagorinsky's constant.

    Raises:
        ValueError: for a constant that is not positive.
    """

    name, loop = "Vreman", staticmethod(_vreman)

    def __init__(self, constant: float = 0.07) -> None:
        super().__init__(constant)


class Wale(_Closure):
    """Wall-adapting local eddy viscosity (Nicoud & Ducros 1999): grows with the cube of the distance from a wall.

    Args:
        constant (float): C_w.

    Raises:
        ValueError: for a constant that is not positive.
    """

    name, loop = "WALE", staticmethod(_wale)

    def __init__(self, constant: float = 0.325) -> None:
        super().__init__(constant)
