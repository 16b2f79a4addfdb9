"""What comes before and after the sub-steps of a step: forces besides contacts, rows filled and read, checks of arrays."""
import math

import numpy as np

from fe_el.compiled.cache import njit
from fe_el.compiled.direct_calls import Direct
from fe_el.particles.contacts.velocity_verlet import kick


@njit
def unchanged(diameter, position, held, mass, material, number, rows, rows_number):
    """Whether particles are as they are in the rows of the lists, of which they are the first."""
    x, radius, inverse_mass, kind = rows
    for i in range(len(diameter)):
        same = diameter[i] / 2 == radius[i] and material[i] == kind[i] and number[i] == rows_number[i]
        same &= (0.0 if held[i] else 1 / mass[i]) == inverse_mass[i]
        for k in range(3):
            same &= position[i, k] == x[i, k]
        if not same:
            return False
    return True


@njit
def external_force(held, inertia, gravity, force):
    """Force (particles, 3) by all but contacts, of what is not held [N]."""
    out = np.empty(force.shape)
    for i in range(len(force)):
        for k in range(3):
            out[i, k] = 0.0 if held[i] else inertia[i] * gravity[k] + force[i, k]
    return out


@njit
def inverse_inertia(held, mass, diameter):
    """Inverse moments of inertia (particles,), zero of what is held [1/(kg m^2)]."""
    out = np.empty(len(mass))
    for i in range(len(mass)):
        out[i] = 0.0 if held[i] else 10.0 / (mass[i] * (diameter[i] * diameter[i]))
    return out


@njit
def mean_contact_force(velocity, start, held, inertia, gravity, force, dt):
    """Mean contact force (particles, 3) over ``dt`` from the change of momentum."""
    out = np.empty(force.shape)
    for i in range(len(force)):
        for k in range(3):
            other = 0.0 if held[i] else inertia[i] * gravity[k] + force[i, k]
            out[i, k] = inertia[i] * (velocity[i, k] - start[i, k]) / dt - other
    return out


@njit
def pack(position, velocity, angular_velocity, external, fading, contact_force, contact_torque, rows):
    """Fill positions, states and forces of the owned particles, and clear the forces of the ghosts; ``fading`` (particles or
    0, 4) is a part of the external force."""
    x, state, force = rows
    for i in range(len(position)):
        for k in range(3):
            x[i, k], state[i, 1 + k], state[i, 4 + k] = position[i, k], velocity[i, k], angular_velocity[i, k]
            other = external[i, k] + fading[i, k] if len(fading) else external[i, k]
            force[i, k], force[i, 4 + k] = other + contact_force[i, k], contact_torque[i, k]
        force[i, 3] = force[i, 7] = 0.0
    force[len(position):] = 0.0


@njit
def _unpack(rows, drift, h, position, velocity, angular_velocity, contact_force, contact_torque):
    """The last kick, of ``h``, and the arrays of the owned particles anew."""
    x, state, force, external, fading = rows.x, rows.state, rows.force, drift.external, drift.fading
    kick(rows, drift.inverse_inertia, h, len(position))
    for i in range(len(position)):
        for k in range(3):
            position[i, k], velocity[i, k], angular_velocity[i, k] = x[i, k], state[i, 1 + k], state[i, 4 + k]
            by_contacts = force[i, k] - external[i, k]
            contact_force[i, k] = by_contacts - fading[i, k] if len(fading) else by_contacts
            contact_torque[i, k] = force[i, 4 + k]


unpack = Direct(_unpack)


@njit
def first_not_finite(x, force):
    """The first particle whose position or force is not a finite number, or -1."""
    for i in range(len(x)):
        if not np.isfinite(x[i, 0] + x[i, 1] + x[i, 2] + force[i, 0] + force[i, 1] + force[i, 2]):
            return i
    return -1


@njit
def lightest_and_smallest(material, density, diameter, count):
    """Inverses of the least mass [1/kg] and radius [1/m] of each of ``count`` materials; zero where there is no particle."""
    light, small = np.zeros(count), np.zeros(count)
    for i in range(len(material)):
        k = min(material[i], count - 1)
        light[k] = max(light[k], 6.0 / (math.pi * density[i] * diameter[i] ** 3))
        small[k] = max(small[k], 2.0 / diameter[i])
    return light, small
