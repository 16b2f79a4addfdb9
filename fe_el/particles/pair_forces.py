"""Forces of touching pairs: gather a block of contacts, apply the law, scatter forces and torques."""
import numpy as np
from numba import njit

from fe_el.particles.law_kernels import BLOCK, FAST, apply_law, constant_rows

B = BLOCK


@njit(cache=True, fastmath=FAST)
def gather(b, m, at, first, second, v, w, radius, inverse_mass, material, spring, stamp, step, numbers, uniform):
    """Fill the rows of a block of m contacts, the pairs ``at`` of the list; returns the largest overlap over radius."""
    deepest, table, rolls, needs_radius = 0.0, numbers.table, numbers.rolls > 0, numbers.needs_radius
    for n in range(m):
        k = at[n]
        i, j = first[k], second[k]
        ri, rj, keep = radius[i], radius[j], 1.0 if stamp[k] == step - 1 else 0.0
        stamp[k] = step
        b[n + 5 * B], b[n + 6 * B], b[n + 7 * B] = v[i, 0] - v[j, 0], v[i, 1] - v[j, 1], v[i, 2] - v[j, 2]
        b[n + 8 * B] = ri * w[i, 0] + rj * w[j, 0]
        b[n + 9 * B] = ri * w[i, 1] + rj * w[j, 1]
        b[n + 10 * B] = ri * w[i, 2] + rj * w[j, 2]
        b[n + 11 * B], b[n + 12 * B], b[n + 13 * B] = keep * spring[k, 0], keep * spring[k, 1], keep * spring[k, 2]
        b[n + 32 * B], b[n + 33 * B] = spring[k, 3], 0.5 * keep
        b[n + 14 * B] = inverse_mass[i] + inverse_mass[j]
        part = 1.0 - b[n + 3 * B] / ((ri + rj) * (ri + rj))  # overlap / (ri + rj) = 1 - sqrt(1 - part), without the root
        deepest = max(deepest, part * (0.5 + part * (0.125 + 0.0625 * part)) * (ri + rj) / min(ri, rj))
        if needs_radius:
            b[n + 20 * B] = ri * rj / (ri + rj)
        if rolls:
            for q in range(3):
                b[n + (21 + q) * B] = w[i, q] - w[j, q]
                b[n + (24 + q) * B] = keep * spring[k, 4 + q]
        if not uniform:
            for q in range(5):
                b[n + (15 + q) * B] = table[material[i], material[j], q]
            b[n + 27 * B], b[n + 28 * B] = table[material[i], material[j], 5], table[material[i], material[j], 6]
    return deepest


@njit(cache=True, fastmath=FAST)
def scatter(b, m, at, first, second, force, torque, radius, spring, rolls):
    """Give both particles of each contact of a block their force and torque, and the pair its springs."""
    for n in range(m):
        k = at[n]
        i, j = first[k], second[k]
        ri, rj = radius[i], radius[j]
        spring[k, 0], spring[k, 1], spring[k, 2] = b[n + 11 * B], b[n + 12 * B], b[n + 13 * B]
        spring[k, 3] = b[n + 32 * B]
        gx, gy, gz = b[n + 5 * B], b[n + 6 * B], b[n + 7 * B]
        force[i, 0] += gx
        force[i, 1] += gy
        force[i, 2] += gz
        force[j, 0] -= gx
        force[j, 1] -= gy
        force[j, 2] -= gz
        cx, cy, cz = b[n + 8 * B], b[n + 9 * B], b[n + 10 * B]
        torque[i, 0] += ri * cx
        torque[i, 1] += ri * cy
        torque[i, 2] += ri * cz
        torque[j, 0] += rj * cx
        torque[j, 1] += rj * cy
        torque[j, 2] += rj * cz
        if rolls:
            for q in range(3):
                spring[k, 4 + q] = b[n + (24 + q) * B]
                torque[i, q] += b[n + (21 + q) * B]
                torque[j, q] -= b[n + (21 + q) * B]


@njit(cache=True, fastmath=FAST)
def next_block(b, at, x, radius, first, second, k):
    """Distances of the touching pairs from pair ``k`` on, as far as the block holds: (their number, where it stopped)."""
    m = 0
    while k < len(first) and m < B:
        i, j = first[k], second[k]
        dx, dy, dz = x[i, 0] - x[j, 0], x[i, 1] - x[j, 1], x[i, 2] - x[j, 2]
        r2, reach = dx * dx + dy * dy + dz * dz, radius[i] + radius[j]
        b[m], b[m + B], b[m + 2 * B], b[m + 3 * B], b[m + 4 * B] = dx, dy, dz, r2, reach
        at[m] = k
        m += r2 < reach * reach
        k += 1
    return m, k


@njit(cache=True, fastmath=FAST)
def pair_forces(x, v, w, force, torque, radius, inverse_mass, material, first, second, spring, stamp, step, b, numbers, h):
    """Add the contact forces of all pairs; returns the number of touching pairs and the largest overlap over diameter.

    ``stamp`` holds the last step at which each pair touched: a spring counts only if that was the step before.
    """
    touching, deepest, k = 0, 0.0, 0
    at = np.empty(B, np.int64)
    uniform = constant_rows(b, numbers)
    while k < len(first):
        m, k = next_block(b, at, x, radius, first, second, k)
        deepest = max(deepest, gather(b, m, at, first, second, v, w, radius, inverse_mass, material, spring, stamp, step,
                                      numbers, uniform))
        apply_law(b, m, h, numbers)
        scatter(b, m, at, first, second, force, torque, radius, spring, numbers.rolls > 0)
        touching += m
    return touching, 0.5 * deepest


@njit(cache=True)
def touching_pairs(x, radius, first, second):
    """Indices of the pairs that touch, for laws that are plain array functions."""
    at, m = np.empty(len(first), np.int64), 0
    for k in range(len(first)):
        i, j = first[k], second[k]
        r2, reach = 0.0, radius[i] + radius[j]
        for q in range(3):
            r2 += (x[i, q] - x[j, q]) ** 2
        at[m] = k
        m += r2 < reach * reach
    return at[:m]


@njit(cache=True)
def scatter_arrays(first, second, force_on_first, arm_first, arm_second, normal, force, torque):
    """Give both particles of each contact their force, and the torque of its tangential part at the contact point."""
    for n in range(len(first)):
        i, j = first[n], second[n]
        gx, gy, gz = force_on_first[n]
        nx, ny, nz = normal[n]
        c = (gy * nz - gz * ny, gz * nx - gx * nz, gx * ny - gy * nx)
        for k in range(3):
            force[i, k] += force_on_first[n, k]
            torque[i, k] += arm_first[n] * c[k]
            if j >= 0:
                force[j, k] -= force_on_first[n, k]
                torque[j, k] += arm_second[n] * c[k]
