"""Balance of mass: fluxes that close it for a step, and the ledger of the fluid."""
import numpy as np
from mpi4py import MPI

from fe_el.checks import positive_number
from fe_el.compiled.for_each_dimension import D, M, by_dimension
from fe_el.fluid.cell_node_fluid import CellNodeFluid
from fe_el.fluid.pressure_equation import poisson_matrix
from fe_el.nodes.linear_solver import LinearSolver
from fe_el.nodes.nodal_matrix import NodalMatrix

FACTORED = {2: 200_000, 3: 10_000}  # nodes up to which a constant matrix is factored, by dimension: seconds, once


@by_dimension
def mass_balance(dofs, grad, volume, phi, rate, q, residual, scale):
    """Nodal residual of (phi u, grad w) = (dphi/dt, w), and the sum of what passes each node."""
    n = len(dofs)
    for c in range(n):
        for i in range(M):
            flux = 0.0
            for k in range(D):
                flux += grad[c, i, k] * q[c, k]
            residual[dofs[c, i]] += volume[c] * (phi[c] * flux - rate[c] / M)
            scale[dofs[c, i]] += volume[c] * (abs(phi[c] * flux) + abs(rate[c] / M))


@by_dimension
def take_gradient(dofs, grad, psi, flux):
    """Subtract the gradient of a nodal function from ``flux``."""
    for c in range(len(dofs)):
        for k in range(D):
            for i in range(M):
                flux[c, k] -= grad[c, i, k] * psi[dofs[c, i]]


class ClosedFlux:
    """Takes from a mass flux the gradient that closes the balance (flux, grad w) = (rho dphi/dt - sources, w) of a step.

    Only then does transport keep a uniform velocity, or a uniform scalar, while the void fraction changes. The matrix is
    constant and set up once: on one rank it is factored, which is four to ten times as fast as multigrid, while factors fit.

    Args:
        fluid (VolumeAveragedNavierStokes): with its boundary conditions.

    Note:
        Collective.
    """

    def __init__(self, fluid):
        self.fluid, self.whole = fluid, np.ones(fluid.num_cells)
        laplacian = NodalMatrix(fluid.space, fluid.dofs)
        poisson_matrix(fluid.dofs, laplacian.place, fluid.gradient, fluid.volume, laplacian.values)
        none = fluid.nodal_zeros((1,))
        laplacian.fix(fluid.fixed_pressure, none, none)
        laplacian.assemble()
        self.matrix = laplacian.matrix
        direct = fluid.outlets and fluid.comm.size == 1 and fluid.nodes <= FACTORED[fluid.dimension]
        self.solver = LinearSolver(self.matrix, "flux", "cg", "cholesky" if direct else "gamg", fluid.tolerance,
                                   not fluid.outlets)

    def __call__(self, step, time):
        """Close the mass flux of the :class:`StepState` whose middle is ``time`` [s], in place."""
        air, own, n = self.fluid, self.fluid.owned_nodes, self.fluid.num_cells
        supply, flux = air.work.empty("supply_of_flux", n), step.flux
        supply[:] = step.rate
        if air.mass_source is not None:
            supply -= air.at_cells(air.mass_source, (n,), time)
        supply *= air.density
        residual, scale = air.work.zeros("residual", air.nodes), air.work.zeros("scale", air.nodes)
        mass_balance(air.dofs, air.gradient, air.volume, self.whole, supply, flux, residual, scale)
        inflow = air.inflow_at(time)
        inflow *= air.density
        residual += inflow
        air.node_halo.reverse_add(residual)
        residual[air.pressure_equation.held] = 0.0
        psi = air.work.zeros("potential", air.nodes)
        psi[:own] = self.solver.solve(residual[:own], psi[:own])
        air.node_halo.forward(psi)
        take_gradient(air.dofs, air.gradient, psi, flux)


class Ledger(CellNodeFluid):
    """What a fluid knows of its own balances."""

    def mass_residual(self) -> float:
        """Largest nodal residual of continuity over the largest flux through a node (outlets left out).

        Raises:
            RuntimeError: before the first step.
        """
        d, step = self.dimension, self.last_step
        if step is None:
            raise RuntimeError("The residual of mass is not known before a step; call advance first.")
        residual, scale = self.nodal_zeros(()), self.nodal_zeros(())
        q = self.velocity.x.array.reshape(-1, d)[:self.num_cells]
        if step.answer is not None:
            q = q + step.answered / step.after[:, None]
        mass_balance(self.dofs, self.gradient, self.volume, step.after, step.acting.supply, q, residual, scale)
        residual += step.inflow
        self.complete(residual, scale)
        residual[self.fixed_pressure] = 0.0
        largest = self.comm.allreduce(np.abs(residual).max(initial=0.0), op=MPI.MAX)
        return largest / max(self.comm.allreduce(scale.max(initial=0.0), op=MPI.MAX), 1e-300)

    def momentum(self) -> np.ndarray:
        """Total fluid momentum (d,) [kg m/s]."""
        phi = np.ones(self.num_cells) if self.void_fraction is None else self.void_fraction
        q = self.velocity.x.array.reshape(-1, self.dimension)[:self.num_cells]
        return self.comm.allreduce((self.density * phi * self.volume) @ q)

    def courant(self, dt: float) -> float:
        """Largest Courant number |u| dt / h."""
        dt, q = positive_number("time step", dt), self.velocity.x.array.reshape(-1, self.dimension)[:self.num_cells]
        return self.comm.allreduce(dt * (np.linalg.norm(q, axis=1) / self.h).max(initial=0.0), op=MPI.MAX)
