"""Numba kernels of a sub-step: drift, pair forces, wall forces."""
import math

import numpy as np
from numba import njit

FAST = {"contract", "reassoc", "nsz", "arcp"}  # no finite-math assumption: NaN must stay visible


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


@njit(cache=True, fastmath=FAST, inline="always")
def contact_force(nx, ny, nz, overlap, ux, uy, uz, sx, sy, sz, inverse_mass, law, h):
    """Force on the first body and the new tangential spring of a contact.

    n points from the second to the first body, u is the velocity of the first relative to the second at the contact. The
    spring keeps what the contact really slipped, capped at friction F_n / k_t, so that sliding never stores energy. The
    velocity lags the overlap by half a step; the pair's own force carries it on, which keeps second order with damping.
    """
    un = ux * nx + uy * ny + uz * nz
    rate = math.sqrt(law.stiffness * inverse_mass)
    eta = law.damping * law.stiffness / rate
    fn = (law.stiffness * overlap - eta * un) / (1.0 + 0.5 * h * law.damping * rate)
    tx, ty, tz = ux - un * nx, uy - un * ny, uz - un * nz
    sn = sx * nx + sy * ny + sz * nz
    sx, sy, sz = sx - sn * nx + h * tx, sy - sn * ny + h * ty, sz - sn * nz + h * tz
    kt, et = law.tangential_stiffness, law.tangential_damping * eta
    fx, fy, fz = -kt * sx - et * tx, -kt * sy - et * ty, -kt * sz - et * tz
    cap, size2 = law.friction * abs(fn), fx * fx + fy * fy + fz * fz
    if size2 > cap * cap:
        q = cap / math.sqrt(size2)
        fx, fy, fz = q * fx, q * fy, q * fz
        stretch2 = (sx * sx + sy * sy + sz * sz) * kt * kt
        if stretch2 > cap * cap:
            q = cap / math.sqrt(stretch2)
            sx, sy, sz = q * sx, q * sy, q * sz
    return fn * nx + fx, fn * ny + fy, fn * nz + fz, sx, sy, sz


@njit(cache=True, fastmath=FAST)
def pair_forces(x, v, w, force, torque, radius, inverse_mass, start, neighbour, spring, law, h):
    """Add the contact forces of all pairs; returns the number of touching pairs and the largest overlap over diameter."""
    touching, deepest = 0, 0.0
    for i in range(len(start) - 1):
        fx = fy = fz = mx = my = mz = 0.0
        xi, yi, zi, ri = x[i, 0], x[i, 1], x[i, 2], radius[i]
        for k in range(start[i], start[i + 1]):
            j = neighbour[k]
            dx, dy, dz, rj = xi - x[j, 0], yi - x[j, 1], zi - x[j, 2], radius[j]
            r2, reach = dx * dx + dy * dy + dz * dz, ri + rj
            if r2 >= reach * reach:
                spring[k, 0] = spring[k, 1] = spring[k, 2] = 0.0
                continue
            r = math.sqrt(r2)
            inverse = 1.0 / r
            nx, ny, nz = dx * inverse, dy * inverse, dz * inverse
            ai, aj = ri * r / reach, rj * r / reach  # arms that meet: angular momentum is kept to round-off
            wx, wy, wz = ai * w[i, 0] + aj * w[j, 0], ai * w[i, 1] + aj * w[j, 1], ai * w[i, 2] + aj * w[j, 2]
            ux = v[i, 0] - v[j, 0] - (wy * nz - wz * ny)
            uy = v[i, 1] - v[j, 1] - (wz * nx - wx * nz)
            uz = v[i, 2] - v[j, 2] - (wx * ny - wy * nx)
            gx, gy, gz, spring[k, 0], spring[k, 1], spring[k, 2] = contact_force(
                nx, ny, nz, reach - r, ux, uy, uz, spring[k, 0], spring[k, 1], spring[k, 2],
                inverse_mass[i] + inverse_mass[j], law, h)
            fx, fy, fz = fx + gx, fy + gy, fz + gz
            force[j, 0] -= gx
            force[j, 1] -= gy
            force[j, 2] -= gz
            cx, cy, cz = gy * nz - gz * ny, gz * nx - gx * nz, gx * ny - gy * nx
            mx, my, mz = mx + ai * cx, my + ai * cy, mz + ai * cz
            torque[j, 0] += aj * cx
            torque[j, 1] += aj * cy
            torque[j, 2] += aj * cz
            touching += 1
            deepest = max(deepest, (reach - r) / min(ri, rj))
        force[i, 0] += fx
        force[i, 1] += fy
        force[i, 2] += fz
        torque[i, 0] += mx
        torque[i, 1] += my
        torque[i, 2] += mz
    return touching, 0.5 * deepest


@njit(cache=True)
def mean_force(v, v0, mass, external, dt):
    """Mean contact force (particles, 3) over ``dt`` from the change of momentum."""
    return mass.reshape(-1, 1) * (v - v0) / dt - external
