"""Stages 1 and 3 of the fluid's step: nodes follow their cells, and what they do not carry of them fades."""
import numpy as np

from fe_el.compiled.cache import njit
from fe_el.compiled.for_each_dimension import FAST, D, M, by_dimension
from fe_el.compiled.parts import part
from fe_el.fluid import node_kernels
from fe_el.fluid.boundary_conditions import Boundaries
from fe_el.fluid.records import Faded
from fe_el.fluid.state import StepState

CUT = 4.0  # Courant number times two from which the last step's gain is not trusted, without drag
VISCOUS = (6.0, 80.0)  # viscous fading rate times h^2 / nu on triangles, tetrahedra: measured, see :func:`mass_and_misfit`


@part(fastmath=FAST)
def fading_rate(speed_squared, h, nu, viscous):
    """Rate at which what a cell's neighbours do not share is carried off: by convection, and ``viscous`` nu / h^2 [1/s]."""
    return 2.0 * np.sqrt(speed_squared) / h + viscous * nu / (h * h)


@njit(fastmath=FAST)
def relaxation_rate(speed_squared, h, nu):
    """Rate at which nodes take over what the cells around them share [1/s]; slow in viscous flow, where the nodes need no
    help."""
    return 4.0 * np.sqrt(speed_squared) / h + nu / (h * h)


@part(fastmath=FAST)
def relaxation_rate_at_wall(speed_squared, h, nu):
    """The same for nodes on no-slip walls: the cells lie on one side of them, so where the mesh resolves the layer what
    these share is no error of the nodes; where convection is far faster than viscosity the nodes follow as others do."""
    convection = 4.0 * np.sqrt(speed_squared) / h
    return convection * convection / (convection + 16.0 * nu / (h * h) + 1e-300)


@part(fastmath=FAST)
def left_of(x):
    """What is left after a time x of something that fades at a rate of one: exp(-x) to the third order."""
    return 1.0 / (1.0 + x * (1.0 + x * (0.5 + x / 6.0)))


@part(fastmath=FAST)
def lag_of(left, x):
    """1 - (1 - left) / x with left = left_of(x): the part of a step that a steady gain misses of its fading."""
    return left * x * (0.5 + x * (1.0 / 3.0 + x / 6.0))


@part(fastmath=FAST)
def trust(convective, fading, damping):
    """Part of a lag to be taken: less in steps that are long against the fading by convection (``convective``: two Courant
    numbers).

    There the gain of the last step no longer tells that of this one, and energy would grow. With drag (``damping`` = A dt /
    (rho phi + A dt)) steps may be longer. Where nearly all of the ``fading`` is of viscosity it does no harm in steps of any
    length.
    """
    ratio = convective / (CUT + (16.0 - CUT) * damping)
    ratio *= ratio
    viscous = max(fading - convective, 0.0) / max(fading, 1e-300)
    viscous *= viscous * (3.0 - 2.0 * viscous)
    return (1.0 + viscous * viscous * ratio * ratio) / (1.0 + ratio * ratio)


@by_dimension
def mass_and_misfit(cells, step, weight, damping, q, u, known, at_wall, sums):
    """What relaxation needs at the nodes, in ``sums`` (nodes, 2 + 2 d), and what is left of what the nodes do not carry, in
    the :class:`Memory` ``known``.

    The sums are those of the cell masses; of mass times the part of the misfit that is taken over in a step; of mass times
    the misfit q - mean u, as in a least-squares fit (with ``upwind`` of mass times q alone); and of what is taken over of
    the misfit that comes about during the step: what drag and pressure add (gain - mean nodal gain) less what ``fades``, as
    of the last step. ``left`` gets the part of what the nodes do not carry that is left after the step, ``lag`` the time of
    the step in which what drag and pressure add does not fade, as it acts at the end.

    In steady viscous flow a force that acts in one cell raises its velocity by force / (rho VISCOUS nu / h^2) beside what
    the nodes carry. With 80 the whole is, on tetrahedra, that of Taylor-Hood elements on the same mesh within 2 %, for
    single cells and for ten that lie apart (ten in a heap: 15 to 21 % less, the nodes' part); on triangles larger rates
    make steady pressures worse. In steps longer than the fading drag takes part in transport: see ``DragInTransport``.
    """
    dofs, h, dt, nu, upwind = cells.dofs, cells.size, step.dt, step.nu, step.upwind
    gain, nodal_gain, fades, left, lag = known.gain, known.nodal_gain, known.fades, known.left, known.lag
    n = len(dofs)
    share = 1.0 / M
    misfit, feed = np.empty(D), np.empty(D)
    for c in range(n):
        speed = 0.0
        for k in range(D):
            speed += q[c, k] * q[c, k]
        fading, relax = dt * fading_rate(speed, h[c], nu, VISCOUS[D - 2]), dt * relaxation_rate(speed, h[c], nu)
        left[c], kept = left_of(fading), left_of(relax)
        mass, time = share * weight[c], dt * trust(2.0 * dt * np.sqrt(speed) / h[c], fading, damping[c])
        lag[c] = time * lag_of(left[c], fading)
        taken, given = mass * (1.0 - kept), time * lag_of(kept, relax)
        wall_relax = dt * relaxation_rate_at_wall(speed, h[c], nu)
        wall_kept = left_of(wall_relax)
        wall_given = time * lag_of(wall_kept, wall_relax)
        for k in range(D):
            mean, rise = 0.0, 0.0
            for i in range(M):
                mean += u[dofs[c, i], k]
                rise += nodal_gain[dofs[c, i], k]
            misfit[k] = mass * (q[c, k] - (0.0 if upwind else share * mean))
            feed[k] = 0.0 if upwind else mass * (gain[c, k] - share * rise - fades[c, k])
        for i in range(M):
            node = dofs[c, i]
            feeding = wall_given if at_wall[node] else given
            sums[node, 0] += mass
            sums[node, 1] += mass * (1.0 - wall_kept) if at_wall[node] else taken
            for k in range(D):
                sums[node, 2 + k] += misfit[k]
                sums[node, 2 + D + k] += feeding * feed[k]


