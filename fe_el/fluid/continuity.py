"""Balance of mass: fluxes that close it for a step, and the ledger of the fluid."""
import numpy as np
from mpi4py import MPI

from fe_el.checks import positive_number
from fe_el.fluid import kernels
from fe_el.fluid.cell_node_fluid import CellNodeFluid
from fe_el.nodes.linear_solver import LinearSolver
from fe_el.nodes.nodal_matrix import NodalMatrix


class ClosedFlux:
    """Takes from a mass flux the gradient that closes the balance (flux, grad w) = (rho dphi/dt - sources, w) of a step.

    Only then does transport keep a uniform velocity, or a uniform scalar, while the void fraction changes. The matrix is
    constant and set up once.

    Args:
        fluid (VolumeAveragedNavierStokes): with its boundary conditions.

    Note:
        Collective.
    """

    def __init__(self, fluid):
        self.fluid, self.whole = fluid, np.ones(fluid.num_cells)
        laplacian = NodalMatrix(fluid.space, fluid.dofs)
        kernels.poisson_matrix(fluid.dofs, laplacian.place, fluid.gradient, fluid.volume, laplacian.values)
        none = fluid.nodal_zeros((1,))
        laplacian.fix(fluid.fixed_pressure, none, none)
        laplacian.assemble()
        self.matrix = laplacian.matrix
        self.solver = LinearSolver(self.matrix, "flux", "cg", "gamg", fluid.tolerance, not fluid.outlets)

    def __call__(self, flux, time):
        """Close the flux (cells, d) [kg/(m^2 s)] of the step whose middle is ``time`` [s], in place."""
        air, own, n = self.fluid, self.fluid.owned_nodes, self.fluid.num_cells
        supply = air.work.empty("supply", n)
        supply[:] = air.rate
        if air.mass_source is not None:
            supply -= air.at_cells(air.mass_source, (n,), time)
        supply *= air.density
        residual, scale = air.work.zeros("residual", air.nodes), air.work.zeros("scale", air.nodes)
        kernels.mass_balance(air.dofs, air.gradient, air.volume, self.whole, supply, flux, residual, scale)
        inflow = air.inflow_at(time)
        inflow *= air.density
        residual += inflow
        air.node_halo.reverse_add(residual)
        residual[air.pressure_equation.held] = 0.0
        psi = air.work.zeros("potential", air.nodes)
        psi[:own] = self.solver.solve(residual[:own], psi[:own])
        air.node_halo.forward(psi)
        kernels.take_gradient(air.dofs, air.gradient, psi, flux)


class Ledger(CellNodeFluid):
    """What a fluid knows of its own balances."""

    def mass_residual(self) -> float:
        """Largest nodal residual of continuity over the largest flux through a node (outlets left out)."""
        d = self.dimension
        residual, scale = self.nodal_zeros(()), self.nodal_zeros(())
        q = self.velocity.x.array.reshape(-1, d)[:self.num_cells]
        kernels.mass_balance(self.dofs, self.gradient, self.volume, self.void_fraction, self.supply, q, residual, scale)
        residual += self.inflow
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
