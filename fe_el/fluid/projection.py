"""Stage 4 of the fluid's step: drag and pressure together."""
import numpy as np

from fe_el.compiled.for_each_dimension import D, M, by_dimension
from fe_el.fluid import node_kernels
from fe_el.fluid.boundary_conditions import Boundaries
from fe_el.fluid.records import PressureSystem
from fe_el.fluid.state import StepState


@by_dimension
def exchange_system(cells, step, phi, given, u, correction, kept, q, equation):
    """Cell velocities before the pressure, and the right-hand side of the Poisson equation that follows from eliminating
    them.

    Sets kept to the transported velocity and q to (rho phi/dt u_T + B + part f) / (rho phi/dt + A); ``part`` is the share of
    pressure gradient and body force f that the fluid takes, phi unless the step is one of several; ``weight`` is that of the
    equation. f is ``body``, of each cell or of all.
    """
    dofs, grad, volume, density, dt = cells.dofs, cells.gradient, cells.volume, step.density, step.dt
    part, supply, drag, source, body = given.part, given.supply, given.drag, given.source, given.body
    diagonal, weight, rhs = equation.diagonal, equation.weight, equation.rhs
    n, varies = len(dofs), len(body) > 1
    share = 1.0 / M
    for c in range(n):
        inertia = density * phi[c] / dt
        diagonal[c] = inertia + drag[c]
        weight[c] = phi[c] * part[c] / diagonal[c] * volume[c]
        for k in range(D):
            mean = 0.0
            for i in range(M):
                mean += u[dofs[c, i], k] - correction[dofs[c, i], k]
            kept[c, k] += share * mean
            q[c, k] = (inertia * kept[c, k] + source[c, k] + part[c] * body[c if varies else 0, k]) / diagonal[c]
        for i in range(M):
            flux = 0.0
            for k in range(D):
                flux += grad[c, i, k] * q[c, k]
            rhs[dofs[c, i]] += volume[c] * (phi[c] * flux - share * supply[c])


@by_dimension
def pressure_step(cells, step, phi, part, diagonal, p, transported, q, gain, change):
    """Subtract part grad p / (rho phi/dt + A) from q; ``gain`` is the acceleration, ``change`` the momentum per time and
    node."""
    dofs, grad, volume, density, dt = cells.dofs, cells.gradient, cells.volume, step.density, step.dt
    n = len(dofs)
    share = 1.0 / M
    for c in range(n):
        for k in range(D):
            slope = 0.0
            for i in range(M):
                slope += grad[c, i, k] * p[dofs[c, i]]
            q[c, k] -= part[c] / diagonal[c] * slope
            gain[c, k] = (q[c, k] - transported[c, k]) / dt
            given = share * density * phi[c] * volume[c] * gain[c, k]
            for i in range(M):
                change[dofs[c, i], k] += given


@by_dimension
def let_solids_answer(cells, answer, diagonal, part, q, start, p, equation):
    """Add the solids' answer to the pressure equation: (phi u + a (u - u_0) - b grad (p - p_0), grad w) = (dphi/dt, w).

    q is the velocity before the pressure, ``start`` u_0 and p the pressure p_0 of the last step.
    """
    dofs, grad, volume, to_velocity, to_gradient = cells.dofs, cells.gradient, cells.volume, answer.to_velocity, \
        answer.to_gradient
    weight, rhs = equation.weight, equation.rhs
    flux = np.empty(D)
    for c in range(len(dofs)):
        weight[c] += volume[c] * (to_velocity[c] * part[c] / diagonal[c] + to_gradient[c])
        for k in range(D):
            slope = 0.0
            for i in range(M):
                slope += grad[c, i, k] * p[dofs[c, i]]
            flux[k] = volume[c] * (to_velocity[c] * (q[c, k] - start[c, k]) + to_gradient[c] * slope)
        for i in range(M):
            for k in range(D):
                rhs[dofs[c, i]] += grad[c, i, k] * flux[k]


@by_dimension
def answer_of(cells, answer, q, start, rise, out):
    """a (u - u_0) - b grad (p - p_0), with the ``rise`` p - p_0 of the pressure."""
    dofs, grad, to_velocity, to_gradient = cells.dofs, cells.gradient, answer.to_velocity, answer.to_gradient
    for c in range(len(dofs)):
        for k in range(D):
            slope = 0.0
            for i in range(M):
                slope += grad[c, i, k] * rise[dofs[c, i]]
            out[c, k] = to_velocity[c] * (q[c, k] - start[c, k]) - to_gradient[c] * slope


class Projection(Boundaries):
    """(rho phi/dt + A) q = rho phi/dt q_T + B - phi grad p with (phi q, grad w) = (dphi/dt, w) for every P1 w.

    Eliminating q gives one symmetric positive equation of the pressure; grad P1 lies in the space of the cells, so the
    projection is exact, with the drag on the diagonal.

    The rate of the void fraction is that by the particles' last way. Where they are crowded and answer the fluid within a
    step, that way feeds back: a flux (1 - phi) v of solids makes one of the fluid that is (1 - phi)/phi as large, and drags
    them the other way. So what they answer to the fluid's change within the step (``StepState.answer``) is part of the
    balance: (phi q + a (q - q_0) - b grad (p - p_0), grad w) = (dphi/dt, w), which is the same in a steady state.
    """

    def _exchange(self, step: StepState) -> None:
        """Stage 4: cells and nodes get their new velocities."""
        n, d, work, state, dt = self.num_cells, self.dimension, self.work, self.state, step.dt
        q, rhs = work.empty("exchanged", n, d), work.zeros("pressure_load", self.nodes)
        equation = PressureSystem(work.empty("diagonal", n), work.empty("weight", n), rhs)
        share = step.acting.part
        exchange_system(self.cells, step.numbers, step.after, step.acting, step.transported, step.correction, step.kept, q,
                        equation)
        if step.answer is not None:
            before = work.empty("pressure_before", self.nodes)
            before[:] = self.nodal_pressure
            let_solids_answer(self.cells, step.answer, equation.diagonal, share, q, step.velocity, before, equation)
        rhs += step.inflow
        if not self.outlets:
            self.check_closed(step)
        self.pressure_equation.solve(equation.weight, rhs)
        change = work.other("force", state.force, self.nodes, d)
        change.fill(0.0)
        pressure_step(self.cells, step.numbers, step.after, share, equation.diagonal, self.nodal_pressure, step.kept, q,
                      state.gain, change)
        if step.answer is not None:
            step.answered = work.empty("answered", n, d)
            answer_of(self.cells, step.answer, q, step.velocity, self.nodal_pressure - before, step.answered)
        self.complete(change)
        self.cell_velocity[:n] = q
        self.cell_halo.forward(self.cell_velocity)
        new = work.empty("nodal_velocity", self.nodes, d)
        node_kernels.after_exchange(step.transported, change, step.correction, step.nodal_mass, dt, new, state.nodal_gain)
        self.impose(new)
        self.node_halo.forward(new)
        state.force, state.nodal_velocity = change, new
        if self.upwind:  # which takes nothing beforehand
            state.gain.fill(0.0)
            state.nodal_gain.fill(0.0)
