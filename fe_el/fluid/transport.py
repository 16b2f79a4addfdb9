"""The first two stages of the cell-node scheme: nodes follow their cells, and carry the velocity."""
import numpy as np

from fe_el.fluid import cell_kernels, kernels, node_kernels
from fe_el.fluid.cell_node_fluid import CellNodeFluid
from fe_el.fluid.continuity import ClosedFlux
from fe_el.fluid.records import Held, Load, Masses, Memory, NodalSystem, Step, Void
from fe_el.parallel.messages import largest


class Transport(CellNodeFluid):
    """Convection and viscosity by the nodal velocity, of a fluid of cells and nodes."""

    def numbers_of_step(self, dt: float) -> Step:
        """A step of ``dt`` [s], for the loops."""
        return Step(float(dt), float(self.density), self.viscosity / self.density, self.upwind)

    def memory(self) -> Memory:
        """What the nodes do not carry, for the loops."""
        return Memory(self.gain, self.nodal_gain, self.fades, self.theta, self.lag)

    def theta_of(self, diffusivity: float | np.ndarray, dt: float) -> np.ndarray:
        """Implicit part (cells,) of transport: 1/2, and more where diffusion is so fast that half a step of it would only
        ring."""
        if not self.second_order:
            theta = self.work.empty("implicit", self.num_cells)
            theta.fill(1.0)
            return theta
        key = (float(diffusivity), dt) if np.ndim(diffusivity) == 0 else None
        if key is None or key not in self._thetas:
            z = np.clip(0.04 * diffusivity * dt / self.h ** 2, 1e-3, 500)
            theta = np.where(z > 1e-3, 1 / -np.expm1(-z) - 1 / z, 0.5)
            if key is None:
                return theta
            self._thetas = {**self._thetas, key: theta} if len(self._thetas) < 8 else {key: theta}  # those of the last steps
        return self._thetas[key]

    def _mass_flux(self, dt, phi0, q, moves):
        """Mass flux rho phi u of the step: carried on to its middle for second order, and closed if the void fraction
        moves."""
        last, flux = self._last_flux, self.work.empty("flux", *q.shape)
        now = self.work.other("last_flux", last, *q.shape)
        part = 0.5 * dt / self.dt if self.time_order == 2 and last is not None and not self.upwind else 0.0
        kernels.mass_flux(self.dofs, self.density, phi0, q, part, now if last is None else last, now, flux)
        self._last_flux = now
        if largest(self.ranks, float(moves or (self.step == 0 and np.any(q)))):
            self._to_close = 3  # steps whose flux is made of velocities that fit another rate
        if self._to_close:
            self._to_close -= 1
            self._closed_flux = self._closed_flux or ClosedFlux(self)
            self._closed_flux(flux, self.time + 0.5 * dt)
        return flux

    def _relax(self, dt, q):
        """Stage 1: u <- u + a P(q - mean u) moves the nodes towards the least-squares fit of the cells.

        a is nearly 1 - exp(-dt k) with a rate k of convection, and of viscosity but little: a rate, not a part per step, so
        that the scheme converges with the step. With upwinding it is the plain mean of the cells, which stays in their
        range.
        """
        d, work = self.dimension, self.work
        start = work.zeros("start", self.nodes, d) if self.nodal_velocity is None else self.nodal_velocity
        sums, u = work.zeros("sums", self.nodes, 2 + 2 * d), work.empty("relaxed", self.nodes, d)
        self.mass0 = work.empty("mass0", self.nodes)
        kernels.mass_and_misfit(self.cells, self.numbers_of_step(dt), self.cell_mass0, self.damping, q, start,
                                self.memory(), self.at_wall, sums)
        self.complete(sums)
        node_kernels.relaxed(start, sums, self.upwind, self.nodal_velocity is None, self.mass0, u)
        self.impose(u)
        return u

    def _fade(self, dt, q, u):
        """What the nodes cannot represent fades at the rate of convection and viscosity; nodal sums of the momentum it
        lost."""
        kept, defect = self.work.empty("kept", *q.shape), self.work.zeros("defect", self.nodes, self.dimension)
        self.mass = self.work.zeros("mass", self.nodes)
        masses = Masses(self.cell_mass0, self.cell_mass)
        kernels.fade(self.cells, self.numbers_of_step(dt), masses, q, u, self.memory(), kept, self.mass, defect)
        self.complete(self.mass)
        return kept, defect

    def _stress(self, phi0, phi, u):
        """The cells' share of the stress, and that times the viscosity (cells,) [Pa s]."""
        share, stress = self.work.empty("share", self.num_cells), self.work.empty("stress", self.num_cells)
        cell_kernels.stress_of(phi0, phi, self.second_order, self.viscosity, self.stress_of_mixture, share, stress)
        if self.turbulence is not None:
            self.eddy_viscosity = self.turbulence(self, u)
            stress += self.density * share * self.eddy_viscosity
        return share, stress

    def _transport_step(self, dt, phi0, phi, flux, q, u):
        """Stage 2: convection and viscosity of the nodal velocity, implicit, skew-symmetric, conserving momentum.

        Returns:
            transported nodal velocity, and what cells keep beside it.
        """
        d, work, own = self.dimension, self.work, self.owned_nodes
        share, stress = self._stress(phi0, phi, u)
        self._stress_now = stress
        explicit, lift = work.zeros("explicit", self.nodes, d), work.zeros("lift", self.nodes, d)
        self.transport_matrix.values.fill(0.0)
        kernels.transport_matrix(self.cells, self.numbers_of_step(dt), self.transport_matrix.entries, Void(phi, self.rate),
                                 stress, flux, self.fixed_pressure, self.theta_of(self.viscosity / self.density, dt), u,
                                 explicit)
        if self.drag_inside.active:
            self.drag_inside.add(dt, q, u, explicit)
        if self.stabilisation is not None and not self.upwind:
            self.stabilisation(self, share, flux, u, self.transport_matrix, explicit)
        if self.wall_friction is not None:
            self.wall_friction.add(dt, stress, u, self.transport_matrix, explicit)
        for facets, _ in self.outlets:
            kernels.open_boundary(*self.transport_matrix.entries, facets.cell, facets.local, facets.area_normal, flux)
        self.transport_matrix.fix(self.fixed, lift, self.boundary_velocity)
        self.complete(explicit, lift)
        explicit += self.slip_force  # of the last step: transport does not know what keeps the flow along slip walls
        self.transport_matrix.assemble()
        self.transport_matrix.release()
        self.transport_solver.new_values()
        rhs, system, guess = work.empty("rhs", self.nodes, d), work.empty("system", d, own), work.empty("guess", d, own)
        given = work.zeros("no_force", self.nodes, d) if self.drag_inside.active else self.force
        node_kernels.transport_load(self.mass0, u, self.last_change, Load(given, explicit, lift), dt,
                                    Held(self.held, self.boundary_velocity), self.transport_matrix.diagonal(),
                                    NodalSystem(rhs, system, guess))
        new = work.empty("transported", self.nodes, d)
        for k in range(d):
            new[:own, k] = self.transport_solver.solve(system[k], guess[k])
        self.node_halo.forward(new)
        np.subtract(new, u, out=self.last_change)
        kept, defect = self.drag_inside.close(dt, q, u, new) if self.drag_inside.active else self._fade(dt, q, u)
        if self.wall_friction is not None:
            self.wall_friction.close(new)
        return self._balance(dt, new, rhs, defect), kept

    def _balance(self, dt, new, rhs, defect):
        """The transported nodal velocity, less the force that it was given beforehand; in ``rhs``.

        One evaluation of the fluxes at the solution makes the balance exact whatever the solver's tolerance.
        """
        d, work = self.dimension, self.work
        balance = work.zeros("balance", self.nodes, d)
        self.transport_matrix.subtract_product(new, balance)
        self.complete(balance, defect)
        self._correction = work.empty("correction", self.nodes, d)
        node_kernels.close_transport(self.mass, rhs, balance, defect, dt, self.held, new, self._correction)
        self.reaction = balance  # at fixed nodes: what the wall adds per time to hold the velocity
        if not self.upwind:
            node_kernels.slip(new, self.slip_nodes, self.slip_normals, self.fixed, self.mass, 1 / dt, self.slip_force)
        self.impose(new)
        self._taken = self._force_ahead(dt)
        node_kernels.take_force(new, self._taken, self.mass, dt, rhs)
        return rhs

    def _force_ahead(self, dt):
        """The last step's nodal force of drag and pressure; where walls hold the nodes, carried on to this step.

        A wall takes its share of the force on a cell. With the last step's share that would be an error of first order in
        time.
        What is added is at most the force itself: no noise grows by it.
        """
        inside = self.drag_inside.active
        self._given = self.drag_inside.given if inside else self.force
        force, last = self.drag_inside.by_pressure if inside else self.force, self.last_force
        self.last_force = force
        if last is None or not self.second_order:
            return self._given
        ratio = min((dt + self.dt) / (2 * self.dt), 1.5)
        out = self.work.empty("force_ahead", *force.shape)
        node_kernels.carry_on(force, last, ratio, self.held, self.slip_nodes, self.slip_normals, out)
        if inside:  # of drag this step's is known
            out += self._given
            out -= force
        return out
