"""Contact laws as loops over blocks of contacts that the compiler turns into vector instructions.

A block holds ``BLOCK`` contacts as rows of one flat array: entry ``row * BLOCK + n`` belongs to contact n. Pairs, mesh
facets and primitive walls fill the same rows, so there is one kernel per law. The rows on entry:

    0-2   vector from the second to the first centre (a wall: from its nearest point)       3  its square
    4     sum of the radii (a wall: the radius)              5     difference of the radii (pairs only)
    6-8   relative velocity of the centres                   9-11  r1 w1 + r2 w2
    12    inverse of the reduced mass                        13-15 tangential spring
    16    normal velocity half a step before that of row 10  17    stiffness k_n, or Young's modulus E*
    18    damping number                                     19    friction
    20    k_t / k_n, or G* / E*                              21    tangential over normal damping
    22    reduced radius R*                                  23-25 w1 - w2
    26-28 rolling spring                                     29    rolling friction          30 cohesion energy density, or
                                                                   surface energy (linear law)
    34    1/2, or 0 at first touch                          35    factor of the force (walls only)

Rows 31-33 pass stiffness and damping between the loops. Velocities are those of the half step before the forces; damping
sees the normal velocity carried on to the full step, the tangential spring what really was slipped. On return 6-8 hold the
force on the first body, 9-11 that force times the arm fraction, crossed with the normal (torque per radius), 13-15 and 26-28
the new springs, 23-25 the rolling torque on the first body, 16 the normal velocity for the next step.
"""
import math

import numpy as np

from fe_el.compiled.cache import njit

BLOCK = 264  # no power of two: the rows of one contact would share few sets of the cache
ROWS = 36
FAST = {"contract", "reassoc", "nsz", "arcp"}  # no finite-math assumption: NaN must stay visible
B = BLOCK
LAG = 0.48  # what a sub-step h adds to the damping, over h^2 k / m*: 0.38 to 0.56 for restitutions from 0.1 to 0.97


