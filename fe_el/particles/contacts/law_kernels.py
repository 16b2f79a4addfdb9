"""Contact laws as loops over blocks of contacts that the compiler turns into vector instructions.

What the rows of a block hold is in :mod:`fe_el.particles.contacts.blocks`.
"""
import math

from fe_el.compiled.cache import njit
from fe_el.compiled.direct_calls import Direct
from fe_el.compiled.parts import part
from fe_el.particles.contacts import blocks as row
from fe_el.particles.contacts.blocks import BLOCK

FAST = {"contract", "reassoc", "nsz", "arcp"}  # no finite-math assumption: NaN must stay visible
LAG = 0.48  # what a sub-step h adds to the damping, over h^2 k / m*: 0.38 to 0.56 for restitutions from 0.1 to 0.97


@part(fastmath=FAST, error_model="numpy")
def geometry(b, m):
    """Normal, distance, overlap, relative velocity at the contact and along the normal, and arm from what came on entry."""
    for n in range(m):
        r = math.sqrt(b[n + row.SQUARE])
        both = 1.0 / (r * b[n + row.REACH])  # one division for two: they and the roots take most of the time
        inverse, q = both * b[n + row.REACH], both * b[n + row.SQUARE]
        nx, ny, nz = b[n + row.CENTRE_X] * inverse, b[n + row.CENTRE_Y] * inverse, b[n + row.CENTRE_Z] * inverse
        wx, wy, wz = q * b[n + row.SPIN_X], q * b[n + row.SPIN_Y], q * b[n + row.SPIN_Z]
        ux = b[n + row.VELOCITY_X] - (wy * nz - wz * ny)
        uy = b[n + row.VELOCITY_Y] - (wz * nx - wx * nz)
        uz = b[n + row.VELOCITY_Z] - (wx * ny - wy * nx)
        b[n + row.NORMAL_X] = nx
        b[n + row.NORMAL_Y] = ny
        b[n + row.NORMAL_Z] = nz
        b[n + row.DISTANCE] = r
        b[n + row.OVERLAP] = b[n + row.REACH] - r
        b[n + row.VELOCITY_X] = ux
        b[n + row.VELOCITY_Y] = uy
        b[n + row.VELOCITY_Z] = uz
        b[n + row.ARM] = q
        b[n + row.NORMAL_VELOCITY] = ux * nx + uy * ny + uz * nz


@part(fastmath=FAST, error_model="numpy")
def linear(b, m, h):
    """Linear spring-dashpot: F_n = k overlap - eta v_n, eta less by ``LAG`` for the sub-step h.

    Sets normal force and stiffness, and tangential stiffness and damping.
    """
    for n in range(m):
        un = b[n + row.NORMAL_VELOCITY]
        k = b[n + row.STIFFNESS]
        eta = b[n + row.DAMPING] * math.sqrt(k / b[n + row.INVERSE_MASS]) * (1.0 - LAG * h * h * k * b[n + row.INVERSE_MASS])
        b[n + row.NORMAL_FORCE] = k * b[n + row.OVERLAP] - eta * (un + b[n + row.CARRY] * (un - b[n + row.LAST_VELOCITY]))
        b[n + row.LAST_VELOCITY] = un
        b[n + row.TANGENTIAL_STIFFNESS] = b[n + row.STIFFNESS_RATIO] * k
        b[n + row.TANGENTIAL_DAMPING] = b[n + row.DAMPING_RATIO] * eta
        b[n + row.NORMAL_STIFFNESS] = k


@part(fastmath=FAST, error_model="numpy")
def hertz(b, m, h):
    """Hertz-Mindlin: F_n = 4/3 E* sqrt(R* d) d, k_t = 8 G* sqrt(R* d), damping of constant restitution (Tsuji et al.
    1992), less by ``LAG`` for the sub-step h."""
    for n in range(m):
        overlap, inverse_mass, damping = b[n + row.OVERLAP], b[n + row.INVERSE_MASS], b[n + row.DAMPING]
        k = 2.0 * b[n + row.STIFFNESS] * math.sqrt(b[n + row.REDUCED_RADIUS] * overlap)
        kt = 4.0 * b[n + row.STIFFNESS_RATIO] * k
        eta = damping * math.sqrt(k / inverse_mass) * (1.0 - LAG * h * h * k * inverse_mass)
        un = b[n + row.NORMAL_VELOCITY] + b[n + row.CARRY] * (b[n + row.NORMAL_VELOCITY] - b[n + row.LAST_VELOCITY])
        b[n + row.NORMAL_FORCE] = 2.0 / 3.0 * k * overlap - eta * un
        b[n + row.LAST_VELOCITY] = b[n + row.NORMAL_VELOCITY]
        b[n + row.TANGENTIAL_STIFFNESS] = kt
        b[n + row.TANGENTIAL_DAMPING] = b[n + row.DAMPING_RATIO] * damping * math.sqrt(kt / inverse_mass)
        b[n + row.NORMAL_STIFFNESS] = k


