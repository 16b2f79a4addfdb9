"""Compiled loops over the particles of an exchange; n particles, d dimensions, SI units.

What not every scene has, such as other forces, comes as an array without rows.
"""
import math

import numpy as np
from numba import njit

BLOCK = 256  # particles that are added up before the total: round-off grows with the root of their number only


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
def fluid_at_particles(mean, velocity, solid, slip):
    """Solid fraction and slip speed (n,) from the means (n, 1 + d) of solid fraction and fluid velocity."""
    for i in range(len(mean)):
        square = 0.0
        for k in range(velocity.shape[1]):
            part = mean[i, 1 + k] - velocity[i, k]
            square += part * part
        solid[i], slip[i] = mean[i, 0], math.sqrt(square)


@njit(cache=True, error_model="numpy")
def first_bad(beta):
    """The first drag coefficient that is negative or not a finite number, or -1."""
    for i in range(len(beta)):
        if not 0.0 <= beta[i] < np.inf:
            return i
    return -1


@njit(cache=True, error_model="numpy")
def accelerations(held, volume, density, gravity, steady, contact_force, reaction, gradient, inertia, acceleration):
    """Accelerations (n, d) by all but drag as of the last step, and the densities (n, 1) that resist: infinite if held.

    Args:
        steady: (d,) force per volume that does not change in the step.
        reaction: (n, d) force by viscous stress.
        gradient: (n, d) pressure gradient of the last step.
    """
    for i in range(len(held)):
        inertia[i, 0] = np.inf if held[i] else density[i]
        for k in range(acceleration.shape[1]):
            other = contact_force[i, k] + volume[i, 0] * steady[k]
            if len(reaction):
                other += reaction[i, k]
            if len(gradient):
                other -= volume[i, 0] * gradient[i, k]
            acceleration[i, k] = 0.0 if held[i] else gravity[k] + other / (density[i] * volume[i, 0])


@njit(cache=True, error_model="numpy")
def relax(dt, volume, density, beta, velocity, acceleration, relaxation_rate, target, rate_and_source):
    """Exact relaxation over a step: rates beta / rho (n,), v* (n, d), and V beta' and V beta' v* (n, 1 + d)."""
    for i in range(len(velocity)):
        a = dt * beta[i, 0] / density[i, 0]
        if a < 1e-3:
            mean, lag = 1 - a / 2 + a * a / 6, 0.5 + a / 12
        else:
            part = -math.expm1(-a)
            mean, lag = part / a, 1 / part - 1 / a
        rate = volume[i, 0] * beta[i, 0] * mean
        relaxation_rate[i], rate_and_source[i, 0] = a / dt, rate
        for k in range(velocity.shape[1]):
            target[i, k] = velocity[i, k] + dt * lag * acceleration[i, k]
            rate_and_source[i, 1 + k] = rate * target[i, k]


@njit(cache=True, error_model="numpy")
def drag_force(rate, target, fluid_velocity, force):
    """V beta' (u - v*) (n, d), with V beta' in the first column of ``rate``."""
    for i in range(len(target)):
        for k in range(target.shape[1]):
            force[i, k] = rate[i, 0] * (fluid_velocity[i, k] - target[i, k])


@njit(cache=True, error_model="numpy")
def total_force(volume, density, steady, drag, reaction, gradient, pressure_gradient, force):
    """Fill the forces (n, 3) and the pressure gradients (n, d) at the particles.

    Args:
        steady: (d,) force per volume by no field.
        drag, reaction: (n, d).
        gradient: (n, d), as gathered; no columns: none.

    Returns:
        Sums of the forces by fields (d,), and of the masses.
    """
    d, mass, total, part = len(steady), 0.0, np.zeros(len(steady)), np.empty(len(steady))
    for first in range(0, len(volume), BLOCK):
        part[:], part_mass = 0.0, 0.0
        for i in range(first, min(first + BLOCK, len(volume))):
            part_mass += density[i] * volume[i, 0]
            for k in range(d):
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
            for k in range(d, 3):
                force[i, k] = 0.0
        mass += part_mass
        total += part
    return total, mass
