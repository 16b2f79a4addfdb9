"""Kicks and drifts of a sub-step, on the rows of :mod:`fe_el.particles.pair_forces`."""
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
def kick_and_drift(x, state, force, external, inverse_mass, inverse_inertia, x0, part, h, owned):
    """Kick by ``part`` of a step, drift by a step, reset the forces; returns the largest squared displacement from x0."""
    largest = 0.0
    for i in range(owned):
        a, b, s = part * h * inverse_mass[i], part * h * inverse_inertia[i], 0.0
        for k in range(3):
            state[i, 1 + k] += a * force[i, k]
            state[i, 4 + k] += b * force[i, 4 + k]
            x[i, k] += h * state[i, 1 + k]
            force[i, k] = external[i, k]
            force[i, 4 + k] = 0.0
            q = x[i, k] - x0[i, k]
            s += q * q
        force[i, 3] = force[i, 7] = 0.0
        if not s <= largest:
            largest = s
    return largest


@njit(cache=True)
def mean_force(v, v0, mass, external, dt):
    """Mean contact force (particles, 3) over ``dt`` from the change of momentum."""
    return mass.reshape(-1, 1) * (v - v0) / dt - external
