"""Transport with drag inside, for steps that are long against the viscous fading of what one cell alone feels."""
from fe_el.fluid import drag_kernels, kernels
from fe_el.fluid.records import Drag, Faded, Masses
from fe_el.parallel.messages import largest

FASTEST = 0.1  # fading by viscosity in a step, k dt, below which the last step's drag tells enough of this one's


class DragInTransport:
    """Drag and sources of a step as transport sees them, and what viscosity does to a force that one cell alone feels.

    Such a force is balanced by viscosity within 1/k, k the rate at which what the nodes do not carry, r = q - mean u, fades.
    Exchange knows the fluid's inertia alone. Where a step is longer than 1/k, transport foresees the gain g = p + b of the
    cells: p by pressure, as of the last step (less where drag goes away, which had balanced it), and b by drag A and source
    B of this step, all implicit, with S = rho phi, theta of r left after the step, and dt - lag of a gain that stays in r:

        S b = B - A (mean new + r'),   r' = theta r + (dt - lag) (g - mean nodal gain).

    Nodes are given S g and the momentum that r loses, S (r_0 - r') / dt, by viscosity inside the implicit solve, which so
    has drag on its diagonal. Exchange then starts from mean new + r' - dt g: it finds the same drag, and what pressure
    changes. Momentum is exact whatever was foreseen.

    Args:
        fluid (VolumeAveragedNavierStokes): with its boundary conditions.

    Note:
        Collective.
    """

    def __init__(self, fluid):
        self.fluid, self.active = fluid, False
        self.rate = kernels.VISCOUS[fluid.dimension - 2] * fluid.viscosity / fluid.density  # times 1/h^2
        self.fastest = self.rate * largest(fluid.ranks, float((1.0 / fluid.h ** 2).max(initial=0.0)))

    def start(self, dt, drag, source):
        """Whether the step has drag or sources, and is long enough."""
        air = self.fluid
        self.active = not air.upwind and self.fastest * dt > FASTEST and bool(
            largest(air.ranks, float(drag_kernels.any_of(drag, source))))
        if self.active and not air.drag_known:  # the first such step: what was gained counts as drag
            air.drag_gain[:] = air.gain
        self.drag, self.source = drag, source
        return self.active

    def add(self, dt, q, u, load):
        """Add to the matrix of transport and its load (nodes, d); q and u: velocities of cells and nodes at the start."""
        air, work = self.fluid, self.fluid.work
        split, part = work.empty("viscous_share", air.num_cells), work.empty("drag_part", air.num_cells)
        drag_kernels.share_of_viscosity(q, air.h, self.rate, split)
        self.seen = Drag(self.drag, air.last_drag, self.source, air.drag_gain, split, part)
        self.by_pressure = work.other("by_pressure", air.last_force, air.nodes, air.dimension)
        self.by_pressure.fill(0.0)
        drag_kernels.drag_in_transport(air.cells, air.numbers_of_step(dt), Masses(air.cell_mass0, air.cell_mass),
                                       air.transport_matrix.entries, self.seen, q, u, air.memory(), load, self.by_pressure)
        air.complete(self.by_pressure)

    def close(self, dt, q, u, new):
        """What cells keep and the momentum that faded by convection, per node, for the ``new`` nodal velocity."""
        air, work = self.fluid, self.fluid.work
        kept, defect = work.empty("kept", *q.shape), work.zeros("defect", air.nodes, air.dimension)
        air.mass, self.given = work.zeros("mass", air.nodes), work.zeros("given_force", air.nodes, air.dimension)
        masses, sums = Masses(air.cell_mass0, air.cell_mass), Faded(air.mass, defect, self.given)
        drag_kernels.fade_with_drag(air.cells, air.numbers_of_step(dt), masses, self.seen, q, u, new, air.memory(), kept,
                                    sums)
        air.complete(air.mass, self.given)
        drag_kernels.before_exchange(air.dofs, dt, q, u, self.given, air.mass, air.gain, kept, air.fades)
        return kept, defect

    def keep(self, dt, phi, q):
        """Remember what drag and sources gave in this step, if the next may ask for it."""
        air = self.fluid
        air.drag_known = self.active or self.fastest * dt > 0.1 * FASTEST
        if air.drag_known:
            drag_kernels.gain_by_drag(air.density, phi, self.drag, self.source, q, air.drag_gain, air.last_drag)
