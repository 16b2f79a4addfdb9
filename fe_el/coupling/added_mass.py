r"""Added mass: fluid that must be accelerated along with a particle; and the pressure force taken implicitly.

On a particle of density rho_p and volume V act drag, pressure, added mass C rho V d(u - v)/dt (along its path, as in Maxey &
Riley, Phys. Fluids 26 (1983) 883), and what is known beforehand, rho_e a_0 per volume: gravity, contacts, lift. With rho_e =
rho_p + C rho, k = beta / rho_e, u and grad p of the end of the step, and u_0 the fluid velocity that it had around it last,

    dv/dt = k (u - v) + a,    a = a_0 - grad p / rho_e + (C rho / rho_e) (u - u_0) / dt

is solved exactly over a step, as without added mass: with m = (1 - exp(-k dt)) / (k dt) the velocity changes by

    Dv = m k dt (u - v_n) + m dt a.

What the fluid gives, beside pressure, is f = rho_p Dv/dt - rho_e a_0 + grad p per volume (Newton's second law of the
particle), and with r = rho_p / rho_e this is linear in what the fluid solves for:

    f = K u + P grad p + f_0,    K = r m (beta + C rho / dt),    P = 1 - r m,
    f_0 = - r m beta v_n - (rho_e - rho_p m) a_0 - r m C rho u_0 / dt.

So the fluid has the drag coefficient sum w V K / V_c, the source - sum w V f_0 / V_c, and beside phi the share sum w V P /
V_c of the pressure gradient: a light particle hands the pressure on it to the fluid that moves with it. Particles receive
the same sums transposed, so momentum is exact to round-off.

Contacts move particle and added mass. A light particle hands on to the fluid what they do to it, P times their force; that
is known after the step only, and so is whether they hold the particle. Its resistance to the fluid, which K of a free one
leaves out, then comes back through the contact force, with a gain g = s (C + beta dt / rho) / (1 - s) and a lag: so what
waits is given to the fluid in parts of 1 / (1 + g) per step, with which that loop fades at once, whatever the step.

With C = 0 the same takes the pressure force of heavier particles implicitly. Their contact force of the last step is
expected again, in f_0, as without it (:class:`fe_el.coupling.schemes.Conservative`), so nothing waits.

The void fraction of a step is that of the particles' last way, so what they displace answers the fluid a step late: a flux
s v of solids makes one of the fluid that is s / (1 - s) as large, whose drag and pressure push them back too far. With the
rate of the last way alone that loop grows from a solid fraction of a half in steps of many relaxation times, at 0.74 from
0.1 of them on (linear analysis of uniform media). So where particles are crowded the fluid is also told by how much their
flux answers its own change within the step, a (u - u_0) - b grad (p - p_0) with

    a = sum w V m k dt (1 + C rho / (beta dt)) / V_c,    b = sum w V m dt / rho_e / V_c,

less for particles that contacts hold. It is zero in a steady state, and added up over steps it does not drift.

Without added mass, displaced volume that answers the pressure of the last step is unstable when s rho > 2 (1 - s) rho_p, s
the solid fraction: the pressure of an accelerated liquid drives light particles, whose acceleration displaces it. With it
s (C + 1 - s) < 2 (1 - s) C is stable for massless particles: for C = 1/2 up to s = 0.45, with Zuber's up to 0.64.
"""
import math
from typing import NamedTuple

import numpy as np

from fe_el.checks import not_negative_number
from fe_el.compiled.cache import njit
from fe_el.compiled.direct_calls import Direct
from fe_el.nodes.work_arrays import WorkArrays


class AddedMass:
    """The inertia C rho V of fluid that moves along with each particle, for :class:`Coupling` in its list of forces.

    Args:
        coefficient (float): C; absent: 1/2 (1 + 2 s) / (1 - s) at the local solid fraction s (Zuber, Chem. Eng. Sci. 19
            (1964) 897), which is 1/2 for one sphere.

    Raises:
        ValueError: for a negative coefficient.
    """

    def __init__(self, coefficient: float | None = None) -> None:
        self.coefficient = None if coefficient is None else not_negative_number("coefficient of added mass", coefficient)

    def density(self, solid: np.ndarray, fluid_density: float) -> np.ndarray:
        """C rho (particles,) [kg/m^3] at solid fractions (particles,)."""
        if self.coefficient is not None:
            return np.full(len(solid), self.coefficient * fluid_density)
        return 0.5 * fluid_density * (1 + 2 * solid) / (1 - solid)


