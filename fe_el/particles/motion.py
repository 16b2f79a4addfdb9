"""Kicks and drifts of a sub-step."""
from numba import njit

from fe_el.particles.law_kernels import FAST


@njit(cache=True, fastmath=FAST)
def kick(v, w, force, torque, inverse_mass, inverse_inertia, h, owned):
    """v += h F/m, w += h T/I."""
    for i in range(owned):
        a, b = h * inverse_mass[i], h * inverse_inertia[i]
        for k in range(3):
            v[i, k] += a * force[i, k]
            w[i, k] += b * torque[i, k]


@njit(cache=True, fastmath=FAST)
def kick_and_drift(x, v, w, force, torque, external, inverse_mass, inverse_inertia, x0, part, h, owned):
    """Kick by ``part`` of a step, drift by a step, reset the forces; returns the largest squared displacement from x0."""
    largest = 0.0
    for i in range(owned):
        a, b, s = part * h * inverse_mass[i], part * h * inverse_inertia[i], 0.0
        for k in range(3):
            v[i, k] += a * force[i, k]
            w[i, k] += b * torque[i, k]
            x[i, k] += h * v[i, k]
            force[i, k] = external[i, k]
            torque[i, k] = 0.0
            q = x[i, k] - x0[i, k]
            s += q * q
        if not s <= largest:
            largest = s
    return largest


@njit(cache=True)
def mean_force(v, v0, mass, external, dt):
    """Mean contact force (particles, 3) over ``dt`` from the change of momentum."""
    return mass.reshape(-1, 1) * (v - v0) / dt - external
