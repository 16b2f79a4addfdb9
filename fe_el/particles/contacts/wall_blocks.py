"""Blocks of contacts with walls: rows of the particles, the law, and forces on particles and walls."""
import numpy as np

from fe_el.compiled.cache import njit
from fe_el.compiled.rows_of_four import block_to_rows, scaled_to_block
from fe_el.particles.contacts.law_kernels import BLOCK, FAST, apply_law, material_row, uniform
from fe_el.particles.contacts.pair_forces import fill_up, four_of

B = BLOCK


@njit(fastmath=FAST, inline="always")
def add_contact(block, m, i, k, wall, dx, dy, dz, radius, share):
    """Contact m of a block: particle i, entry k of the list; (dx, dy, dz) points from the wall's nearest point to the
    centre; ``share`` multiplies its force."""
    b, at, who, wall_of = block
    at[m], who[m], wall_of[m] = k, i, wall
    b[m], b[m + B], b[m + 2 * B] = dx, dy, dz
    b[m + 3 * B], b[m + 4 * B], b[m + 35 * B] = dx * dx + dy * dy + dz * dz, radius, share


@njit(fastmath=FAST)
def _gather(b, m, who, at, state, spring, stamp, step):
    """Rows of the particles and springs of m contacts, a multiple of four."""
    one, width, old, rest = (1.0, 1.0, 1.0, 1.0), spring.shape[1], step - 1, state.reshape(state.size)[4:]
    for n in range(0, m, 4):
        k = at[n], at[n + 1], at[n + 2], at[n + 3]
        i, last = four_of(who, (n, n + 1, n + 2, n + 3)), four_of(stamp, k)
        keep = (1.0 if last[0] == old else 0.0, 1.0 if last[1] == old else 0.0, 1.0 if last[2] == old else 0.0,
                1.0 if last[3] == old else 0.0)
        stamp[k[0]] = stamp[k[1]] = stamp[k[2]] = stamp[k[3]] = step
        radius = b[n + 4 * B], b[n + 1 + 4 * B], b[n + 2 + 4 * B], b[n + 3 + 4 * B]
        scaled_to_block(b, n + 5 * B, state, 8, i, one)  # radius and velocity: rows 5 to 8
        scaled_to_block(b, n + 9 * B, rest, 8, i, radius)  # r w and inverse mass: rows 9 to 12
        scaled_to_block(b, n + 13 * B, spring, width, k, keep)
        for q in range(4):
            b[n + q + 34 * B] = 0.5 * keep[q]


@njit(fastmath=FAST)
def _gather_rolling(b, m, who, at, wall_of, state, spring, motion):
    for n in range(m):
        i, k, wall = who[n], at[n], wall_of[n]
        for q in range(3):
            b[n + (23 + q) * B] = state[i, 4 + q] - motion[wall, 6 + q]
            b[n + (26 + q) * B] = 2.0 * b[n + 34 * B] * spring[k, 4 + q]


@njit(fastmath=FAST)
def _subtract_motion(b, m, who, wall_of, x, motion):
    """Relative to walls with origin, velocity and rotation ``motion``."""
    for n in range(m):
        i, wall = who[n], motion[wall_of[n]]
        ox, oy, oz = x[i, 0] - b[n] - wall[0], x[i, 1] - b[n + B] - wall[1], x[i, 2] - b[n + 2 * B] - wall[2]
        b[n + 6 * B] -= wall[3] + (wall[7] * oz - wall[8] * oy)
        b[n + 7 * B] -= wall[4] + (wall[8] * ox - wall[6] * oz)
        b[n + 8 * B] -= wall[5] + (wall[6] * oy - wall[7] * ox)


@njit(fastmath=FAST)
def _scale(b, m):
    """Multiply forces and torques by the shares of their contacts."""
    for n in range(m):
        share = b[n + 35 * B]
        if share != 1.0:
            for row in (6, 7, 8, 9, 10, 11, 23, 24, 25):
                b[n + row * B] *= share


@njit(fastmath=FAST)
def finish_block(block, m, x, state, force, material, spring, stamp, step, motion, wall_material, wall_force, deepest,
                 numbers, h):
    """Apply the law to a block of m wall contacts and give particles and walls their forces."""
    if m == 0:
        return
    b, at, who, wall_of = block
    full = fill_up(b, m, at)
    for n in range(m, full):
        who[n], wall_of[n] = who[m - 1], wall_of[m - 1]
    if not uniform(numbers):
        for n in range(full):
            material_row(b, n, numbers, material[who[n]], wall_material[wall_of[n]])
    _gather(b, full, who, at, state, spring, stamp, step)
    if np.any(motion[:, 3:]):
        _subtract_motion(b, full, who, wall_of, x, motion)
    if numbers.needs_radius:
        for n in range(full):
            b[n + 22 * B] = b[n + 5 * B]
    if numbers.rolls > 0:
        _gather_rolling(b, full, who, at, wall_of, state, spring, motion)
    apply_law(b, full, h, numbers)
    _scale(b, m)
    for n in range(0, full, 4):
        block_to_rows(b, n + 13 * B, spring, spring.shape[1], (at[n], at[n + 1], at[n + 2], at[n + 3]))
    for n in range(m):
        i, radius = who[n], b[n + 5 * B]
        deepest[0] = max(deepest[0], 0.5 * b[n + 4 * B] / radius)
        for q in range(3):
            force[i, q] += b[n + (6 + q) * B]
            wall_force[wall_of[n], q] -= b[n + (6 + q) * B]
            force[i, 4 + q] += radius * b[n + (9 + q) * B]
    if numbers.rolls > 0:
        for n in range(m):
            for q in range(3):
                spring[at[n], 4 + q] = b[n + (26 + q) * B]
                force[who[n], 4 + q] += b[n + (23 + q) * B]