@by_dimension
def fade(cells, step, masses, known, split, whole, q, u, kept, sums):
    """What the nodes do not carry, r = q - mean u, fades at a rate k.

    Of ``sums`` the ``defect`` gets the momentum that r lost, per node, ``mass`` the nodal mass at the end of the step;
    ``fades`` of the :class:`Memory` gets the change per time.

    Drag and pressure feed r with a = gain - mean nodal gain. As of the last step (``whole`` = 0) they act after the fading,
    over a whole step; what fades of that meanwhile, lag times a, is taken off beforehand. So r = a / k in a steady state.
    Those of this step (``whole`` = dt) have fed r when it ends, but for what faded of that. A share ``split`` of what r lost
    is not in the defect: the nodes have had it in their transport.
    """
    dofs, dt, mass0, mass1 = cells.dofs, step.dt, masses.before, masses.after
    gain, nodal_gain, fades, left, lag = known.gain, known.nodal_gain, known.fades, known.left, known.lag
    mass, defect = sums.mass, sums.defect
    n = len(dofs)
    share = 1.0 / M
    for c in range(n):
        for i in range(M):
            mass[dofs[c, i]] += share * mass1[c]
        stay, part = whole - lag[c], share * (1.0 - split[c])
        for k in range(D):
            mean, rise = 0.0, 0.0
            for i in range(M):
                mean += u[dofs[c, i], k]
                rise += nodal_gain[dofs[c, i], k]
            r = q[c, k] - share * mean
            kept[c, k] = left[c] * r + stay * (gain[c, k] - share * rise)
            fades[c, k] = (r - kept[c, k]) / dt
            lost = part * (mass1[c] * kept[c, k] - mass0[c] * r)
            for i in range(M):
                defect[dofs[c, i], k] += lost


class Relaxation(Boundaries):
    """The nodal velocity, and what the cells have beside it."""

    def _relax(self, step: StepState) -> None:
        """Stage 1: u <- u + a P(q - mean u) moves the nodes towards the least-squares fit of the cells.

        a is nearly 1 - exp(-dt k) with a rate k of convection, and of viscosity but little: a rate, not a part per step, so
        that the scheme converges with the step. With upwinding it is the plain mean of the cells, which stays in their
        range.
        """
        d, work, last = self.dimension, self.work, self.state.nodal_velocity
        start = work.zeros("start", self.nodes, d) if last is None else last
        sums, u = work.zeros("sums", self.nodes, 2 + 2 * d), work.empty("relaxed", self.nodes, d)
        step.nodal_mass_before, step.nodal_velocity = work.empty("nodal_mass_before", self.nodes), u
        mass_and_misfit(self.cells, step.numbers, step.masses.before, step.damping, step.velocity, start, step.memory,
                        self.at_wall, sums)
        self.complete(sums)
        node_kernels.relaxed(start, sums, self.upwind, last is None, step.nodal_mass_before, u)
        self.impose(u)

    def _fade(self, step: StepState) -> np.ndarray:
        """Stage 3: what the nodes cannot represent fades at the rate of convection and viscosity; gives back nodal sums of
        the momentum it lost, of this rank."""
        n, d, work = self.num_cells, self.dimension, self.work
        step.kept, step.nodal_mass = work.empty("kept", n, d), work.zeros("nodal_mass", self.nodes)
        defect = work.zeros("defect", self.nodes, d)
        fade(self.cells, step.numbers, step.masses, step.memory, self.no_share, 0.0, step.velocity, step.nodal_velocity,
             step.kept, Faded(step.nodal_mass, defect))
        self.complete(step.nodal_mass)
        return defect
