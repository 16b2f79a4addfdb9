"""Compiled loops over the particles of an exchange; n particles, d dimensions, SI units.

What not every scene has, such as other forces, comes as an array without rows. Loops over dimensions have a fixed length:
the compiler would make short vectors of others, which takes longer than the numbers.
"""
import math

import numpy as np

from fe_el.compiled.cache import njit
from fe_el.particles.motion import BLOCK, relaxations

# Particles are added up by blocks before the total: round-off grows with the root of their number only.


@njit(error_model="numpy")
def volumes(diameter, volume):
    """Fill the volumes (n, 1); returns their sum."""
    total = 0.0
    for first in range(0, len(diameter), BLOCK):
        part = 0.0
        for i in range(first, min(first + BLOCK, len(diameter))):
            volume[i, 0] = math.pi / 6 * (diameter[i] * diameter[i] * diameter[i])
            part += volume[i, 0]
        total += part
    return total


@njit(error_model="numpy")
def largest_courant(velocity, size, dt):
    """Largest Courant number of cells with the velocities (cells, d) and sizes (cells,)."""
    largest = 0.0
    d = velocity.shape[1]
    for c in range(len(size)):
        square = 0.0
        for k in range(3):
            square += velocity[c, k] * velocity[c, k] if k < d else 0.0
        largest = max(largest, square / (size[c] * size[c]))
    return dt * math.sqrt(largest)


@njit(error_model="numpy")
def fluid_at_particles(mean, velocity, solid, slip):
    """Solid fraction and slip speed (n,) from the means (n, 1 + d) of solid fraction and fluid velocity."""
    d = velocity.shape[1]
    for i in range(len(mean)):
        square = 0.0
        for k in range(3):
            if k < d:
                part = mean[i, 1 + k] - velocity[i, k]
                square += part * part
        solid[i], slip[i] = mean[i, 0], math.sqrt(square)


@njit(error_model="numpy")
def first_bad(beta):
    """The first drag coefficient that is negative or not a finite number, or -1."""
    for i in range(len(beta)):
        if not 0.0 <= beta[i] < np.inf:
            return i
    return -1


@njit(error_model="numpy")
def accelerations(held, volume, density, gravity, steady, contact_force, reaction, gradient, inertia, acceleration):
    """Accelerations (n, d) by all but drag as of the last step, and the densities (n, 1) that resist: infinite if held.

    Args:
        steady: (d,) force per volume that does not change in the step.
        reaction: (n, d) force by viscous stress.
        gradient: (n, d) pressure gradient of the last step.
    """
    d = acceleration.shape[1]
    for i in range(len(held)):
        inertia[i, 0], inverse_mass = np.inf if held[i] else density[i], 1 / (density[i] * volume[i, 0])
        for k in range(3):
            if k < d:
                other = contact_force[i, k] + volume[i, 0] * steady[k]
                if len(reaction):
                    other += reaction[i, k]
                if len(gradient):
                    other -= volume[i, 0] * gradient[i, k]
                acceleration[i, k] = 0.0 if held[i] else gravity[k] + other * inverse_mass


@njit(error_model="numpy")
def relax(dt, volume, density, beta, velocity, acceleration, late, relaxation_rate, target, rate_and_source):
    """Exact relaxation over a step: rates beta / rho (n,), v* (n, d), and V beta' and V beta' v* (n, 1 + d); over the part
    of the step that ``late`` leaves."""
    d, a, mean, lag, part = velocity.shape[1], np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK), np.ones(BLOCK)
    for first in range(0, len(velocity), BLOCK):
        number = min(BLOCK, len(velocity) - first)
        for n in range(number):
            relaxation_rate[first + n] = beta[first + n, 0] / density[first + n, 0]
            if len(late):
                part[n] = 1 - late[first + n]
            a[n] = dt * part[n] * relaxation_rate[first + n]
        relaxations(a, number, mean, lag)
        for n in range(number):
            i = first + n
            rate, behind = volume[i, 0] * beta[i, 0] * mean[n] * part[n], dt * part[n] * lag[n]
            rate_and_source[i, 0] = rate
            for k in range(3):
                if k < d:
                    target[i, k] = velocity[i, k] + behind * acceleration[i, k]
                    rate_and_source[i, 1 + k] = rate * target[i, k]


@njit(error_model="numpy")
def answer(volume, void_fraction, rate, source, before, velocity, slope, out):
    """Fill the rows (cells, d) or (cells, 2 d) of new velocity and pressure gradient, if any, for the particles.

    Returns:
        (d,) force on the fluid by the drag of A = ``rate`` and B = ``source``, and by the gradient on what is solid; and
        whether the velocity is another than before.
    """
    d, force, changed = velocity.shape[1], np.zeros(velocity.shape[1]), False
    for c in range(len(volume)):
        for k in range(3):
            if k < d:
                out[c, k] = velocity[c, k]
                changed |= velocity[c, k] != before[c, k]
                part = source[c, k] - rate[c] * velocity[c, k]
                if slope.shape[1]:
                    out[c, d + k] = slope[c, k]
                    part += (1 - void_fraction[c]) * slope[c, k]
                force[k] += volume[c] * part
    return force, changed


@njit(error_model="numpy")
def drag_force(rate, target, fluid_velocity, force):
    """V beta' (u - v*) (n, d), with V beta' in the first column of ``rate``."""
    d = target.shape[1]
    for i in range(len(target)):
        for k in range(3):
            if k < d:
                force[i, k] = rate[i, 0] * (fluid_velocity[i, k] - target[i, k])


@njit(error_model="numpy")
def total_force(volume, density, steady, drag, reaction, gradient, pressure_gradient, force):
    """Fill the forces (n, 3) and the pressure gradients (n, d) at the particles.

    Args:
        steady: (d,) force per volume by no field.
        drag, reaction: (n, d).
        gradient: (n, d), as gathered; no columns: none.

    Returns:
        Sums of the forces by fields (d,), and of the masses.
    """
    d, mass, total, part = len(steady), 0.0, np.zeros(len(steady)), np.zeros(3)
    for first in range(0, len(volume), BLOCK):
        part[:], part_mass = 0.0, 0.0
        for i in range(first, min(first + BLOCK, len(volume))):
            part_mass += density[i] * volume[i, 0]
            for k in range(3):
                force[i, k] = 0.0
                if k < d:
                    by_fields = 0.0
                    if len(drag):
                        by_fields += drag[i, k]
                    if len(reaction):
                        by_fields += reaction[i, k]
                    if gradient.shape[1]:
                        pressure_gradient[i, k] = gradient[i, k]
                        by_fields -= volume[i, 0] * gradient[i, k]
                    part[k] += by_fields
                    force[i, k] = by_fields + volume[i, 0] * steady[k]
        mass += part_mass
        total += part[:d]
    return total, mass
