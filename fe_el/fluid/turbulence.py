"""Eddy viscosities of large-eddy simulation, from the cell-wise gradient of the nodal velocity."""
import numpy as np

from fe_el.checks import require_positive


def velocity_gradient(fluid, u):
    """Cell-wise gradient g[c, i, j] = d u_j / d x_i of a nodal velocity [1/s]."""
    return np.einsum("cvi,cvj->cij", fluid.gradient, u[fluid.dofs])


def filter_width(fluid):
    """Cube root of the cell volume (square root of the area in two dimensions) [m]."""
    return fluid.volume ** (1 / fluid.dimension)


def _strain(g):
    s = 0.5 * (g + np.transpose(g, (0, 2, 1)))
    return s, (s * s).sum((1, 2))


class Smagorinsky:
    """nu_t = (C D)^2 sqrt(2 S:S) (Smagorinsky 1963); not zero in laminar shear or at walls.

    Args:
        constant (float): C.

    Raises:
        ValueError: for a constant that is not positive.
    """

    def __init__(self, constant=0.17):
        require_positive("Smagorinsky constant", constant)
        self.constant = float(constant)

    def __call__(self, fluid, u):
        """(cells,) eddy viscosity [m^2/s]."""
        _, square = _strain(velocity_gradient(fluid, u))
        return (self.constant * filter_width(fluid)) ** 2 * np.sqrt(2 * square)


class Vreman:
    """nu_t = c sqrt(B / g:g) with B the second invariant of D^2 g^T g (Vreman 2004); zero in plane shear.

    Args:
        constant (float): c, about 2.5 times the square of Smagorinsky's constant.

    Raises:
        ValueError: for a constant that is not positive.
    """

    def __init__(self, constant=0.07):
        require_positive("Vreman constant", constant)
        self.constant = float(constant)

    def __call__(self, fluid, u):
        """(cells,) eddy viscosity [m^2/s]."""
        g = velocity_gradient(fluid, u)
        beta = filter_width(fluid)[:, None, None] ** 2 * np.einsum("cmi,cmj->cij", g, g)
        trace = np.einsum("cii->c", beta)
        invariant = 0.5 * (trace ** 2 - (beta * beta).sum((1, 2)))
        square = (g * g).sum((1, 2))
        return self.constant * np.sqrt(np.maximum(invariant, 0.0) / np.maximum(square, 1e-300))


class Wale:
    """Wall-adapting local eddy viscosity (Nicoud & Ducros 1999): grows with the cube of the distance from a wall.

    Args:
        constant (float): C_w.

    Raises:
        ValueError: for a constant that is not positive.
    """

    def __init__(self, constant=0.325):
        require_positive("WALE constant", constant)
        self.constant = float(constant)

    def __call__(self, fluid, u):
        """(cells,) eddy viscosity [m^2/s]."""
        g = velocity_gradient(fluid, u)
        _, strain = _strain(g)
        square = np.einsum("cik,ckj->cij", g, g)
        deviator = 0.5 * (square + np.transpose(square, (0, 2, 1)))
        deviator -= np.einsum("cii->c", square)[:, None, None] / 3 * np.eye(g.shape[1])
        size = (deviator * deviator).sum((1, 2))
        return (self.constant * filter_width(fluid)) ** 2 * size ** 1.5 / np.maximum(strain ** 2.5 + size ** 1.25, 1e-300)
