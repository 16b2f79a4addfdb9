"""Stage 2 of the fluid's step: nodes carry the velocity."""
import numpy as np

from fe_el.compiled.cache import njit
from fe_el.compiled.for_each_dimension import FAST, D, M, by_dimension
from fe_el.fluid import cell_kernels, node_kernels
from fe_el.fluid.continuity import ClosedFlux
from fe_el.fluid.forces_on_cells import ForcesOnCells
from fe_el.fluid.records import Held, Load, NodalSystem, Void
from fe_el.fluid.relaxation import Relaxation
from fe_el.fluid.state import StepState
from fe_el.parallel.messages import largest


@by_dimension
def mass_flux(dofs, density, phi, q, part, last, now, flux):
    """Mass flux ``now`` of velocity q, and ``flux``, carried on from the last one by a ``part`` of its change."""
    for c in range(len(dofs)):
        for k in range(D):
            now[c, k] = density * phi[c] * q[c, k]
            flux[c, k] = now[c, k]
            if part != 0.0:
                flux[c, k] += part * (now[c, k] - last[c, k])


@by_dimension
def transport_matrix(cells, step, entries, void, stress, flux, open_node, thetas, u, rhs):
    """Add lumped mass, skew-symmetric convection and viscosity to ``entries``; one theta step of the latter two, theta by
    cell.

    ``stress`` is the cell's share of the stress times the viscosity. The void fraction's rate enters as the divergence that
    the flux really has (equal to it up to the solver's tolerance), so that momentum is kept to round-off; nodes of outlets,
    where continuity is not imposed, take the rate itself. What acts on the old velocity u goes to ``rhs``. With ``upwind``,
    what couples two nodes with the wrong sign goes to the diagonal: no node is repelled by another.
    """
    dofs, grad, volume, place, values = cells.dofs, cells.gradient, cells.volume, entries.place, entries.values
    phi1, rate, density, dt, upwind = void.fraction, void.rate, step.density, step.dt, step.upwind
    n = len(dofs)
    share = 1.0 / M
    parts = u.shape[1]
    out, diagonal, old, total = np.empty(M), np.empty(M), np.empty((M, parts)), np.empty((M, parts))
    for c in range(n):
        vol, theta = volume[c], thetas[c]
        inertia, change = share * vol * density * phi1[c] / dt, 0.5 * share * vol * density * rate[c]
        for i in range(M):
            out[i], diagonal[i] = 0.0, inertia
            for k in range(D):
                out[i] += grad[c, i, k] * flux[c, k]
            out[i] *= 0.5 * share * vol
            side = change if open_node[dofs[c, i]] else M * out[i]
            diagonal[i] -= theta * side
            for k in range(parts):
                old[i, k] = u[dofs[c, i], k]
                total[i, k] = -(side + M * out[i]) * old[i, k]  # the sum of the row times u
        for i in range(M):
            for j in range(i):
                g = 0.0
                for k in range(D):
                    g += grad[c, i, k] * grad[c, j, k]
                g *= stress[c] * vol
                skew, excess = out[j] - out[i], 0.0
                if upwind:
                    excess = max(theta * (abs(skew) + g), 0.0)
                values[place[c, i, j]] += theta * (g + skew) - excess
                values[place[c, j, i]] += theta * (g - skew) - excess
                diagonal[i] -= theta * g - excess
                diagonal[j] -= theta * g - excess
                for k in range(parts):
                    rise = old[j, k] - old[i, k]
                    total[i, k] += (g + skew) * rise
                    total[j, k] -= (g - skew) * rise
        for i in range(M):
            values[place[c, i, i]] += diagonal[i]
            for k in range(parts):
                rhs[dofs[c, i], k] -= (1.0 - theta) * total[i, k]


@njit(fastmath=FAST)
def open_boundary(place, values, cell, local, area_normal, flux):
    """Half the outgoing mass flux on open facets, lumped; the flux that comes in brings no energy (backflow-safe)."""
    d = flux.shape[1]
    for f in range(len(cell)):
        c, out = cell[f], 0.0
        for k in range(d):
            out += area_normal[f, k] * flux[c, k]
        out *= 0.5
        if out > 0:
            for i in range(place.shape[1]):
                if i != local[f]:
                    values[place[c, i, i]] += out / d


