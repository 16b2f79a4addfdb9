"""The Poisson equation of the pressure: assembled when its weights change, with fixed pressures at outlets."""
import numpy as np
from mpi4py import MPI

from fe_el.compiled.for_each_dimension import D, M, by_dimension
from fe_el.fluid import node_kernels
from fe_el.nodes import nodal_kernels
from fe_el.nodes.linear_solver import LinearSolver
from fe_el.nodes.nodal_matrix import NodalMatrix
from fe_el.parallel.messages import largest


@by_dimension
def poisson_matrix(dofs, place, grad, weight, values):
    """Add (weight grad p, grad w) to ``values``; ``weight`` holds the cell's volume."""
    for c in range(len(dofs)):
        for i in range(M):
            for j in range(i + 1):
                g = 0.0
                for k in range(D):
                    g += grad[c, i, k] * grad[c, j, k]
                values[place[c, i, j]] += weight[c] * g
                if i != j:
                    values[place[c, j, i]] += weight[c] * g


class PressureEquation:
    """(weight grad p, grad w) = rhs on the nodes of a fluid, with its fixed pressures.

    Args:
        fluid (VolumeAveragedNavierStokes): with its boundary conditions.

    Note:
        Collective.
    """

    def __init__(self, fluid):
        self.fluid, self.held = fluid, np.flatnonzero(fluid.fixed_pressure)
        self._weight, self._values = np.full(fluid.num_cells, np.nan), np.full(fluid.nodes, np.nan)  # equal to none
        self._misses = np.zeros(1 + fluid.state.past_pressures.shape[1])
        self._boundary, self._lift = np.zeros((fluid.nodes, 1)), np.zeros((fluid.nodes, 1))
        self.entries = NodalMatrix(fluid.space, fluid.dofs)
        self.solver = LinearSolver(self.entries.matrix, "pressure", "cg", "gamg", fluid.tolerance, not fluid.outlets)

    def solve(self, weight, rhs):
        """New pressure of the fluid, in place.

        Args:
            weight: (cells,) factor times the cell's volume.
            rhs: (nodes,) loads of this rank's cells; changed.

        Raises:
            SolverDiverged: if the solver fails.
        """
        air, own, p, work = self.fluid, self.fluid.owned_nodes, self.fluid.nodal_pressure, self.fluid.work
        self.assemble(weight)
        rhs += self._lift[:, 0]
        air.node_halo.reverse_add(rhs)
        nodal_kernels.fix_entries(self.held, self._diagonal, self._boundary[:, 0], rhs)
        guess, old = work.empty("pressure_guess", air.nodes), work.empty("old_pressure", air.nodes)
        past = air.state.past_pressures
        old[:] = p
        node_kernels.extrapolate(past, old, air.state.guess_order, guess)
        p[:own] = self.solver.solve(rhs[:own], guess[:own])
        air.node_halo.forward(p)
        self._choose_order(past, old, p[:own])

    def _choose_order(self, past, old, new):
        """The order of extrapolation for the next guess: that which would have come closest this time."""
        air, misses = self.fluid, self._misses
        node_kernels.misses(past, old, new, misses)
        air.comm.Allreduce(MPI.IN_PLACE, misses)
        air.state.guess_order = int(np.argmin(misses[:min(air.step, len(misses))]))  # at the first step there is no past

    def at_outlets(self):
        """Fixed pressures (nodes,) of now [Pa]; zero elsewhere."""
        for facets, value in self.fluid.outlets:
            self._boundary[facets.nodes, 0] = value(self.fluid.time) if callable(value) else value
        return self._boundary[:, 0]

    def assemble(self, weight):
        """The matrix, unless nothing that enters it has changed on any rank. Collective."""
        air, values = self.fluid, self.at_outlets()
        as_before = nodal_kernels.same(weight, self._weight) and nodal_kernels.same(values, self._values)
        if not largest(air.ranks, float(not as_before)):
            return
        self._weight[:], self._values[:] = weight, values
        self._lift.fill(0.0)
        self.entries.values.fill(0.0)
        poisson_matrix(air.dofs, self.entries.place, air.gradient, weight, self.entries.values)
        self.entries.fix(air.fixed_pressure, self._lift, self._boundary)
        self.entries.assemble()
        self.solver.new_values()
        self._diagonal = self.entries.diagonal()
