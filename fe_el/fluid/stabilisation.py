"""Stabilisation of convection, for flows that the mesh does not resolve; absent by default, as the scheme needs none to be
stable."""
from typing import TYPE_CHECKING

import numpy as np

from fe_el.checks import positive_number
from fe_el.compiled.cache import njit
from fe_el.compiled.for_each_dimension import D, M, by_dimension
from fe_el.fluid.relaxation import fading_rate

if TYPE_CHECKING:
    from fe_el.fluid.volume_averaged_navier_stokes import VolumeAveragedNavierStokes
    from fe_el.nodes.nodal_matrix import NodalMatrix


@by_dimension
def _convection(dofs, grad, volume, flux, u, share_out):
    """The integral of the convection M . grad u of each cell, shared out to the nodes."""
    for c in range(len(dofs)):
        for k in range(D):
            along = 0.0
            for i in range(M):
                slope = 0.0
                for j in range(D):
                    slope += grad[c, i, j] * flux[c, j]
                along += slope * u[dofs[c, i], k]
            for i in range(M):
                share_out[dofs[c, i], k] += volume[c] / M * along


@njit
def _weights(flux, density, share, h, viscosity, factor, weight):
    """factor / (2 |u| / h + 4 nu / h^2) / (rho phi)."""
    for c in range(len(flux)):
        square = 0.0
        for k in range(flux.shape[1]):
            square += flux[c, k] ** 2
        mass = density * share[c]
        rate = fading_rate(square / mass ** 2, h[c], viscosity / density, 4.0)
        weight[c] = factor / max(rate, 1e-300) / mass


@by_dimension
def _streamline(dofs, place, grad, volume, flux, weight, mean, node_volume, values, rhs):
    """Add weight (M . grad u - mean / node volume, M . grad w); the nodal mean of the last step goes to ``rhs``."""
    slope = np.empty(M)
    for c in range(len(dofs)):
        for i in range(M):
            slope[i] = 0.0
            for j in range(D):
                slope[i] += grad[c, i, j] * flux[c, j]
        for i in range(M):
            for j in range(M):
                values[place[c, i, j]] += weight[c] * volume[c] * slope[i] * slope[j]
        for k in range(D):
            average = 0.0
            for j in range(M):
                average += mean[dofs[c, j], k] / node_volume[dofs[c, j], 0]
            for i in range(M):
                rhs[dofs[c, i], k] += weight[c] * volume[c] * slope[i] * average / M


class Streamline:
    """Diffusion along the stream of what the nodes' mean of the convection does not explain (orthogonal subscales).

    tau (M . grad u - P(M . grad u), M . grad w) / (rho phi), tau = factor / (2 |u| / h + 4 nu / h^2): it vanishes with the
    mesh faster than the error of the scheme, so the order stays two; momentum is kept. Codina (2002).

    Args:
        factor (float): strength.

    Raises:
        ValueError: for a factor that is not positive.
    """

    upwind = False

    def __init__(self, factor: float = 1.0) -> None:
        self.factor = positive_number("factor of Streamline", factor)

    def __call__(self, air: "VolumeAveragedNavierStokes", share: np.ndarray, flux: np.ndarray, u: np.ndarray,
                 matrix: "NodalMatrix", rhs: np.ndarray) -> None:
        """Add the terms to the entries of a NodalMatrix and to the nodal right-hand side; collective."""
        mean = air.work.zeros("mean_convection", air.nodes, air.dimension)
        _convection(air.dofs, air.gradient, air.volume, flux, u, mean)
        air.complete(mean)
        weight = air.work.empty("streamline", air.num_cells)
        _weights(flux, air.density, share, air.h, air.viscosity, self.factor, weight)
        _streamline(air.dofs, matrix.place, air.gradient, air.volume, flux, weight, mean, air.node_volume, matrix.values,
                    rhs)


class Upwind:
    """Upwinding, for jets and fronts that the mesh does not resolve: the matrix of transport becomes an M-matrix.

    First order in space and time, and the nodes follow the plain mean of the cells. A step in a fluid without viscosity
    overshoots by 2 % (47 % without it); what remains comes from the cells' own part of the velocity. A :class:`Scalar` of
    such a fluid does not overshoot. Momentum is kept; energy is lost.
    """

    upwind = True
