"""Forces of touching pairs: gather a block of contacts, apply the law, scatter forces and torques.

Particles have rows of eight numbers: ``state`` holds radius, velocity, angular velocity and inverse mass over radius;
``force`` holds the force in 0 to 2 and the torque in 4 to 6 (3 and 7 collect what is of no use). Contacts are treated four
at a time; the last four of a block are filled up with copies of the last contact, whose forces are zeroed.
"""
import numpy as np

from fe_el.compiled.cache import njit
from fe_el.compiled.rows_of_four import (
    block_to_rows,
    difference_to_block,
    fetch_row,
    force_from_block,
    rolled_sum_to_block,
    scaled_to_block,
    torque_from_block,
)
from fe_el.particles.contacts.law_kernels import BLOCK, FAST, apply_law, uniform

B = BLOCK
MANY = 60000  # particles whose rows do not fit into the near caches


@njit(fastmath=FAST, inline="always")
def four_of(array, k):
    """Entries of an array, as a tuple of four."""
    return array[k[0]], array[k[1]], array[k[2]], array[k[3]]


@njit(fastmath=FAST)
def gather(b, m, at, first, second, state, spring, stamp, step):
    """Fill the rows of a block of m contacts (a multiple of four), the pairs ``at`` of the list."""
    old, width = step - 1, spring.shape[1]
    for n in range(0, m, 4):
        k = at[n], at[n + 1], at[n + 2], at[n + 3]
        i, j, last = four_of(first, k), four_of(second, k), four_of(stamp, k)
        keep = (1.0 if last[0] == old else 0.0, 1.0 if last[1] == old else 0.0, 1.0 if last[2] == old else 0.0,
                1.0 if last[3] == old else 0.0)
        stamp[k[0]] = stamp[k[1]] = stamp[k[2]] = stamp[k[3]] = step
        difference_to_block(b, n + 5 * B, state, i, j)  # radius and velocity: rows 5 to 8
        rolled_sum_to_block(b, n + 9 * B, state, i, j)  # r w and inverse mass: rows 9 to 12
        scaled_to_block(b, n + 13 * B, spring, width, k, keep)  # spring and normal velocity: rows 13 to 16
        b[n + 34 * B], b[n + 1 + 34 * B] = 0.5 * keep[0], 0.5 * keep[1]
        b[n + 2 + 34 * B], b[n + 3 + 34 * B] = 0.5 * keep[2], 0.5 * keep[3]


@njit(fastmath=FAST)
def gather_rolling(b, m, at, first, second, state, spring):
    """Difference of the rotations and rolling springs of contacts whose rows 13 to 16 are filled."""
    for n in range(m):
        k = at[n]
        i, j, keep = first[k], second[k], 2.0 * b[n + 34 * B]
        for q in range(3):
            b[n + (23 + q) * B] = state[i, 4 + q] - state[j, 4 + q]
            b[n + (26 + q) * B] = keep * spring[k, 4 + q]


@njit(fastmath=FAST)
def gather_material(b, m, at, first, second, material, numbers):
    """Rows of the material table, where pairs differ in it; rows 22 to 24 are overwritten."""
    table, width = numbers.table, np.uint64(numbers.table.shape[1])
    flat, one = table.reshape(table.size), (1.0, 1.0, 1.0, 1.0)
    rest = flat[4:]
    for n in range(0, m, 4):
        k = at[n], at[n + 1], at[n + 2], at[n + 3]
        i, j = four_of(material, four_of(first, k)), four_of(material, four_of(second, k))
        row = i[0] * width + j[0], i[1] * width + j[1], i[2] * width + j[2], i[3] * width + j[3]
        scaled_to_block(b, n + 17 * B, flat, 8, row, one)
        scaled_to_block(b, n + 21 * B, rest, 8, row, one)
    if numbers.rolls > 0 or numbers.cohesive:
        for n in range(m):
            i, j = material[first[at[n]]], material[second[at[n]]]
            b[n + 29 * B], b[n + 30 * B] = table[i, j, 5], table[i, j, 6]


@njit(fastmath=FAST, error_model="numpy")
def reduced_radius(b, m):
    """Row 22 from the sum and the difference of the radii."""
    for n in range(m):
        b[n + 22 * B] = 0.25 * (b[n + 4 * B] * b[n + 4 * B] - b[n + 5 * B] * b[n + 5 * B]) / b[n + 4 * B]


@njit(fastmath=FAST, error_model="numpy")
def deepest_overlap(b, m, deepest):
    """The larger of ``deepest`` and the overlaps over the smaller diameter, of contacts whose law has been applied."""
    deeper = False
    for n in range(m):
        deeper |= b[n + 4 * B] > deepest * (b[n + 3 * B] + b[n + 4 * B] - abs(b[n + 5 * B]))
    if deeper:
        for n in range(m):
            deepest = max(deepest, b[n + 4 * B] / (b[n + 3 * B] + b[n + 4 * B] - abs(b[n + 5 * B])))
    return deepest