@part(fastmath=FAST, error_model="numpy")
def tangential(b, m, h):
    """Tangential spring with Coulomb's cap; the spring keeps what really slipped, so sliding never stores energy."""
    for n in range(m):
        nx, ny, nz = b[n + row.NORMAL_X], b[n + row.NORMAL_Y], b[n + row.NORMAL_Z]
        un, fn = b[n + row.NORMAL_VELOCITY], b[n + row.NORMAL_FORCE]
        q, kt, et = b[n + row.ARM], b[n + row.TANGENTIAL_STIFFNESS], b[n + row.TANGENTIAL_DAMPING]
        tx, ty, tz = b[n + row.VELOCITY_X] - un * nx, b[n + row.VELOCITY_Y] - un * ny, b[n + row.VELOCITY_Z] - un * nz
        sx, sy, sz = b[n + row.SPRING_X], b[n + row.SPRING_Y], b[n + row.SPRING_Z]
        sn = sx * nx + sy * ny + sz * nz
        sx, sy, sz = sx - sn * nx + h * tx, sy - sn * ny + h * ty, sz - sn * nz + h * tz
        fx, fy, fz = -kt * sx - et * tx, -kt * sy - et * ty, -kt * sz - et * tz
        cap = b[n + row.FRICTION] * b[n + row.FRICTION] * fn * fn
        size = fx * fx + fy * fy + fz * fz + 1e-140
        stretch = (sx * sx + sy * sy + sz * sz) * kt * kt + 1e-140
        both = cap / (size * stretch)
        qf = math.sqrt(min(1.0, both * stretch))
        qs = math.sqrt(min(1.0, both * size))
        qs = qs if size > cap else 1.0
        fx, fy, fz = qf * fx, qf * fy, qf * fz
        b[n + row.SPRING_X] = qs * sx
        b[n + row.SPRING_Y] = qs * sy
        b[n + row.SPRING_Z] = qs * sz
        b[n + row.FORCE_X] = fn * nx + fx
        b[n + row.FORCE_Y] = fn * ny + fy
        b[n + row.FORCE_Z] = fn * nz + fz
        b[n + row.TORQUE_X] = q * (fy * nz - fz * ny)
        b[n + row.TORQUE_Y] = q * (fz * nx - fx * nz)
        b[n + row.TORQUE_Z] = q * (fx * ny - fy * nx)


@njit(fastmath=FAST, error_model="numpy")
def cohesion(b, m):
    """Attraction by the contact area, F = -c pi overlap (2 R*) (simplified JKR); c in J/m^3. Adds to the normal force."""
    for n in range(m):
        pull = b[n + row.ATTRACTION] * 2.0 * math.pi * b[n + row.REDUCED_RADIUS] * b[n + row.OVERLAP]
        b[n + row.FORCE_X] -= pull * b[n + row.NORMAL_X]
        b[n + row.FORCE_Y] -= pull * b[n + row.NORMAL_Y]
        b[n + row.FORCE_Z] -= pull * b[n + row.NORMAL_Z]


@part(fastmath=FAST, error_model="numpy")
def adhesion(b, m):
    """Attraction of touching surfaces, F = -2 pi R* W (Derjaguin, Mueller & Toporov 1975); W in J/m^2. Adds to the normal
    force."""
    for n in range(m):
        pull = b[n + row.ATTRACTION] * 2.0 * math.pi * b[n + row.REDUCED_RADIUS]
        b[n + row.FORCE_X] -= pull * b[n + row.NORMAL_X]
        b[n + row.FORCE_Y] -= pull * b[n + row.NORMAL_Y]
        b[n + row.FORCE_Z] -= pull * b[n + row.NORMAL_Z]