@njit(error_model="numpy")
def relaxation(a):
    """m = (1 - exp(-a)) / a, 1 - m, and lag = 1 / (1 - exp(-a)) - 1 / a."""
    if a < 1e-3:
        return 1 - a / 2 + a * a / 6, a / 2 - a * a / 6, 0.5 + a / 12
    part = -math.expm1(-a)
    return part / a, 1 - part / a, 1 / part - 1 / a


@njit(error_model="numpy")
def _freely(inverse, velocity, contact):
    """How freely a particle answers the fluid, from 0 to 1: its speed over that and what its contact force changes in a
    step, ``inverse`` times that force; contacts that hold it at rest answer in its place."""
    speed, push = 0.0, 0.0
    for k in range(len(velocity)):
        speed += velocity[k] * velocity[k]
        push += contact[k] * contact[k]
    speed, push = math.sqrt(speed), inverse * math.sqrt(push)
    return speed / (speed + push) if push > 0.0 else 1.0


class Moved(NamedTuple):
    """Particles with their added mass, before the fluid is known; n of them in d dimensions."""

    volume: np.ndarray  #: (n, 1) [m^3]
    density: np.ndarray  #: (n, 1) infinite if held [kg/m^3]
    added: np.ndarray  #: (n,) C rho [kg/m^3]
    beta: np.ndarray  #: (n, 1) [kg/(m^3 s)]
    velocity: np.ndarray  #: (n, d) [m/s]
    known: np.ndarray  #: (n, d) rho_e a_0, force per volume [N/m^3]
    contact: np.ndarray  #: (n, 3) of this, the contact force of the last step, which is expected again [N]
    expected: bool  #: whether f_0 has it; or what contacts do to added mass goes to the fluid when it is known
    carried: np.ndarray  #: (n, d) u_0 [m/s]
    late: np.ndarray  #: (n,) share of the step after which a particle comes in; no rows: none does


@njit(error_model="numpy")
def _rows(dt, pressed, moved, rate, rows, answer):
    """Fill V K, V P and V f_0 (n, 2 + d), means over the whole step, the rates of relaxation (n,) [1/s], and the volume
    times what the velocity at the end answers to the fluid's and to minus the pressure gradient (n, 2); without pressure
    force if not ``pressed``."""
    volume, density, added, beta = moved.volume, moved.density, moved.added, moved.beta
    velocity, known, contact, carried = moved.velocity, moved.known, moved.contact, moved.carried
    for i in range(len(velocity)):
        own, b, here = density[i, 0], beta[i, 0], 1 - moved.late[i] if len(moved.late) else 1.0
        v, inertia, later = volume[i, 0] * here, added[i] / (dt * here), 0.0 if moved.expected else here
        if own == np.inf:
            rate[i], rows[i, 0], rows[i, 1] = 0.0, v * (b + inertia), 0.0
            answer[i, 0], answer[i, 1] = 0.0, 0.0
            for k in range(velocity.shape[1]):
                rows[i, 2 + k] = -v * (b * velocity[i, k] + inertia * carried[i, k])
            continue
        whole = own + added[i]
        m, rest, _ = relaxation(dt * here * b / whole)
        part = own / whole * m
        handed = rest + m * added[i] / whole
        rate[i], rows[i, 0] = b / whole, v * part * (b + inertia)
        rows[i, 1] = volume[i, 0] - v * (1 - handed) if pressed else 0.0  # all of it while it is not there
        moves = v * m * dt * here / whole * _freely(dt * here / (whole * volume[i, 0]), velocity[i], contact[i])
        answer[i, 0], answer[i, 1] = moves * (b + inertia), moves if pressed else 0.0
        for k in range(velocity.shape[1]):
            rows[i, 2 + k] = -v * part * (b * velocity[i, k] + inertia * carried[i, k]) \
                - handed * (v * known[i, k] - later * contact[i, k])


