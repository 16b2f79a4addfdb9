"""The pressure that belongs to the drag and the sources of a step, found while transport is solved."""
import numpy as np

from fe_el.fluid import coupled_kernels, node_kernels
from fe_el.fluid.pressure_equation import poisson_matrix
from fe_el.fluid.records import SolidsAnswer
from fe_el.nodes.flexible_gmres import flexible_gmres
from fe_el.nodes.linear_solver import LinearSolver
from fe_el.nodes.nodal_matrix import NodalMatrix
from fe_el.parallel.messages import total

# Divergence that may be left: root of its power against viscosity over that of drag, sources and viscosity. By the pressure
# of the last step; and, where that leaves more, by the new one: at 0.05 velocities were 4 to 11 % off where drag jumps.
FITS, ENOUGH = 0.05, 1e-3
ROUNDS, MOST = 5, 10  # of minimal residuals, and iterations in each
LEAST, LOOSE = 0.01, 1e-3  # part of the residual to which a round goes; relative residual of the transport solves in it


class CoupledPressure:
    """Finds the pressure with which transport, with drag and sources inside, fulfils continuity.

    Exchange balances a divergence by the inertia of one step. What viscosity balances it would find only over some
    nu dt / h^2 steps: a force that sets in would meet the pressure of the past. So the change z of the pressure is sought
    with which the velocity v that transport foresees for the cells is that of continuity, (phi v, grad w) = (supply, w):

        K z = what v lacks of it at z = 0,    K = D A^-1 G,

    A being transport with drag, and what cells have beside their nodes. Applying K takes a transport solve of each
    component. Its inverse is nearly that of a Poisson matrix, of what cells and nodes let pass by inertia and drag, and the
    viscosity over the mass matrix (Cahouet & Chabard, Int. J. Numer. Meth. Fluids 8, 1988, 869). The first is solved to the
    tolerance of the fluid: a cycle of multigrid depends on how the mesh is parted, and what few iterations find with it. A
    step that the last pressure fits takes none. Mass and momentum are exact whatever is left: exchange closes them.

    Args:
        fluid (VolumeAveragedNavierStokes): with its boundary conditions.
    """

    def __init__(self, fluid):
        self.fluid, self.solver = fluid, fluid.transport_solver
        self.at_rest, self.none = np.zeros((fluid.nodes, fluid.dimension)), np.zeros((2, fluid.nodes, 1))
        self.held = np.flatnonzero(fluid.fixed_pressure[:fluid.owned_nodes])
        self.entries, self.solvers = None, ()  #: of the preconditioner: none until it is needed

    def correct(self, step, seen, new, rhs, system):
        """Change the gain of the step and the ``new`` nodal velocity, and with them ``rhs`` and ``system`` of transport.

        Args:
            seen (Drag): drag and sources as transport sees them.

        Note:
            Collective.
        """
        air = self.fluid
        self.step, self.seen, self.answer = step, seen, step.answer or SolidsAnswer(air.no_share, air.no_share)
        for done in range(ROUNDS):
            residual, size = self._lack(new)
            if not size > (ENOUGH if done else FITS):
                return
            if not done:
                self._prepare()
            weights, directions = flexible_gmres(self._apply, self._precondition, residual, self._dot, MOST,
                                                 max(ENOUGH / size, LEAST))
            step.pressure_iterations += len(directions)
            if not directions:
                return
            load, change = self._push(sum(w * z for w, z in zip(weights, directions)))
            step.memory.gain[:] += change
            rhs += load
            load[air.held] = 0.0
            for k in range(air.dimension):
                system[k] += load[:air.owned_nodes, k]
                new[:air.owned_nodes, k] = self.solver.solve(system[k], new[:air.owned_nodes, k].copy())
            air.node_halo.forward(new)

    def _lack(self, new):
        """What owned nodes lack of continuity [m^3/s], and how large that is against the power of all that acts, with what
        solvers leave of forces that cancel."""
        air, step, d, own = self.fluid, self.step, self.fluid.dimension, self.fluid.owned_nodes
        u = air.work.empty("foreseen_nodes", air.nodes, d)
        v, flux = self._cells("foreseen", "flux_of_solids")
        coupled_kernels.start_of_cells(air.cells, self.answer, step.memory, self.seen.stay, step.velocity,
                                       step.nodal_velocity, v, flux)
        u[:] = new
        air.impose(u)
        out = air.work.empty("lack", air.nodes)
        out[:] = step.inflow
        coupled_kernels.take_supply(air.dofs, air.volume, step.acting.supply, out)
        lack = self._divergence(u, step.memory.gain, v, flux, out)
        self.viscous = air.work.empty("viscous_weight", own)
        left = coupled_kernels.power_of_lack(lack, air.viscosity * air.density, step.nodal_mass_before, self.viscous)
        power = coupled_kernels.power_of(air.cells, step.acting, step.stress, u, v, air.tolerance / ENOUGH ** 2)
        return lack, np.sqrt(total(air.ranks, left) / max(total(air.ranks, power), 1e-300))

    def _cells(self, *names):
        """Zeros of the cells."""
        return tuple(self.fluid.work.zeros(name, self.fluid.num_cells, self.fluid.dimension) for name in names)

    def _divergence(self, u, gain, v, flux, out):
        """Of nodal velocities and gains, at owned nodes, with what is in ``out``, in place."""
        air = self.fluid
        coupled_kernels.add_divergence(air.cells, self.step.after, self.answer, self.seen, u, gain, v, flux, out)
        air.node_halo.reverse_add(out)
        out[air.fixed_pressure] = 0.0
        return out[:air.owned_nodes]

    def _push(self, z):
        """What a pressure at owned nodes gives to the nodes [N], and to the gain of the cells [m/s^2]."""
        air = self.fluid
        pressure, load = air.work.empty("pressure_change", air.nodes), air.work.zeros("push", air.nodes, air.dimension)
        gain, self.flux = self._cells("pushed_cells", "flux_of_solids")
        pressure[:air.owned_nodes] = z
        air.node_halo.forward(pressure)
        coupled_kernels.push(air.cells, self.answer, self.seen, pressure, gain, self.flux, load)
        air.complete(load)
        return load, gain

    def _apply(self, z):
        """K z."""
        air, own, u = self.fluid, self.fluid.owned_nodes, self.fluid.work.empty("foreseen_nodes", *self.at_rest.shape)
        load, gain = self._push(z)
        load[air.held] = 0.0
        for k in range(air.dimension):
            u[:own, k] = self.solver.roughly(load[:own, k], LOOSE)
        air.node_halo.forward(u)
        node_kernels.impose(u, air.slip_nodes, air.slip_normals, air.held, self.at_rest)
        return -self._divergence(u, gain, *self._cells("foreseen"), self.flux, air.work.zeros("lack", air.nodes))

    def _prepare(self):
        """The Poisson matrix of what cells and nodes let pass without viscosity between nodes."""
        air, step = self.fluid, self.step
        if self.entries is None:
            self.entries = NodalMatrix(air.space, air.dofs)
            self.poisson = LinearSolver(self.entries.matrix, "coupled", "cg", "gamg", air.tolerance, not air.outlets)
            self.solvers = (self.poisson,)
        times, weight = air.work.zeros("nodal_times", air.nodes), air.work.empty("coupled_weight", air.num_cells)
        coupled_kernels.resist(air.dofs, self.seen, times)
        air.complete(times)
        mass = step.nodal_mass_before
        times[:] = step.dt * mass / np.maximum(mass + step.dt * times, 1e-300)
        coupled_kernels.mobilities(air.cells, step.masses.after, step.after, self.answer, self.seen, times, weight)
        self.entries.values.fill(0.0)
        poisson_matrix(air.dofs, self.entries.place, air.gradient, weight, self.entries.values)
        self.entries.fix(air.fixed_pressure, *self.none)
        self.entries.assemble()
        self.poisson.new_values()

    def _precondition(self, lack):
        """About K^-1 times a lack."""
        z = self.poisson.solve(lack, np.zeros_like(lack)) + self.viscous * lack
        z[self.held] = 0.0
        return z

    def _dot(self, a, b):
        return total(self.fluid.ranks, float(a @ b))
