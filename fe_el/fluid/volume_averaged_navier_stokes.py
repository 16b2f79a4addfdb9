"""The volume-averaged Navier-Stokes equations, model A, by a cell-node scheme on simplices."""
import time

import numpy as np
from dolfinx import fem

from fe_el.exchange import Halo
from fe_el.fluid import kernels, node_kernels
from fe_el.fluid.boundary_conditions import Boundaries, velocity_at
from fe_el.fluid.cells_and_nodes import CellsAndNodes
from fe_el.fluid.continuity import ClosedFlux, Ledger
from fe_el.fluid.linear_solver import ElementMatrix, LinearSolver
from fe_el.fluid.pressure_equation import PressureEquation
from fe_el.messages import largest

START_STEPS = 2  # implicit Euler steps that damp a start which does not fit its boundary conditions


class VolumeAveragedNavierStokes(CellsAndNodes, Boundaries, Ledger):
    """Flow of a fluid through the void fraction phi left by particles (model A).

        d(rho phi)/dt + div(rho phi u) = 0
        d(rho phi u)/dt + div(rho phi u u) = -phi grad p + phi div tau - A u + B + rho phi g

    One velocity vector per cell carries the momentum; a nodal P1 velocity transports it; the pressure is P1. Drag A and
    pressure are solved together, so any drag, and any jump of it between cells, is stable.

    Args:
        mesh: dolfinx mesh of triangles or tetrahedra.
        facet_tags: boundary groups (dolfinx MeshTags of facets); absent: every boundary is a slip wall.
        density (float): rho [kg/m^3].
        viscosity (float): dynamic viscosity mu [Pa s].
        gravity: acceleration [m/s^2]; absent: none.
        tolerance (float): relative residual of the linear solvers.
        mean_pressure_gradient: constant part of -grad p beside the solved pressure [Pa/m], on the fluid's share phi of the
            volume: what carries the weight in a periodic box (give particles the same by ``PressureGradient(mean=...)``).
        turbulence: eddy viscosity, for instance :class:`Smagorinsky` (see :mod:`fe_el.fluid.turbulence`); absent: laminar.
        stabilisation: :class:`Streamline` or :class:`Upwind` (see :mod:`fe_el.fluid.stabilisation`); absent: none.
        time_order (int): 2, or 1: implicit Euler, which damps what the step does not resolve.
        stress_of_mixture (bool): the fluid carries div tau, not phi div tau; for particles with ``ViscousStress``.

    Attributes:
        velocity: DG0 vector Function, interstitial velocity u [m/s].
        pressure: P1 Function, of the middle of the step [Pa].
        body_force: force per fluid volume [N/m^3]: d numbers, (cells, d), or a function (time, points (cells, 3)) of which the
            cell means are taken in the middle of the step; ``None``: none.
        mass_source: volume of fluid per volume and time [1/s], that comes in with the local velocity only if ``body_force``
            says so; a number, (cells,), or a function; ``None``: none.

    Raises:
        ValueError: for cells that are not simplices, a density or viscosity out of range, or an unknown boundary group.

    Note:
        Collective.
    """

    def __init__(self, mesh, facet_tags=None, density=1.2, viscosity=1.8e-5, gravity=None, tolerance=1e-8,
                 mean_pressure_gradient=None, stress_of_mixture=False, turbulence=None, time_order=2,
                 stabilisation=None):
        CellsAndNodes.__init__(self, mesh)
        if not (density > 0 and np.isfinite(density)):
            raise ValueError(f"The fluid density is {density}; it must be finite and greater than zero [kg/m^3].")
        if not (viscosity >= 0 and np.isfinite(viscosity)):
            raise ValueError(f"The fluid viscosity is {viscosity}; it must be finite and not negative [Pa s].")
        self.facet_tags, self.density, self.viscosity, self.tolerance = facet_tags, density, viscosity, tolerance
        n, d = self.num_cells, self.dimension
        self.gravity = np.zeros(d) if gravity is None else np.asarray(gravity, float)[:d].copy()
        self.velocity = fem.Function(fem.VectorFunctionSpace(mesh, ("DG", 0)), name="velocity")
        self.pressure = fem.Function(self.space, name="pressure")
        self.cell_halo = Halo.of_index_map(mesh.comm, self.velocity.function_space.dofmap.index_map)
        self.nodal_velocity, self.force, self.gain = None, np.zeros((self.nodes, d)), np.zeros((n, d))
        self.nodal_gain, self.theta = np.zeros((self.nodes, d)), np.empty(n)
        self.void_fraction, self.rate = None, np.zeros(n)
        self.time, self.step, self.seconds = 0.0, 0, {"fluid": 0.0}
        self.inlets, self.outlets, self.no_slip, self.slip, self._facets = [], [], [], [], {}
        mean = np.zeros(d) if mean_pressure_gradient is None else np.asarray(mean_pressure_gradient, float)[:d]
        if time_order not in (1, 2):
            raise ValueError(f"time_order is {time_order}; it must be 1 or 2.")
        self.turbulence, self.time_order, self.stabilisation = turbulence, time_order, stabilisation
        self.upwind = stabilisation is not None and stabilisation.upwind
        self.mean_pressure_gradient, self.stress_of_mixture = mean.copy(), bool(stress_of_mixture)
        self.ready, self._last_flux, self.step_flux, self._closed_flux, self._to_close = False, None, None, None, 0
        self.body_force = self.mass_source = self.last_pressure = self.last_force = self.last_change = None

    def set_initial_velocity(self, value):
        """Interstitial velocity at the start: d numbers, or a function (time, position) as for inlets."""
        v = velocity_at(value, self.time, self.corner.mean(1), self.dimension)
        self.velocity.x.array.reshape(-1, self.dimension)[:self.num_cells] = v
        self.velocity.x.scatter_forward()
        self.nodal_velocity = None

    def _setup(self):
        """Matrices, solvers and fixed nodes, once the boundary conditions are known."""
        self.ready = True
        self._transport = ElementMatrix(self.space, self.dofs)
        closed = not self.outlets
        self.transport_solver = LinearSolver(self._transport.matrix, "transport", "bcgs", "jacobi", self.tolerance)
        self.fixed, self.fixed_pressure = np.zeros(self.nodes, bool), np.zeros(self.nodes, bool)
        for facets in [f for f, _ in self.inlets] + self.no_slip:
            self.fixed[facets.nodes] = True
        for facets, _ in self.outlets:
            self.fixed_pressure[facets.nodes] = True
        slip = [(np.zeros(0, np.int64), np.zeros((0, self.dimension))), *self.slip]
        self.slip_nodes, self.slip_normals = (np.concatenate(a) for a in zip(*slip))
        self.held, self._thetas, self._steady_inflow = np.flatnonzero(self.fixed), {}, None
        self.pressure_equation = PressureEquation(self)
        self.boundary_velocity, self._values_set = np.zeros((self.nodes, self.dimension)), False
        if closed:
            self.check_inflow()

    def theta_of(self, diffusivity, dt):
        """Implicit part (cells,) of transport: 1/2, and more where diffusion is so fast that half a step of it would only ring."""
        if not self.second_order:
            return np.ones(self.num_cells)
        key = (float(diffusivity), dt) if np.ndim(diffusivity) == 0 else None
        if key is None or key not in self._thetas:
            z = np.clip(0.04 * diffusivity * dt / self.h ** 2, 1e-3, 500)
            theta = np.where(z > 1e-3, 1 / -np.expm1(-z) - 1 / z, 0.5)
            if key is None:
                return theta
            self._thetas = {**self._thetas, key: theta} if len(self._thetas) < 8 else {key: theta}  # those of the last steps
        return self._thetas[key]

    # -- one step ------------------------------------------------------------------------------------------------------

    def advance(self, dt, fields=None, pressure_share=None):
        """Advance by ``dt`` [s].

        Args:
            fields: (void fraction, drag coefficient A, momentum source B): two DG0 Functions and a DG0 vector Function,
                for instance ``Coupling.fields``; absent: single-phase flow.
            pressure_share: part (cells,) of pressure gradient and body force that the fluid takes; absent: the void fraction.

        Raises:
            SolverDiverged: if a linear solver fails.
            ValueError: for a void fraction that is not positive.

        Note:
            Collective.
        """
        if not (dt > 0 and np.isfinite(dt)):
            raise ValueError(f"The time step is {dt}; it must be finite and greater than zero [s].")
        tick = time.perf_counter()
        n, d = self.num_cells, self.dimension
        if fields is None:
            phi, drag, source = np.ones(n), np.zeros(n), np.zeros((n, d))
        else:
            phi, drag = fields[0].x.array[:n].copy(), fields[1].x.array[:n]
            source = fields[2].x.array.reshape(-1, d)[:n]
            if n and not phi.min() > 0:
                raise ValueError(f"The void fraction of cell {int(np.argmin(phi))} on rank {self.comm.rank} is "
                                 f"{phi.min():g}; it must be positive. Use larger cells or smoothing.")
        phi0 = phi if self.void_fraction is None else self.void_fraction
        if not self.ready:
            self._setup()
            self.set_boundary_values(phi0 if phi0 is not phi or fields is not None else None)
        q = self.velocity.x.array.reshape(-1, d)[:n].copy()
        rate0, self.rate = self.rate, (phi - phi0) / dt
        flux = self.step_flux = self._mass_flux(dt, phi0, q)
        self.time, self.step = self.time + dt, self.step + 1
        self.second_order = self.time_order == 2 and self.step > START_STEPS and not self.upwind
        self.damping = drag * dt / (self.density * phi + drag * dt)
        u = self._relax(dt, phi0, q)
        self.set_boundary_values(None if fields is None else phi)
        self.cell_mass = self.density * phi * self.volume
        transported, defect = self._fade(dt, q, u)
        nodal = self._transport_step(dt, phi0, phi, flux, u, defect)
        # the rate at the end of the step, where continuity is imposed: of the parabola through three void fractions
        end_rate = self.rate + (dt / (dt + self.dt) * (self.rate - rate0) if self.second_order else 0.0)
        share = phi if pressure_share is None else pressure_share
        self._exchange(dt, phi, share, end_rate, drag, source, nodal, transported)
        self.void_fraction, self.void_fractions, self.dt = phi, (phi0, phi), dt
        self.seconds["fluid"] += time.perf_counter() - tick

    def _mass_flux(self, dt, phi0, q):
        """Mass flux rho phi u of the step: carried on to its middle for second order, and closed if the void fraction moves."""
        flux, last, now = np.empty_like(q), self._last_flux, np.empty_like(q)
        part = 0.5 * dt / self.dt if self.time_order == 2 and last is not None and not self.upwind else 0.0
        kernels.mass_flux(self.dofs, self.density, phi0, q, part, now if last is None else last, now, flux)
        self._last_flux = now
        moves = np.any(self.rate) or (self.step == 0 and np.any(q))
        if largest(self.ranks, float(moves)):
            self._to_close = 3  # steps whose flux is made of velocities that fit another rate
        if not self._to_close:
            return flux
        self._to_close -= 1
        self._closed_flux = self._closed_flux or ClosedFlux(self)
        return self._closed_flux(flux, self.time + 0.5 * dt)

    def _relax(self, dt, phi0, q):
        """Stage 1: u <- u + a P(q - mean u) moves the nodes towards the least-squares fit of the cells.

        a = 1 - exp(-2 dt r) with the cells' rate r of convection and viscosity: a rate, not a part per step, so that the
        scheme converges with the step.
        """
        d = self.dimension
        self.cell_mass0 = self.density * phi0 * self.volume
        self.mass0, part = self.nodal_zeros(()), self.nodal_zeros(())
        misfit, feed = self.nodal_zeros((d,)), self.nodal_zeros((d,))
        start = self.nodal_zeros((d,)) if self.nodal_velocity is None else self.nodal_velocity
        kernels.mass_and_misfit(self.dofs, self.cell_mass0, q, start, self.h, self.viscosity / self.density, dt, self.damping, self.gain,
                                self.nodal_gain, self.mass0, misfit, part, feed, self.theta)
        if self.upwind:  # towards the plain mean of the cells, which stays in their range
            misfit[:], feed[:] = 0.0, 0.0
            kernels.scatter(self.dofs, self.cell_mass0[:, None] * q, misfit)
            self.complete(self.mass0, misfit, part)
            misfit -= self.mass0[:, None] * start
        else:
            self.complete(self.mass0, misfit, part, feed)
        u = np.empty_like(start)
        node_kernels.relaxed(start, part, misfit, feed, self.mass0, self.nodal_velocity is None, u)
        self.impose(u)
        return u

    def _transport_step(self, dt, phi0, phi, flux, u, defect):
        """Stage 2: convection and viscosity of the nodal velocity, implicit, skew-symmetric, conserving momentum."""
        d, values = self.dimension, self._transport.values
        theta = self.theta_of(self.viscosity / self.density, dt)
        share = 0.5 * (phi0 + phi) if self.second_order else phi
        stress = self.viscosity * (np.ones_like(phi) if self.stress_of_mixture else share)
        if self.turbulence is not None:
            stress = stress + self.density * share * self.turbulence(self, u)
        explicit = self.nodal_zeros((d,))
        kernels.transport_matrix(self.dofs, self.gradient, self.volume, self.density, stress, dt, phi, self.rate,
                                 flux, self.fixed_pressure, theta, u, values, explicit)
        if self.stabilisation is not None:
            self.stabilisation(self, share, flux, u, values, explicit)
        for facets, _ in self.outlets:
            kernels.open_boundary(facets.cell, facets.local, facets.area_normal, flux, values)
        lift = self.nodal_zeros((d,))
        self._transport.fix(self.fixed, lift, self.boundary_velocity)
        self.complete(explicit, lift)
        self._transport.assemble()
        self._transport.release()
        self.transport_solver.new_values()
        own, new, rhs, system = self.owned_nodes, u.copy(), np.empty_like(u), np.empty((d, self.owned_nodes))
        node_kernels.transport_load(self.mass0, u, self.force, explicit, lift, dt, self.held, self.boundary_velocity,
                                    self._transport.diagonal(), rhs, system)
        guess = u[:own] if self.last_change is None else u[:own] + self.last_change[:own]
        for k in range(d):
            new[:own, k] = self.transport_solver.solve(system[k], guess[:, k])
        self.last_change = new - u
        self.node_halo.forward(new)
        # one evaluation of the fluxes at the solution makes the balance exact whatever the solver's tolerance
        self.mass = self.nodal_zeros(())
        kernels.scatter(self.dofs, self.cell_mass[:, None], self.mass[:, None])
        balance = self.nodal_zeros((d,))
        kernels.apply_elements(self.dofs, values, new, balance)
        self.complete(self.mass, balance, defect)
        self._correction = np.empty_like(new)
        node_kernels.close_transport(self.mass, rhs, balance, defect, dt, self.held, new, self._correction)
        self.reaction = balance  # at fixed nodes: what the wall adds per time to hold the velocity
        self.impose(new)
        node_kernels.take_force(new, self._force_ahead(dt), self.mass, dt, rhs)
        return rhs

    def _force_ahead(self, dt):
        """The last step's nodal force of drag and pressure; where walls hold the nodes, carried on to this step.

        A wall takes its share of the force on a cell. With the last step's share that would be an error of first order in time.
        What is added is at most the force itself: no noise grows by it.
        """
        force, last, self.last_force = self.force, self.last_force, self.force
        if last is None or not self.second_order:
            return force
        ratio = min((dt + self.dt) / (2 * self.dt), 1.5)
        out = np.empty_like(force)
        node_kernels.carry_on(force, last, ratio, self.held, self.slip_nodes, self.slip_normals, out)
        return out

    def _fade(self, dt, q, u):
        """What the nodes cannot represent fades at the rate of convection and viscosity; nodal sums of the momentum it lost."""
        d = self.dimension
        kept, defect = np.empty_like(q), self.nodal_zeros((d,))
        kernels.memory(self.dofs, self.cell_mass0, self.cell_mass, q, u, self.h, dt, self.viscosity / self.density, self.theta,
                       self.damping, self.gain, self.nodal_gain, kept, defect)
        return kept, defect

    def _exchange(self, dt, phi, share, rate, drag, source, nodal, transported):
        """Stage 3: drag and pressure together; an exact projection with the drag on the diagonal."""
        n, d = self.num_cells, self.dimension
        q, diagonal, weight, rhs = np.empty((n, d)), np.empty(n), np.empty(n), self.nodal_zeros(())
        body = self.density * self.gravity + self.mean_pressure_gradient
        middle = self.time - (0.5 * dt if self.second_order else 0.0)
        body = np.broadcast_to(body, (n, d)) + (0.0 if self.body_force is None else
                                                self.at_cells(self.body_force, (n, d), middle))
        self.supply = rate - (0.0 if self.mass_source is None else self.at_cells(self.mass_source, (n,)))
        kernels.exchange_system(self.dofs, self.gradient, self.volume, self.density, dt, phi, share, self.supply, drag, source,
                                body, nodal, self._correction, transported, q, diagonal, weight, rhs)
        self.inflow = self.inflow_at(self.time)
        rhs += self.inflow
        self.pressure_equation.solve(weight, rhs)
        change = self.nodal_zeros((d,))
        kernels.pressure_step(self.dofs, self.gradient, self.volume, self.density, dt, phi, share, diagonal,
                              self.pressure.x.array, transported, q, self.gain, change)
        self.complete(change)
        self.velocity.x.array.reshape(-1, d)[:n] = q
        self.cell_halo.forward(self.velocity.x.array.reshape(-1, d))
        self.nodal_gain, self.nodal_velocity = change / self.mass[:, None], np.empty_like(change)
        node_kernels.take_force(nodal, change, self.mass, -dt, self.nodal_velocity)
        self.impose(self.nodal_velocity)
        self.force = change
        if self.upwind:  # which takes nothing beforehand
            self.gain[:], self.nodal_gain[:] = 0.0, 0.0