@part(fastmath=FAST, error_model="numpy")
def rolling(b, m, h, elastic, torsion):
    """Rolling friction of at most mu_r R* F_n against the relative rotation w1 - w2; with torsion 1 also about the normal,
    else 0.

    Constant torque (Zhou et al. 1999), smooth below the rotation that it would stop within one step; or elastic-plastic
    (Ai et al. 2011, model C) with the stiffness 2.25 k_n (mu_r R*)^2 and 0.3 of critical damping.
    """
    for n in range(m):
        nx, ny, nz = b[n + row.NORMAL_X], b[n + row.NORMAL_Y], b[n + row.NORMAL_Z]
        wx, wy, wz = b[n + row.TURN_X], b[n + row.TURN_Y], b[n + row.TURN_Z]
        wn = (1.0 - torsion) * (wx * nx + wy * ny + wz * nz)
        wx, wy, wz = wx - wn * nx, wy - wn * ny, wz - wn * nz
        radius = b[n + row.REDUCED_RADIUS]
        reach = b[n + row.ROLLING_FRICTION] * radius
        cap = reach * abs(b[n + row.FORCE_X] * nx + b[n + row.FORCE_Y] * ny + b[n + row.FORCE_Z] * nz)
        inertia = 0.4 * radius * radius / b[n + row.INVERSE_MASS]
        stiffness = 2.25 * b[n + row.NORMAL_STIFFNESS] * reach ** 2 if elastic else inertia / (h * h + 1e-300)
        damping = 0.6 * math.sqrt(inertia * stiffness) if elastic else 0.0
        keep = 1.0 if elastic else 0.0
        sx, sy = keep * b[n + row.ROLLING_X] + h * wx, keep * b[n + row.ROLLING_Y] + h * wy
        sz = keep * b[n + row.ROLLING_Z] + h * wz
        sn = (1.0 - torsion) * (sx * nx + sy * ny + sz * nz)
        sx, sy, sz = sx - sn * nx, sy - sn * ny, sz - sn * nz
        q = min(1.0, cap / (stiffness * math.sqrt(sx * sx + sy * sy + sz * sz) + 1e-300))
        sx, sy, sz = q * sx, q * sy, q * sz
        tx, ty, tz = stiffness * sx + damping * wx, stiffness * sy + damping * wy, stiffness * sz + damping * wz
        q = min(1.0, cap / (math.sqrt(tx * tx + ty * ty + tz * tz) + 1e-300))
        b[n + row.ROLLING_X] = sx
        b[n + row.ROLLING_Y] = sy
        b[n + row.ROLLING_Z] = sz
        b[n + row.ROLLING_TORQUE_X] = -q * tx
        b[n + row.ROLLING_TORQUE_Y] = -q * ty
        b[n + row.ROLLING_TORQUE_Z] = -q * tz


@part
def apply_law(b, m, h, numbers):
    """The built-in law of a block, with cohesion and rolling friction where they are present."""
    geometry(b, m)
    if numbers.kind == 0:
        linear(b, m, h)
    else:
        hertz(b, m, h)
    tangential(b, m, h)
    if numbers.cohesive and numbers.kind == 0:
        adhesion(b, m)
    elif numbers.cohesive:
        cohesion(b, m)
    if numbers.rolls > 0:
        rolling(b, m, h, numbers.rolls % 2 == 0, 1.0 if numbers.rolls > 2 else 0.0)


@Direct
@njit
def constant_rows(b, numbers):
    """Fill the rows of the material, for good where there is one material only: see :func:`uniform`."""
    for n in range(BLOCK):
        material_row(b, n, numbers, 0, 0)


@part(forceinline=True)
def stiffness_of_parcel(b, n, numbers, stiffness, inverse_mass, reduced_radius):
    """Stiffness of a contact of parcels, with which it lasts as long as one of their particles with the law's.

    A linear contact lasts as sqrt(m*/k), one by Hertz as (m*^2 / (E*^2 R*))^(1/5) (Patankar & Joseph, Int. J. Multiphase
    Flow 27 (2001) 1659); the rows hold the parcels' inverse reduced mass and reduced radius, the arguments are those of the
    particles in them.
    """
    ratio = inverse_mass / b[n + row.INVERSE_MASS]
    if numbers.kind == 1:
        ratio *= math.sqrt(reduced_radius / b[n + row.REDUCED_RADIUS])
    b[n + row.STIFFNESS] = ratio * stiffness


@part(forceinline=True)
def uniform(numbers):
    """Whether there is one material only."""
    return numbers.table.shape[0] == 1 and numbers.table.shape[1] == 1


@part(forceinline=True)
def material_row(b, n, numbers, first, second):
    """Stiffness to damping ratio, rolling friction and attraction of one contact from the material table."""
    for k in range(5):
        b[n + row.STIFFNESS + k * BLOCK] = numbers.table[first, second, k]
    b[n + row.ROLLING_FRICTION] = numbers.table[first, second, 5]
    b[n + row.ATTRACTION] = numbers.table[first, second, 6]
