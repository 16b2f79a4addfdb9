"""Scalars carried by the flow: temperature, species."""
import time

import numpy as np
from dolfinx import fem

from fe_el.checks import require_positive
from fe_el.fluid import kernels
from fe_el.fluid.linear_solver import ElementMatrix, LinearSolver


class Scalar:
    """d(rho phi c)/dt + div(rho phi u c) = div(rho phi D grad c) + S, carried by the mass flux of a fluid.

    The flux is that of the fluid's step, whose divergence is the change of the void fraction: so a constant stays constant, and
    the integral of rho phi c changes by sources and open boundaries only, both to the solver's tolerance. Time is of second
    order where the fluid's is. With :class:`Upwind` in the fluid it never leaves the range of its start and boundaries.

    Args:
        fluid (VolumeAveragedNavierStokes): advance it first, then the scalar by the same step.
        diffusivity (float): D [m^2/s].
        initial: value at the start: a number, or a function of node positions (nodes, 3).
        name (str): of the Function.
        tolerance (float): relative residual of the solver.

    Attributes:
        value: P1 Function.
        source: S per volume and time: a number, (cells,), or a function (time, cell centres); ``None``: none. What particles
            give off is such an array: their rates mapped to cell densities.

    Raises:
        ValueError: for a diffusivity that is not positive.

    Note:
        Collective.
    """

    def __init__(self, fluid, diffusivity, initial=0.0, name="scalar", tolerance=1e-10):
        require_positive("diffusivity", diffusivity)
        self.fluid, self.diffusivity, self.tolerance = fluid, float(diffusivity), tolerance
        self.value = fem.Function(fluid.space, name=name)
        self.value.x.array[:] = initial(fluid.node_position) if callable(initial) else initial
        self.source, self.fixed, self.seconds = None, [], {name: 0.0}
        self.matrix = ElementMatrix(fluid.space, fluid.dofs)
        self.solver = LinearSolver(self.matrix.matrix, name, "bcgs", "jacobi", tolerance)
        self.name = name

    def set_value(self, group, value):
        """Fix the value on a boundary group: a number or a function of time."""
        self.fixed.append((self.fluid.boundary(group), value))

    def advance(self, dt):
        """Advance by ``dt`` [s], the step that the fluid has just made.

        Raises:
            SolverDiverged: if the solver fails.
        """
        tick = time.perf_counter()
        air, c = self.fluid, self.value.x.array
        phi0, phi1 = air.void_fractions
        flux = air.step_flux
        old, rhs, values = c[:, None].copy(), np.zeros((air.nodes, 1)), self.matrix.values
        thetas, share, middle = air.theta_of(self.diffusivity, dt), phi1, air.time
        if air.second_order:
            share, middle = 0.5 * (phi0 + phi1), air.time - 0.5 * dt
        kernels.transport_matrix(air.dofs, air.gradient, air.volume, air.density, air.density * share * self.diffusivity, dt, phi1,
                                 air.rate, flux, air.fixed_pressure, thetas, old, values, rhs)
        if air.upwind:
            air.stabilisation(air, share, flux, old, values, rhs)
        for facets, _ in air.outlets:
            kernels.open_boundary(facets.cell, facets.local, facets.area_normal, flux, values)
        mass0, mass1 = np.zeros((air.nodes, 1)), np.zeros((air.nodes, 1))
        kernels.scatter(air.dofs, (air.density * phi0 * air.volume)[:, None], mass0)
        kernels.scatter(air.dofs, (air.density * phi1 * air.volume)[:, None], mass1)
        if self.source is not None:
            kernels.scatter(air.dofs, (air.at_cells(self.source, (air.num_cells,), middle) * air.volume)[:, None], rhs)
        air.complete(mass0, mass1, rhs)
        rhs += mass0 * old / dt
        self._solve(dt, rhs, mass1, old)
        self.seconds[self.name] += time.perf_counter() - tick

    def _solve(self, dt, rhs, mass, old):
        air, own, values = self.fluid, self.fluid.owned_nodes, self.matrix.values
        mark, boundary = np.zeros(air.nodes, bool), np.zeros((air.nodes, 1))
        for facets, value in self.fixed:
            mark[facets.nodes] = True
            boundary[facets.nodes] = value(air.time) if callable(value) else value
        lift = np.zeros((air.nodes, 1))
        self.matrix.fix(mark, lift, boundary)
        air.node_halo.reverse_add(lift)
        self.matrix.assemble()
        self.matrix.release()
        self.solver.new_values()
        system = (rhs + lift)[:own, 0]
        system[mark[:own]] = (self.matrix.matrix.getDiagonal().array * boundary[:own, 0])[mark[:own]]
        new = old.copy()
        new[:own, 0] = self.solver.solve(system, old[:own, 0])
        air.node_halo.forward(new)
        balance = np.zeros((air.nodes, 1))
        kernels.apply_elements(air.dofs, values, new, balance)
        air.complete(balance)
        exact = new + dt * (rhs + balance) / mass
        self.value.x.array[:] = np.where(mark[:, None], new, exact)[:, 0]

    def total(self):
        """Integral of rho phi c over the domain."""
        air = self.fluid
        means = self.value.x.array[air.dofs].mean(1)
        phi = air.void_fractions[1]
        return air.comm.allreduce(float((air.density * phi * air.volume) @ means))
