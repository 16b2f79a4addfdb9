"""Transport with drag inside, for steps that are long against the viscous fading of what one cell alone feels."""
import numpy as np

from fe_el.fluid import drag_kernels
from fe_el.fluid.coupled_pressure import CoupledPressure
from fe_el.fluid.records import Drag, Faded
from fe_el.fluid.relaxation import VISCOUS, fade
from fe_el.parallel.messages import largest

FASTEST = 0.1  # fading by viscosity in a step, k dt, below which the last step's drag tells enough of this one's


class DragInTransport:
    """Drag and sources of a step as transport sees them, and what viscosity does to a force that one cell alone feels.

    Such a force is balanced by viscosity within 1/k, k the rate at which what the nodes do not carry, r = q - mean u, fades.
    Exchange knows the fluid's inertia alone. Where a step is longer than 1/k, transport foresees the gain g = p + b of the
    cells: p by body force and pressure, and b by drag A (with that of walls) and source B of this step, all implicit, with
    S = rho phi, the part ``left`` of r, and dt - lag of a gain that stays in r:

        S b = B - A (mean new + r'),   r' = left r + (dt - lag) (g - mean nodal gain).

    Nodes are given S g and the momentum that r loses, S (r_0 - r') / dt, by viscosity inside the implicit solve, which so
    has drag on its diagonal. The pressure is that of the last step, and then what continuity makes of it: see
    :class:`CoupledPressure`. Exchange starts from mean new + r' - dt g: it finds the same drag, and what pressure still
    changes. Momentum is exact whatever was foreseen.

    Args:
        fluid (VolumeAveragedNavierStokes): with its boundary conditions.

    Note:
        Collective.
    """

    def __init__(self, fluid):
        self.fluid = fluid
        self.coupled_pressure, self.rate = CoupledPressure(fluid), 0.0  # of fading by viscosity, times h^2 [m^2/s]
        self.finest = largest(fluid.ranks, float((1.0 / fluid.h ** 2).max(initial=0.0)))

    def start(self, step):
        """Whether the step has drag or sources, and is long enough."""
        air, self.rate = self.fluid, VISCOUS[self.fluid.dimension - 2] * step.numbers.nu  # which may change between steps
        step.drag_inside = not air.upwind and self.rate * self.finest * step.dt > FASTEST and bool(
            largest(air.ranks, float(drag_kernels.any_of(step.drag, step.source))))

    def add(self, step, load):
        """Add to the matrix of transport and its load (nodes, d)."""
        air, work, memory, held = self.fluid, self.fluid.work, step.memory, self.fluid.pressure_equation.held
        if air.step == 1:
            self._balance_body_force(step.acting)
        pressure = work.empty("known_pressure", air.nodes)
        pressure[:] = air.pressure.x.array
        pressure[held] = air.pressure_equation.at_outlets()[held]
        self.seen = Drag(*(work.empty(f"seen_{k}", air.num_cells) for k in range(5)), pressure)
        drag_kernels.share_of_viscosity(step.velocity, air.h, self.rate, step.dt, memory.left, memory.lag, self.seen.split)
        drag_kernels.drag_in_transport(air.cells, step.numbers, step.masses, air.transport_matrix.entries, step.acting,
                                       self.seen, step.velocity, step.nodal_velocity, memory, load)

    def _balance_body_force(self, acting):
        """The pressure before the first step is that which a body force makes in fluid at rest."""
        air, load = self.fluid, self.fluid.nodal_zeros(())
        force = (acting.part * air.volume / air.density)[:, None] * acting.body
        np.add.at(load, air.dofs, np.einsum("cik,ck->ci", air.gradient, force))
        air.pressure_equation.solve(acting.part * air.volume / air.density, load)

    def correct(self, step, new, rhs, system):
        """Give the ``new`` nodal velocity the pressure of continuity, with its ``rhs`` and ``system``."""
        self.coupled_pressure.correct(step, self.seen, new, rhs, system)

    def close(self, step, new):
        """What cells keep, and the momentum that faded by convection, per node of this rank, for the ``new`` nodal
        velocity."""
        air, work, q, u = self.fluid, self.fluid.work, step.velocity, step.nodal_velocity
        step.kept, defect = work.empty("kept", *q.shape), work.zeros("defect", air.nodes, air.dimension)
        step.nodal_mass, step.given = work.zeros("nodal_mass", air.nodes), work.zeros("given_force", *defect.shape)
        gain, fades = step.memory.gain, step.memory.fades
        drag_kernels.gain_with_nodes(air.cells, step.masses.after, self.seen.part, new, gain, step.given)
        fade(air.cells, step.numbers, step.masses, step.memory, self.seen.split, step.dt, q, u, step.kept,
             Faded(step.nodal_mass, defect))
        air.complete(step.nodal_mass, step.given)
        drag_kernels.before_exchange(air.dofs, step.dt, q, u, step.given, step.nodal_mass, gain, step.kept, fades)
        return defect