@njit(fastmath=FAST)
def scatter(b, m, at, first, second, state, force, spring):
    """Give both particles of each contact of a block their force and torque, and the pair its springs."""
    width = spring.shape[1]
    for n in range(0, m, 4):
        k = at[n], at[n + 1], at[n + 2], at[n + 3]
        i, j = four_of(first, k), four_of(second, k)
        force_from_block(b, n + 6 * B, force, i, j)
        torque_from_block(b, n + 9 * B, force, state, i, j)
        block_to_rows(b, n + 13 * B, spring, width, k)


@njit(fastmath=FAST)
def scatter_rolling(b, m, at, first, second, force, spring):
    """Rolling torques and springs."""
    for n in range(m):
        k = at[n]
        i, j = first[k], second[k]
        for q in range(3):
            spring[k, 4 + q] = b[n + (26 + q) * B]
            force[i, 4 + q] += b[n + (23 + q) * B]
            force[j, 4 + q] -= b[n + (23 + q) * B]


@njit(fastmath=FAST)
def next_block(b, at, x, radius, near, first, second, start):
    """Distances of the touching pairs of ``near`` from its entry ``start`` on: (their number, where the block was full)."""
    m, n = 0, start
    while n < len(near) and m < B:
        k = near[n]
        i, j = first[k], second[k]
        dx, dy, dz = x[i, 0] - x[j, 0], x[i, 1] - x[j, 1], x[i, 2] - x[j, 2]
        r2, reach = dx * dx + dy * dy + dz * dz, radius[i] + radius[j]
        b[m], b[m + B], b[m + 2 * B], b[m + 3 * B], b[m + 4 * B] = dx, dy, dz, r2, reach
        at[m] = k
        m += r2 < reach * reach
        n += 1
    return m, n


@njit
def fetch_rows(m, at, second, state, force, spring):
    """Ask for what a block of contacts will need, while the processor is still busy with what came before."""
    for n in range(m):
        k = at[n]
        fetch_row(state, 8, second[k])
        fetch_row(force, 8, second[k])
        fetch_row(spring, spring.shape[1], k)


@njit
def fill_up(b, m, at):
    """Copy the last contact of a block until their number is a multiple of four, and return that."""
    full = (m + 3) // 4 * 4
    for n in range(m, full):
        at[n] = at[m - 1]
        for row in range(5):
            b[n + row * B] = b[m - 1 + row * B]
    return full


@njit(fastmath=FAST)
def pair_forces(x, state, force, radius, material, near, first, second, spring, stamp, step, block, numbers, h, deepest):
    """Add the contact forces of the pairs ``near`` of the list.

    Returns the number of touching pairs, and the larger of ``deepest`` and their overlaps over the smaller diameter.
    ``stamp`` holds the last step at which each pair touched: a spring counts only if that was the step before.
    """
    touching, n, far = 0, 0, len(x) > MANY
    b, at, _, _ = block  # with constant rows
    while n < len(near):
        m, n = next_block(b, at, x, radius, near, first, second, n)
        if far:
            fetch_rows(m, at, second, state, force, spring)
        full = fill_up(b, m, at)
        gather(b, full, at, first, second, state, spring, stamp, step)
        if not uniform(numbers):
            gather_material(b, full, at, first, second, material, numbers)
        if numbers.rolls > 0:
            gather_rolling(b, full, at, first, second, state, spring)
        if numbers.needs_radius:
            reduced_radius(b, full)
        apply_law(b, full, h, numbers)
        deepest = deepest_overlap(b, m, deepest)
        for c in range(m, full):
            for row in range(6, 12):
                b[c + row * B] = 0.0
        scatter(b, full, at, first, second, state, force, spring)
        if numbers.rolls > 0:
            scatter_rolling(b, m, at, first, second, force, spring)
        touching += m
    return touching, deepest


@njit
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


@njit
def scatter_arrays(first, second, force_on_first, arm_first, arm_second, normal, force):
    """Give both particles of each contact their force, and the torque of its tangential part at the contact point."""
    for n in range(len(first)):
        i, j = first[n], second[n]
        gx, gy, gz = force_on_first[n]
        nx, ny, nz = normal[n]
        c = (gy * nz - gz * ny, gz * nx - gx * nz, gx * ny - gy * nx)
        for k in range(3):
            force[i, k] += force_on_first[n, k]
            force[i, 4 + k] += arm_first[n] * c[k]
            if j >= 0:
                force[j, k] -= force_on_first[n, k]
                force[j, 4 + k] += arm_second[n] * c[k]
