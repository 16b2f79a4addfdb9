"""Free flight, and the impulse of a step for sub-steps, along the relaxation of velocities.

Velocities that relax, dv/dt = k (target - v), take their positions along: over h with a = k h the velocity changes by
dv = (1 - exp(-a)) (target - v), and the position by h (v + lag dv), lag = 1 / (1 - exp(-a)) - 1 / a: from 1/2 for a constant
force to 1 for what follows the fluid.
"""
import math

import numpy as np

from fe_el.compiled.cache import njit
from fe_el.particles.contacts.law_kernels import FAST

BLOCK = 256  # particles whose relaxation is computed at once
S0, S1, S2, S3, S4, S5, S6, S7, S8, S9, S10, S11 = ((-1) ** k / math.factorial(k + 1) for k in range(12))


@njit(fastmath=FAST)
def relaxed(a):
    """e(a) = 1 - exp(-a), for a of zero or more, to round-off and without a branch: from the series at a / 128, and
    e(2 x) = e(x) (2 - e(x))."""
    x = min(a, 40.0) * 0.0078125
    x2 = x * x
    x4 = x2 * x2
    low = (S0 + S1 * x) + x2 * (S2 + S3 * x) + x4 * ((S4 + S5 * x) + x2 * (S6 + S7 * x))
    e = x * (low + x4 * x4 * ((S8 + S9 * x) + x2 * (S10 + S11 * x)))
    for _ in range(7):
        e *= 2 - e
    return e


@njit
def lag(a):
    """1 / (1 - exp(-a)) - 1 / a, for a of zero or more."""
    return 0.5 + a / 12 if a < 1e-3 else 1 / relaxed(a) - 1 / a


@njit(error_model="numpy")
def relaxations(a, number, mean, lags):
    """(1 - exp(-a)) / a and :func:`lag` of some numbers, as vectors."""
    for n in range(number):
        part, inverse, small = relaxed(a[n]), 1 / a[n], a[n] < 1e-3
        mean[n] = 1 - a[n] / 2 + a[n] * a[n] / 6 if small else part * inverse
        lags[n] = 0.5 + a[n] / 12 if small else 1 / part - inverse


@njit
def free_flight(position, velocity, force, mass, gravity, rate, held, late, dt):
    """A step without contacts: v += dt (g + F/m), along the relaxation that gives this change, in the part of the step that
    ``late`` (particles or 0,) leaves; forces are means over the whole step."""
    for i in range(len(position)):
        if held[i]:
            continue
        span = dt * (1 - late[i]) if len(late) else dt
        behind = lag(rate[i] * span)
        for k in range(3):
            change = span * gravity[k] + dt * force[i, k] / mass[i]
            position[i, k] += span * (velocity[i, k] + behind * change)
            velocity[i, k] += change


@njit
def masses(density, diameter):
    """Masses (particles,) of spheres."""
    out = np.empty(len(density))
    for i in range(len(density)):
        out[i] = density[i] * (math.pi / 6 * (diameter[i] * diameter[i] * diameter[i]))
    return out


@njit
def primary_diameters(diameter, number):
    """Diameters (particles,) of the particles in parcels: diameter over the cube root of ``number``."""
    out, last, ratio = np.empty_like(diameter), 1.0, 1.0
    for i in range(len(diameter)):
        if number[i] != last:  # most have the number of the one before them, and roots take time
            last = number[i]
            ratio = last ** (1 / 3)
            ratio -= (ratio * ratio * ratio - last) / (3 * ratio * ratio)  # exact where the root is a whole number
        out[i] = diameter[i] / ratio
    return out


@njit
def places_ahead(position, velocity, force, contact_force, inertia, gravity, rate, held, half, place):
    """Fill in the positions after the first half of a step, from velocity and acceleration of the last one; returns the
    longest way.

    The velocity is that of its end for a constant force, of its middle for what follows the fluid. Of the way that the
    acceleration adds half is taken: the rest makes up for most of the error of a fluid velocity that is held over the step.
    """
    longest, a, mean, lags = 0.0, np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    for first in range(0, len(velocity), BLOCK):
        number = min(BLOCK, len(velocity) - first)
        for n in range(number):
            a[n] = rate[first + n] * 2 * half
        relaxations(a, number, mean, lags)
        for n in range(number):
            i, late, square = first + n, (lags[n] - 0.25) * half, 0.0
            inverse_mass = 1 / inertia[i]
            for k in range(3):
                acceleration = gravity[k] + (force[i, k] + contact_force[i, k]) * inverse_mass
                way = 0.0 if held[i] else half * (velocity[i, k] + late * acceleration)
                place[i, k] = position[i, k] + way
                square += way * way
            longest = max(longest, square)
    return math.sqrt(longest)


@njit
def forces_in_step(position, force, contact_force, mass, gravity, rate, held, dt, steps):
    """The impulse of gravity and ``force`` over a step, given to sub-steps such that velocities follow their relaxation.

    With A the acceleration by gravity and ``force``, and C the contact force of the last step, particles are expected to
    change their velocity by dt (A + C/m): this part of the force fades like exp(-k t) over the step, -C is constant. So
    without contacts velocities and positions at the end are those of :func:`free_flight`, a particle that contacts hold at
    rest feels a constant force, and the impulse over the step is dt (m g + F) whatever happens in it. Positions are shifted
    by what the sub-steps' splitting leaves out.

    Returns:
        (particles, 3) the constant part [N], and (particles, 4) the fading one, of now [N], and its factor from one sub-step
        to the next.
    """
    constant, fading, h = np.zeros_like(position), np.ones((len(position), 4)), dt / steps
    for i in range(len(position)):
        a, s = rate[i] * dt, rate[i] * h
        kept = math.exp(-s)
        first = 2 / (1 + kept) * (math.expm1(-s) / math.expm1(-a) * steps if a > 1e-12 else 1.0)
        left_out = dt * h * (lag(s) - 1 / (1 + kept))
        fading[i, 3] = kept
        for k in range(3):
            change = 0.0 if held[i] else gravity[k] + (force[i, k] + contact_force[i, k]) / mass[i]
            constant[i, k] = 0.0 if held[i] else -contact_force[i, k]
            fading[i, k] = mass[i] * first * change
            position[i, k] += left_out * change
    return constant, fading
