"""Forces of touching pairs: gather a block of contacts, apply the law, scatter forces and torques.

Particles have rows of eight numbers, see :class:`fe_el.particles.contacts.records.Rows`. Contacts are treated four at a
time; the last four of a block are filled up with copies of the last contact, whose forces are zeroed.
"""
import numpy as np

from fe_el.compiled.cache import njit
from fe_el.compiled.parts import part
from fe_el.compiled.rows_of_four import (
    block_to_rows,
    difference_to_block,
    fetch_row,
    force_from_block,
    rolled_sum_to_block,
    scaled_to_block,
    torque_from_block,
)
from fe_el.particles.contacts import blocks as row
from fe_el.particles.contacts.blocks import BLOCK
from fe_el.particles.contacts.law_kernels import FAST, apply_law, stiffness_of_parcel, uniform

MANY = 60000  # particles whose rows do not fit into the near caches


@part(fastmath=FAST, forceinline=True)
def four_of(array, k):
    """Entries of an array, as a tuple of four."""
    return array[k[0]], array[k[1]], array[k[2]], array[k[3]]


@part(fastmath=FAST)
def gather(b, m, at, pairs, state, step):
    """Fill the rows of a block of m contacts (a multiple of four), the pairs ``at`` of the list."""
    first, second, spring, stamp = pairs.first, pairs.second, pairs.spring, pairs.stamp
    old, width = step - 1, spring.shape[1]
    for n in range(0, m, 4):
        k = at[n], at[n + 1], at[n + 2], at[n + 3]
        i, j, last = four_of(first, k), four_of(second, k), four_of(stamp, k)
        keep = (1.0 if last[0] == old else 0.0, 1.0 if last[1] == old else 0.0, 1.0 if last[2] == old else 0.0,
                1.0 if last[3] == old else 0.0)
        stamp[k[0]] = stamp[k[1]] = stamp[k[2]] = stamp[k[3]] = step
        difference_to_block(b, n + row.RADII, state, i, j)  # and the velocity, in the next rows
        rolled_sum_to_block(b, n + row.SPIN_X, state, i, j)  # and the inverse mass
        scaled_to_block(b, n + row.SPRING_X, spring, width, k, keep)  # and the last normal velocity
        b[n + row.CARRY], b[n + 1 + row.CARRY] = 0.5 * keep[0], 0.5 * keep[1]
        b[n + 2 + row.CARRY], b[n + 3 + row.CARRY] = 0.5 * keep[2], 0.5 * keep[3]


@part(fastmath=FAST)
def gather_rolling(b, m, at, pairs, state):
    """Difference of the rotations and rolling springs of contacts that are gathered."""
    first, second, spring = pairs.first, pairs.second, pairs.spring
    for n in range(m):
        k = at[n]
        i, j, keep = first[k], second[k], 2.0 * b[n + row.CARRY]
        for q in range(3):
            b[n + row.TURN_X + q * BLOCK] = state[i, 4 + q] - state[j, 4 + q]
            b[n + row.ROLLING_X + q * BLOCK] = keep * spring[k, 4 + q]


@part(fastmath=FAST)
def gather_material(b, m, at, pairs, material, numbers):
    """Rows of the material table, where pairs differ in it; those from the reduced radius to TURN_Y are overwritten."""
    first, second = pairs.first, pairs.second
    table, width = numbers.table, np.uint64(numbers.table.shape[1])
    flat, one = table.reshape(table.size), (1.0, 1.0, 1.0, 1.0)
    rest = flat[4:]
    for n in range(0, m, 4):
        k = at[n], at[n + 1], at[n + 2], at[n + 3]
        i, j = four_of(material, four_of(first, k)), four_of(material, four_of(second, k))
        entry = i[0] * width + j[0], i[1] * width + j[1], i[2] * width + j[2], i[3] * width + j[3]
        scaled_to_block(b, n + row.STIFFNESS, flat, 8, entry, one)
        scaled_to_block(b, n + row.DAMPING_RATIO, rest, 8, entry, one)
    if numbers.rolls > 0 or numbers.cohesive:
        for n in range(m):
            i, j = material[first[at[n]]], material[second[at[n]]]
            b[n + row.ROLLING_FRICTION], b[n + row.ATTRACTION] = table[i, j, 5], table[i, j, 6]


@part(fastmath=FAST, error_model="numpy")
def reduced_radius(b, m):
    """Reduced radius from the sum and the difference of the radii."""
    for n in range(m):
        total, difference = b[n + row.REACH], b[n + row.RADII]
        b[n + row.REDUCED_RADIUS] = 0.25 * (total * total - difference * difference) / total


@part(fastmath=FAST, error_model="numpy")
def gather_parcels(b, m, at, pairs, rows, numbers):
    """Stiffnesses, where particles are parcels, of contacts whose reduced mass and radius are known."""
    one = uniform(numbers)
    for n in range(m):
        i, j = pairs.first[at[n]], pairs.second[at[n]]
        p, q = rows.parcel[i, 1], rows.parcel[j, 1]
        stiffness = numbers.table[0, 0, 0] if one else numbers.table[rows.material[i], rows.material[j], 0]
        stiffness_of_parcel(b, n, numbers, stiffness, rows.parcel[i, 0] + rows.parcel[j, 0], p * q / (p + q))