@njit(error_model="numpy")
def _forces(dt, moved, rows, gravity, fluid, slope, given, force, foreseen):
    """What fluid and pressure give (n, d), the force that moves particle and added mass (n, 3), and what is foreseen.

    Args:
        moved, rows: as in :func:`_rows`.
        fluid, slope: (n, d) velocity and pressure gradient of the end of the step.
        foreseen: (n, d) velocities before the step; then the momentum of the added mass after it, less what of the contact
            force goes to the fluid [kg m/s].
    """
    volume, density, added, beta = moved.volume, moved.density, moved.added, moved.beta
    velocity, known, contact, carried = moved.velocity, moved.known, moved.contact, moved.carried
    d = velocity.shape[1]
    for i in range(len(velocity)):
        own, b, here = density[i, 0], beta[i, 0], 1 - moved.late[i] if len(moved.late) else 1.0
        v, whole, held, span = volume[i, 0] * here, own + added[i], own == np.inf, dt * here
        m, rest, lag = relaxation(0.0 if held else span * b / whole)
        later = 0.0 if moved.expected else span * (rest + m * added[i] / whole)
        for k in range(d):
            pressure = slope[i, k] if slope.shape[1] else 0.0
            given[i, k] = rows[i, 0] * fluid[i, k] + (rows[i, 1] - volume[i, 0]) * pressure + rows[i, 2 + k]
            if held:
                force[i, k] = given[i, k]
                foreseen[i, k] *= volume[i, 0] * added[i]
                continue
            inside = known[i, k] - pressure + added[i] * (fluid[i, k] - carried[i, k]) / span  # per volume, all but drag
            target = velocity[i, k] + lag * span * inside / whole
            total = b * m * (fluid[i, k] - target) + inside
            force[i, k] = v * (total - whole * gravity[k]) - here * contact[i, k]
            foreseen[i, k] = volume[i, 0] * added[i] * (foreseen[i, k] + span * total / whole) \
                - later * contact[i, k]
        for k in range(d, 3):
            force[i, k] = 0.0


_fill_rows, _fill_forces = Direct(_rows), Direct(_forces)


class AddedMassExchange:
    """The exchange of a step with added mass; what it must know of the last one travels with the particles.

    In ``particles.properties``: ``added_mass`` [kg]; the velocity of the fluid around a particle at the end of the last
    step; and of the impulse of contacts that the fluid has still to receive, what there was, and what was foreseen of the
    step's. A particle without added mass is new.

    Args:
        law (AddedMass): its coefficient.
        pressed (bool): whether there is a pressure force.
        expected (bool): whether the contact force of the last step is expected again, as without added mass: where there is
            none, and particles are so heavy that this is stable.
    """

    def __init__(self, law, pressed, expected=False):
        self.law, self.pressed, self.expected, self._work = law, pressed, expected, WorkArrays()

    def waiting(self, particles, dimension):
        """Impulse (particles, d) of contacts on added mass that the fluid has still to receive [N s]."""
        p, d = particles, dimension
        if "added_mass" not in p.properties:
            p.properties.update(added_mass=np.zeros(len(p)), **{name: np.zeros((len(p), d)) for name in (
                "_carried_velocity", "_waiting_impulse", "_foreseen_momentum")})
        momentum = p.properties["added_mass"][:, None] * p.velocity[:, :d]
        return p.properties["_waiting_impulse"] + momentum - p.properties["_foreseen_momentum"]

    def fields(self, x, particles, solid, fluid_density):
        """V K, V P and V f_0 (particles, 2 + d) of an :class:`Exchange` whose accelerations leave the pressure out, and the
        force (particles, d) [N] that the fluid receives of what waits."""
        p, (n, d), work = particles, x.velocity.shape, self._work
        carried = x.fluid_velocity if x.offset is None else x.fluid_velocity - x.offset
        if not self.expected:
            self.wait = self.waiting(p, d)
            carried = np.where(p.properties["added_mass"][:, None] == 0.0, carried, p.properties["_carried_velocity"])
        added, velocity = self.law.density(solid, fluid_density), x.velocity if x.offset is None else x.velocity - x.offset
        self.rows, self.relaxation_rate = work.empty("rows", n, 2 + d), work.empty("relaxation_rate", n)
        self.answer = work.empty("answer", n, 2)
        self.dt, self.moved = x.dt, Moved(x.volume, x.density, added, x.beta, velocity, x.acceleration * p.density[:, None],
                                          p.mean_contact_force, self.expected, carried, x.late)
        _fill_rows(x.dt, self.pressed, self.moved, self.relaxation_rate, self.rows, self.answer)
        if self.expected:
            return self.rows, np.zeros((n, d))
        gain = solid / (1 - solid) * (added + x.beta[:, 0] * x.dt) / fluid_density
        part = self.wait / (1 + gain)[:, None]
        self.wait = self.wait - part
        return self.rows, part / x.dt

    def force(self, particles, fluid_velocity, slope):
        """Sets the particles' ``force``; returns what drag, added mass and pressure give each (particles, d) [N]."""
        p, d = particles, self.moved.velocity.shape[1]
        given, foreseen = self._work.empty("given", len(p), d), p.velocity[:, :d].copy()
        _fill_forces(self.dt, self.moved, self.rows, p.gravity, fluid_velocity, slope, given, p.force, foreseen)
        if not self.expected:
            p.properties.update(added_mass=self.moved.added * self.moved.volume[:, 0],
                                _carried_velocity=fluid_velocity.copy(), _waiting_impulse=self.wait,
                                _foreseen_momentum=foreseen)
        return given
