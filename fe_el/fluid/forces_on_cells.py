"""What acts on the cells in a step of the fluid: drag, sources, body force, and the volume that they give off."""
import numpy as np

from fe_el.fluid import cell_kernels
from fe_el.fluid.boundary_conditions import Boundaries
from fe_el.fluid.records import Exchange
from fe_el.fluid.state import StepState


class ForcesOnCells(Boundaries):
    """Collects it, once the friction of walls is known."""

    def _collect(self, step: StepState) -> None:
        """What acts on the cells, with the friction of layers that the mesh does not resolve."""
        drag, source = (step.drag, step.source) if self.wall_friction is None else self.wall_friction.in_cells(step)
        body, share = self._body_force(step), step.share
        if step.handed is not None:  # of the solved pressure alone
            body, share = (share / (share + step.handed))[:, None] * body, share + step.handed
        step.acting, step.inflow = Exchange(share, self._supply(step), drag, source, body), self.inflow_at(self.time)

    def _supply(self, step: StepState) -> np.ndarray:
        """Fluid volume that each cell gives off per volume and time, at the end of the step, where continuity is imposed.

        The rate of the void fraction there is that of the parabola through three void fractions.
        """
        supply = self.work.empty("supply", self.num_cells)
        part = step.dt / (step.dt + self.state.dt) if step.second_order else 0.0
        cell_kernels.supply_of(step.rate, step.last_rate, part, supply)
        if self.mass_source is not None:
            supply -= self.at_cells(self.mass_source, (self.num_cells,))
        return supply

    def _body_force(self, step: StepState) -> np.ndarray:
        """Of each cell (cells, d), or of all (1, d) [N/m^3]."""
        n, d, work = self.num_cells, self.dimension, self.work
        body = work.empty("constant_body", 1, d) if self.body_force is None else work.empty("body", n, d)
        body[:] = self.density * self.gravity + self.mean_pressure_gradient
        if self.body_force is not None:
            body += self.at_cells(self.body_force, (n, d), self.time - (0.5 * step.dt if step.second_order else 0.0))
        return body