class Transport(Relaxation, ForcesOnCells):
    """Convection and viscosity by the nodal velocity: implicit, skew-symmetric, conserving momentum."""

    def theta_of(self, diffusivity: float | np.ndarray, dt: float, second_order: bool) -> np.ndarray:
        """Implicit part (cells,) of transport: 1/2, and more where diffusion is so fast that half a step of it would only
        ring."""
        if not second_order:
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

    def _mass_flux(self, step: StepState) -> None:
        """Mass flux rho phi u of the step: carried on to its middle for second order, and closed if the void fraction
        moves."""
        state, q = self.state, step.velocity
        last, step.flux = state.last_flux, self.work.empty("flux", *q.shape)
        now = self.work.other("last_flux", last, *q.shape)
        part = 0.5 * step.dt / state.dt if self.time_order == 2 and last is not None and not self.upwind else 0.0
        mass_flux(self.dofs, self.density, step.before, q, part, now if last is None else last, now, step.flux)
        state.last_flux = now
        if largest(self.ranks, float(step.moves or (self.step == 0 and np.any(q)))):
            state.to_close = 3  # steps whose flux is made of velocities that fit another rate
        if state.to_close:
            state.to_close -= 1
            self._closed_flux = self._closed_flux or ClosedFlux(self)
            self._closed_flux(step, self.time + 0.5 * step.dt)

    def _stress(self, step: StepState) -> np.ndarray:
        """The cells' share of the stress (cells,); that times the viscosity goes to the step."""
        share, step.stress = self.work.empty("share", self.num_cells), self.work.empty("stress", self.num_cells)
        cell_kernels.stress_of(step.before, step.after, step.second_order, self.viscosity, self.stress_of_mixture, share,
                               step.stress)
        if self.turbulence is not None:
            self.eddy_viscosity = self.turbulence(self, step.nodal_velocity)
            step.stress += self.density * share * self.eddy_viscosity
        return share

    def _transport(self, step: StepState) -> None:
        """Stages 2 and 3: one matrix for all components, solved; then the balance at the solution, and fading."""
        d, work, state, u = self.dimension, self.work, self.state, step.nodal_velocity
        explicit, lift = self._assemble(step)
        rhs, own = work.empty("rhs", self.nodes, d), self.owned_nodes
        system, guess = work.empty("system", d, own), work.empty("guess", d, own)
        given = work.zeros("no_force", self.nodes, d) if step.drag_inside else state.force
        node_kernels.transport_load(step.nodal_mass_before, u, state.last_change, Load(given, explicit, lift), step.dt,
                                    Held(self.held, self.boundary_velocity), self.transport_matrix.diagonal(),
                                    NodalSystem(rhs, system, guess))
        new = work.empty("transported", self.nodes, d)
        for k in range(d):
            new[:own, k] = self.transport_solver.solve(system[k], guess[k])
        self.node_halo.forward(new)
        if step.drag_inside:
            self.drag_in_transport.correct(step, new, rhs, system)
        np.subtract(new, u, out=state.last_change)
        defect = self.drag_in_transport.close(step, new) if step.drag_inside else self._fade(step)
        if self.wall_friction is not None:
            self.wall_friction.close(new)
        self._balance(step, new, rhs, defect)

    def _assemble(self, step: StepState) -> tuple[np.ndarray, np.ndarray]:
        """The matrix of transport, and forces on the nodes (nodes, d): by the velocity before, and by held nodes [N]."""
        d, work, matrix, u = self.dimension, self.work, self.transport_matrix, step.nodal_velocity
        share = self._stress(step)
        explicit, lift = work.zeros("explicit", self.nodes, d), work.zeros("lift", self.nodes, d)
        matrix.values.fill(0.0)
        thetas = self.theta_of(self.viscosity / self.density, step.dt, step.second_order)
        transport_matrix(self.cells, step.numbers, matrix.entries, Void(step.after, step.rate), step.stress, step.flux,
                         self.fixed_pressure, thetas, u, explicit)
        if self.wall_friction is not None:
            self.wall_friction.add(step, thetas, matrix, explicit)
        self._collect(step)
        if step.drag_inside:
            self.drag_in_transport.add(step, explicit)
        if self.stabilisation is not None and not self.upwind:
            self.stabilisation(self, share, step.flux, u, matrix, explicit)
        for facets, _ in self.outlets:
            open_boundary(*matrix.entries, facets.cell, facets.local, facets.area_normal, step.flux)
        matrix.fix(self.fixed, lift, self.boundary_velocity)
        self.complete(explicit, lift)
        explicit += self.state.slip_force  # of the last step: transport does not know what keeps the flow along slip walls
        matrix.assemble()
        matrix.release()
        self.transport_solver.new_values()
        return explicit, lift

    def _balance(self, step: StepState, new: np.ndarray, rhs: np.ndarray, defect: np.ndarray) -> None:
        """The transported nodal velocity, less the force that it was given beforehand; in ``rhs``.

        One evaluation of the fluxes at the solution makes the balance exact whatever the solver's tolerance.
        """
        d, work, dt = self.dimension, self.work, step.dt
        step.reaction, step.correction = work.zeros("balance", self.nodes, d), work.empty("correction", self.nodes, d)
        self.transport_matrix.subtract_product(new, step.reaction)
        self.complete(step.reaction, defect)
        node_kernels.close_transport(step.nodal_mass, rhs, step.reaction, defect, dt, self.held, new, step.correction)
        if not self.upwind:
            node_kernels.slip(new, self.slip_nodes, self.slip_normals, self.fixed, step.nodal_mass, 1 / dt,
                              self.state.slip_force)
        self.impose(new)
        self._force_ahead(step)
        node_kernels.take_force(new, step.taken, step.nodal_mass, dt, rhs)
        step.transported = rhs

    def _force_ahead(self, step: StepState) -> None:
        """The force of drag and pressure that transport was given; where walls hold the nodes, that of the last step carried
        on to this one.

        A wall takes its share of the force on a cell. With the last step's share that would be an error of first order in
        time. What is added is at most the force itself: no noise grows by it.
        Where drag takes part in transport this step's is known; of the pressure's part, what is carried on would be
        answered by drag and grow.
        """
        state, last = self.state, self.state.last_force
        if step.drag_inside:
            step.taken, state.last_force = step.given, None
            return
        step.given = step.taken = state.last_force = state.force
        if last is None or not step.second_order:
            return
        ratio = min((step.dt + state.dt) / (2 * state.dt), 1.5)
        step.taken = self.work.empty("force_ahead", *step.given.shape)
        node_kernels.carry_on(step.given, last, ratio, self.held, self.slip_nodes, self.slip_normals, step.taken)