def aligned(rows, width):
    """Zeros (rows, width) that start at a line of the cache."""
    memory = np.empty(rows * width + 7)
    memory[:] = 0.0
    start = -(memory.ctypes.data // 8) % 8
    return memory[start:start + rows * width].reshape(rows, width)


def new_block():
    """An empty block, and the pairs (or entries of a list, particles and walls) of its contacts.

    It is made once: memory that is asked for and given back at each sub-step can cost as much as a hundred contacts.
    """
    block = aligned(ROWS, BLOCK)
    block[:] = 1.0
    return block.ravel(), np.empty(BLOCK, np.uint64), np.empty(BLOCK, np.uint64), np.empty(BLOCK, np.uint64)


@njit(fastmath=FAST, error_model="numpy")
def geometry(b, m):
    """Rows 0-2 become the normal, 3 the distance, 4 the overlap, 6-8 the velocity at the contact, 9 the arm fraction, 10
    v_n."""
    for n in range(m):
        r = math.sqrt(b[n + 3 * B])
        both = 1.0 / (r * b[n + 4 * B])  # one division for two: they and the roots take most of the time
        inverse, q = both * b[n + 4 * B], both * b[n + 3 * B]
        nx, ny, nz = b[n] * inverse, b[n + B] * inverse, b[n + 2 * B] * inverse
        wx, wy, wz = q * b[n + 9 * B], q * b[n + 10 * B], q * b[n + 11 * B]
        ux = b[n + 6 * B] - (wy * nz - wz * ny)
        uy = b[n + 7 * B] - (wz * nx - wx * nz)
        uz = b[n + 8 * B] - (wx * ny - wy * nx)
        b[n] = nx
        b[n + B] = ny
        b[n + 2 * B] = nz
        b[n + 3 * B] = r
        b[n + 4 * B] = b[n + 4 * B] - r
        b[n + 6 * B] = ux
        b[n + 7 * B] = uy
        b[n + 8 * B] = uz
        b[n + 9 * B] = q
        b[n + 10 * B] = ux * nx + uy * ny + uz * nz


@njit(fastmath=FAST, error_model="numpy")
def linear(b, m, h):
    """Linear spring-dashpot: F_n = k overlap - eta v_n, eta less by ``LAG`` for the sub-step h.

    Sets rows 11 (F_n), 31 (tangential stiffness), 32 (tangential damping) and 33 (normal stiffness).
    """
    for n in range(m):
        k = b[n + 17 * B]
        eta = b[n + 18 * B] * math.sqrt(k / b[n + 12 * B]) * (1.0 - LAG * h * h * k * b[n + 12 * B])
        b[n + 11 * B] = k * b[n + 4 * B] - eta * (b[n + 10 * B] + b[n + 34 * B] * (b[n + 10 * B] - b[n + 16 * B]))
        b[n + 16 * B] = b[n + 10 * B]
        b[n + 31 * B] = b[n + 20 * B] * k
        b[n + 32 * B] = b[n + 21 * B] * eta
        b[n + 33 * B] = k


@njit(fastmath=FAST, error_model="numpy")
def hertz(b, m, h):
    """Hertz-Mindlin: F_n = 4/3 E* sqrt(R* d) d, k_t = 8 G* sqrt(R* d), damping of constant restitution (Tsuji et al.
    1992), less by ``LAG`` for the sub-step h."""
    for n in range(m):
        overlap, inverse_mass, damping = b[n + 4 * B], b[n + 12 * B], b[n + 18 * B]
        k = 2.0 * b[n + 17 * B] * math.sqrt(b[n + 22 * B] * overlap)
        kt = 4.0 * b[n + 20 * B] * k
        eta = damping * math.sqrt(k / inverse_mass) * (1.0 - LAG * h * h * k * inverse_mass)
        un = b[n + 10 * B] + b[n + 34 * B] * (b[n + 10 * B] - b[n + 16 * B])
        b[n + 11 * B] = 2.0 / 3.0 * k * overlap - eta * un
        b[n + 16 * B] = b[n + 10 * B]
        b[n + 31 * B] = kt
        b[n + 32 * B] = b[n + 21 * B] * damping * math.sqrt(kt / inverse_mass)
        b[n + 33 * B] = k


@njit(fastmath=FAST, error_model="numpy")
def tangential(b, m, h):
    """Tangential spring with Coulomb's cap; the spring keeps what really slipped, so sliding never stores energy."""
    for n in range(m):
        nx, ny, nz, un, fn = b[n], b[n + B], b[n + 2 * B], b[n + 10 * B], b[n + 11 * B]
        q, kt, et = b[n + 9 * B], b[n + 31 * B], b[n + 32 * B]
        tx, ty, tz = b[n + 6 * B] - un * nx, b[n + 7 * B] - un * ny, b[n + 8 * B] - un * nz
        sx, sy, sz = b[n + 13 * B], b[n + 14 * B], b[n + 15 * B]
        sn = sx * nx + sy * ny + sz * nz
        sx, sy, sz = sx - sn * nx + h * tx, sy - sn * ny + h * ty, sz - sn * nz + h * tz
        fx, fy, fz = -kt * sx - et * tx, -kt * sy - et * ty, -kt * sz - et * tz
        cap = b[n + 19 * B] * b[n + 19 * B] * fn * fn
        size = fx * fx + fy * fy + fz * fz + 1e-140
        stretch = (sx * sx + sy * sy + sz * sz) * kt * kt + 1e-140
        both = cap / (size * stretch)
        qf = math.sqrt(min(1.0, both * stretch))
        qs = math.sqrt(min(1.0, both * size))
        qs = qs if size > cap else 1.0
        fx, fy, fz = qf * fx, qf * fy, qf * fz
        b[n + 13 * B] = qs * sx
        b[n + 14 * B] = qs * sy
        b[n + 15 * B] = qs * sz
        b[n + 6 * B] = fn * nx + fx
        b[n + 7 * B] = fn * ny + fy
        b[n + 8 * B] = fn * nz + fz
        b[n + 9 * B] = q * (fy * nz - fz * ny)
        b[n + 10 * B] = q * (fz * nx - fx * nz)
        b[n + 11 * B] = q * (fx * ny - fy * nx)


@njit(fastmath=FAST, error_model="numpy")
def cohesion(b, m):
    """Attraction by the contact area, F = -c pi overlap (2 R*) (simplified JKR); c in J/m^3. Adds to the normal force."""
    for n in range(m):
        pull = b[n + 30 * B] * 2.0 * math.pi * b[n + 22 * B] * b[n + 4 * B]
        b[n + 6 * B] -= pull * b[n]
        b[n + 7 * B] -= pull * b[n + B]
        b[n + 8 * B] -= pull * b[n + 2 * B]


@njit(fastmath=FAST, error_model="numpy")
def adhesion(b, m):
    """Attraction of touching surfaces, F = -2 pi R* W (Derjaguin, Mueller & Toporov 1975); W in J/m^2. Adds to the normal
    force."""
    for n in range(m):
        pull = b[n + 30 * B] * 2.0 * math.pi * b[n + 22 * B]
        b[n + 6 * B] -= pull * b[n]
        b[n + 7 * B] -= pull * b[n + B]
        b[n + 8 * B] -= pull * b[n + 2 * B]


@njit(fastmath=FAST, error_model="numpy")
def rolling(b, m, h, elastic, torsion):
    """Rolling friction of at most mu_r R* F_n against the relative rotation w1 - w2; with torsion 1 also about the normal,
    else 0.

    Constant torque (Zhou et al. 1999), smooth below the rotation that it would stop within one step; or elastic-plastic
    (Ai et al. 2011, model C) with the stiffness 2.25 k_n (mu_r R*)^2 and 0.3 of critical damping.
    """
    for n in range(m):
        nx, ny, nz = b[n], b[n + B], b[n + 2 * B]
        wx, wy, wz = b[n + 23 * B], b[n + 24 * B], b[n + 25 * B]
        wn = (1.0 - torsion) * (wx * nx + wy * ny + wz * nz)
        wx, wy, wz = wx - wn * nx, wy - wn * ny, wz - wn * nz
        radius = b[n + 22 * B]
        cap = b[n + 29 * B] * radius * abs(b[n + 6 * B] * nx + b[n + 7 * B] * ny + b[n + 8 * B] * nz)
        inertia = 0.4 * radius * radius / b[n + 12 * B]
        stiffness = 2.25 * b[n + 33 * B] * (b[n + 29 * B] * radius) ** 2 if elastic else inertia / (h * h + 1e-300)
        damping = 0.6 * math.sqrt(inertia * stiffness) if elastic else 0.0
        keep = 1.0 if elastic else 0.0
        sx, sy, sz = keep * b[n + 26 * B] + h * wx, keep * b[n + 27 * B] + h * wy, keep * b[n + 28 * B] + h * wz
        sn = (1.0 - torsion) * (sx * nx + sy * ny + sz * nz)
        sx, sy, sz = sx - sn * nx, sy - sn * ny, sz - sn * nz
        q = min(1.0, cap / (stiffness * math.sqrt(sx * sx + sy * sy + sz * sz) + 1e-300))
        sx, sy, sz = q * sx, q * sy, q * sz
        tx, ty, tz = stiffness * sx + damping * wx, stiffness * sy + damping * wy, stiffness * sz + damping * wz
        q = min(1.0, cap / (math.sqrt(tx * tx + ty * ty + tz * tz) + 1e-300))
        b[n + 26 * B] = sx
        b[n + 27 * B] = sy
        b[n + 28 * B] = sz
        b[n + 23 * B] = -q * tx
        b[n + 24 * B] = -q * ty
        b[n + 25 * B] = -q * tz


@njit
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


@njit
def constant_rows(b, numbers):
    """Fill the rows of the material, for good where there is one material only: see :func:`uniform`."""
    for n in range(B):
        material_row(b, n, numbers, 0, 0)


@njit(inline="always")
def uniform(numbers):
    """Whether there is one material only."""
    return numbers.table.shape[0] == 1 and numbers.table.shape[1] == 1


@njit(inline="always")
def material_row(b, n, numbers, first, second):
    """Rows 17-21, 29 and 30 of one contact from the material table."""
    for k in range(5):
        b[n + (17 + k) * B] = numbers.table[first, second, k]
    b[n + 29 * B] = numbers.table[first, second, 5]
    b[n + 30 * B] = numbers.table[first, second, 6]
