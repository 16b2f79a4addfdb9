"""Kicks and drifts of a sub-step, on the rows of :mod:`fe_el.particles.pair_forces`."""
import numpy as np
from numba import njit

from fe_el.particles.law_kernels import FAST


@njit(cache=True, fastmath=FAST)
def kick(state, force, inverse_mass, inverse_inertia, h, owned):
    """v += h F/m, w += h T/I."""
    for i in range(owned):
        a, b = h * inverse_mass[i], h * inverse_inertia[i]
        for k in range(3):
            state[i, 1 + k] += a * force[i, k]
            state[i, 4 + k] += b * force[i, 4 + k]


@njit(cache=True, fastmath=FAST)
def kick_and_drift(x, state, force, external, inverse_mass, inverse_inertia, x0, part, h, begin, end):
    """Kick some particles by ``part`` of a step, drift by a step, reset their forces.

    Returns the largest squares of their displacement from x0, velocity, and change of velocity.
    """
    largest, fastest, hardest = 0.0, 0.0, 0.0
    for i in range(begin, end):
        a, b, s, v, c = part * h * inverse_mass[i], part * h * inverse_inertia[i], 0.0, 0.0, 0.0
        for k in range(3):
            c += a * force[i, k] * (a * force[i, k])
            state[i, 1 + k] += a * force[i, k]
            state[i, 4 + k] += b * force[i, 4 + k]
            x[i, k] += h * state[i, 1 + k]
            force[i, k] = external[i, k]
            force[i, 4 + k] = 0.0
            q = x[i, k] - x0[i, k]
            s += q * q
            v += state[i, 1 + k] * state[i, 1 + k]
        force[i, 3] = force[i, 7] = 0.0
        fastest, hardest = max(v, fastest), max(c, hardest)
        if not s <= largest:
            largest = s
    return largest, fastest, hardest


@njit(cache=True)
def pack(position, velocity, angular_velocity, external, contact_force, contact_torque, x, state, force):
    """Fill the rows of the owned particles, and clear the forces of the ghosts."""
    for i in range(len(position)):
        for k in range(3):
            x[i, k], state[i, 1 + k], state[i, 4 + k] = position[i, k], velocity[i, k], angular_velocity[i, k]
            force[i, k], force[i, 4 + k] = external[i, k] + contact_force[i, k], contact_torque[i, k]
        force[i, 3] = force[i, 7] = 0.0
    force[len(position):] = 0.0


@njit(cache=True)
def first_not_finite(x, force):
    """The first particle whose position or force is not a finite number, or -1."""
    for i in range(len(x)):
        if not np.isfinite(x[i, 0] + x[i, 1] + x[i, 2] + force[i, 0] + force[i, 1] + force[i, 2]):
            return i
    return -1


@njit(cache=True)
def mean_force(v, v0, mass, external, dt):
    """Mean contact force (particles, 3) over ``dt`` from the change of momentum."""
    return mass.reshape(-1, 1) * (v - v0) / dt - external
