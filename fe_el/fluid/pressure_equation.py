"""The Poisson equation of the pressure: assembled when its weights change, with fixed pressures at outlets."""
import numpy as np

from fe_el.fluid import kernels
from fe_el.fluid.linear_solver import ElementMatrix, LinearSolver
from fe_el.messages import largest


class PressureEquation:
    """(weight grad p, grad w) = rhs on the nodes of a fluid, with its fixed pressures.

    Args:
        fluid (VolumeAveragedNavierStokes): with its boundary conditions.

    Note:
        Collective.
    """

    def __init__(self, fluid):
        self.fluid, self._weight, self._boundary = fluid, None, None
        self.elements = ElementMatrix(fluid.space, fluid.dofs)
        self.solver = LinearSolver(self.elements.matrix, "pressure", "cg", "gamg", fluid.tolerance, not fluid.outlets)

    def solve(self, weight, rhs):
        """New pressure of the fluid, in place.

        Args:
            weight: (cells,) factor times the cell's volume.
            rhs: (nodes,) loads of this rank's cells; changed.

        Raises:
            SolverDiverged: if the solver fails.
        """
        air, own, p = self.fluid, self.fluid.owned_nodes, self.fluid.pressure.x.array
        boundary = air.nodal_zeros((1,))
        for facets, value in air.outlets:
            boundary[facets.nodes, 0] = value(air.time) if callable(value) else value
        self._assemble(weight, boundary)
        rhs += self._lift[:, 0]
        air.node_halo.reverse_add(rhs)
        fixed = air.fixed_pressure[:own]
        rhs[:own][fixed] = self._diagonal[fixed] * boundary[:own, 0][fixed]
        old, last = p.copy(), air.last_pressure
        p[:own] = self.solver.solve(rhs[:own], (old if last is None else 2 * old - last)[:own])
        air.last_pressure = old
        air.node_halo.forward(p)

    def _assemble(self, weight, boundary):
        """The matrix, unless nothing that enters it has changed on any rank."""
        air = self.fluid
        same = np.array_equal(weight, self._weight) and np.array_equal(boundary, self._boundary)
        if not largest(air.ranks, float(not same)):
            return
        self._weight, self._boundary, self._lift = weight, boundary, air.nodal_zeros((1,))
        kernels.poisson_matrix(air.dofs, air.gradient, weight, self.elements.values)
        self.elements.fix(air.fixed_pressure, self._lift, boundary)
        self.elements.assemble()
        self.solver.new_values()
        self._diagonal = self.elements.diagonal()