@part(fastmath=FAST, error_model="numpy")
def deepest_overlap(b, m, deepest):
    """The larger of ``deepest`` and the overlaps over the smaller diameter, of contacts whose law has been applied."""
    deeper = False
    for n in range(m):
        deeper |= b[n + row.OVERLAP] > deepest * (b[n + row.DISTANCE] + b[n + row.OVERLAP] - abs(b[n + row.RADII]))
    if deeper:
        for n in range(m):
            deepest = max(deepest, b[n + row.OVERLAP] / (b[n + row.DISTANCE] + b[n + row.OVERLAP] - abs(b[n + row.RADII])))
    return deepest


@part(fastmath=FAST)
def scatter(b, m, at, pairs, state, force):
    """Give both particles of each contact of a block their force and torque, and the pair its springs."""
    first, second, spring = pairs.first, pairs.second, pairs.spring
    width = spring.shape[1]
    for n in range(0, m, 4):
        k = at[n], at[n + 1], at[n + 2], at[n + 3]
        i, j = four_of(first, k), four_of(second, k)
        force_from_block(b, n + row.FORCE_X, force, i, j)
        torque_from_block(b, n + row.TORQUE_X, force, state, i, j)
        block_to_rows(b, n + row.SPRING_X, spring, width, k)


@part(fastmath=FAST)
def scatter_rolling(b, m, at, pairs, force):
    """Rolling torques and springs."""
    first, second, spring = pairs.first, pairs.second, pairs.spring
    for n in range(m):
        k = at[n]
        i, j = first[k], second[k]
        for q in range(3):
            spring[k, 4 + q] = b[n + row.ROLLING_X + q * BLOCK]
            force[i, 4 + q] += b[n + row.ROLLING_TORQUE_X + q * BLOCK]
            force[j, 4 + q] -= b[n + row.ROLLING_TORQUE_X + q * BLOCK]


@part(fastmath=FAST)
def next_block(b, at, rows, listed, pairs, start):
    """Distances of the ``listed`` pairs that touch, from entry ``start`` on: (their number, where the block was full)."""
    x, radius, first, second = rows.x, rows.radius, pairs.first, pairs.second
    m, n = 0, start
    while n < len(listed) and m < BLOCK:
        k = listed[n]
        i, j = first[k], second[k]
        dx, dy, dz = x[i, 0] - x[j, 0], x[i, 1] - x[j, 1], x[i, 2] - x[j, 2]
        r2, reach = dx * dx + dy * dy + dz * dz, radius[i] + radius[j]
        b[m + row.CENTRE_X], b[m + row.CENTRE_Y], b[m + row.CENTRE_Z] = dx, dy, dz
        b[m + row.SQUARE], b[m + row.REACH] = r2, reach
        at[m] = k
        m += r2 < reach * reach
        n += 1
    return m, n


@part
def fetch_rows(m, at, pairs, state, force):
    """Ask for what a block of contacts will need, while the processor is still busy with what came before."""
    second, spring = pairs.second, pairs.spring
    for n in range(m):
        k = at[n]
        fetch_row(state, 8, second[k])
        fetch_row(force, 8, second[k])
        fetch_row(spring, spring.shape[1], k)


@part
def fill_up(b, m, at):
    """Copy the last contact of a block until their number is a multiple of four, and return that."""
    full = (m + 3) // 4 * 4
    for n in range(m, full):
        at[n] = at[m - 1]
        for k in range(5):  # the rows that are set before a block is gathered
            b[n + k * BLOCK] = b[m - 1 + k * BLOCK]
    return full


@part(fastmath=FAST)
def pair_forces(rows, listed, pairs, block, numbers, step, h, deepest):
    """Add the contact forces of the ``listed`` pairs, with a block whose constant rows are filled.

    Returns the number of touching pairs, and the larger of ``deepest`` and their overlaps over the smaller diameter.
    A spring counts only if the pair touched in the step before.
    """
    state, force = rows.state, rows.force
    touching, n, far = 0, np.int64(0), len(state) > MANY
    b, at = block.rows, block.at
    while n < len(listed):
        m, n = next_block(b, at, rows, listed, pairs, n)
        if far:
            fetch_rows(m, at, pairs, state, force)
        full = fill_up(b, m, at)
        gather(b, full, at, pairs, state, step)
        if not uniform(numbers):
            gather_material(b, full, at, pairs, rows.material, numbers)
        if numbers.rolls > 0:
            gather_rolling(b, full, at, pairs, state)
        if numbers.needs_radius:
            reduced_radius(b, full)
        if len(rows.parcel) > 0:
            gather_parcels(b, full, at, pairs, rows, numbers)
        apply_law(b, full, h, numbers)
        deepest = deepest_overlap(b, m, deepest)
        for c in range(m, full):
            for k in range(6):  # and torque
                b[c + row.FORCE_X + k * BLOCK] = 0.0
        scatter(b, full, at, pairs, state, force)
        if numbers.rolls > 0:
            scatter_rolling(b, m, at, pairs, force)
        touching += m
    return touching, deepest


@njit
def touching_pairs(rows, pairs):
    """Indices of the pairs that touch, for laws that are plain array functions."""
    x, radius, first, second = rows.x, rows.radius, pairs.first, pairs.second
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
