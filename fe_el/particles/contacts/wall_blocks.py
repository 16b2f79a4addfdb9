"""Blocks of contacts with walls: rows of the particles, the law, and forces on particles and walls."""
import numpy as np

from fe_el.compiled.parts import part
from fe_el.compiled.rows_of_four import add_to_rows, block_to_rows, scaled_to_block
from fe_el.particles.contacts import blocks as row
from fe_el.particles.contacts.blocks import BLOCK
from fe_el.particles.contacts.law_kernels import FAST, apply_law, material_row, stiffness_of_parcel, uniform
from fe_el.particles.contacts.pair_forces import fill_up, four_of


@part(fastmath=FAST, forceinline=True)
def add_contact(block, m, i, k, wall, dx, dy, dz, radius, share):
    """Contact m of a block: particle i, entry k of the list; (dx, dy, dz) points from the wall's nearest point to the
    centre; ``share`` multiplies its force."""
    b = block.rows
    block.at[m], block.particle[m], block.wall[m] = k, i, wall
    b[m + row.CENTRE_X], b[m + row.CENTRE_Y], b[m + row.CENTRE_Z] = dx, dy, dz
    b[m + row.SQUARE], b[m + row.REACH], b[m + row.SHARE] = dx * dx + dy * dy + dz * dz, radius, share


@part(fastmath=FAST)
def _gather(block, m, state, spring, stamp, step):
    """Rows of the particles and springs of m contacts, a multiple of four."""
    b, at, who = block.rows, block.at, block.particle
    one, width, old, rest = (1.0, 1.0, 1.0, 1.0), spring.shape[1], step - 1, state.reshape(state.size)[4:]
    for n in range(0, m, 4):
        k = at[n], at[n + 1], at[n + 2], at[n + 3]
        i, last = four_of(who, (n, n + 1, n + 2, n + 3)), four_of(stamp, k)
        keep = (1.0 if last[0] == old else 0.0, 1.0 if last[1] == old else 0.0, 1.0 if last[2] == old else 0.0,
                1.0 if last[3] == old else 0.0)
        stamp[k[0]] = stamp[k[1]] = stamp[k[2]] = stamp[k[3]] = step
        radius = b[n + row.REACH], b[n + 1 + row.REACH], b[n + 2 + row.REACH], b[n + 3 + row.REACH]
        scaled_to_block(b, n + row.RADIUS, state, 8, i, one)  # and the velocity, in the next rows
        scaled_to_block(b, n + row.SPIN_X, rest, 8, i, radius)  # and the inverse mass
        scaled_to_block(b, n + row.SPRING_X, spring, width, k, keep)
        for q in range(4):
            b[n + q + row.CARRY] = 0.5 * keep[q]


@part(fastmath=FAST)
def _gather_rolling(block, m, state, spring, motion):
    b, at, who, wall_of = block.rows, block.at, block.particle, block.wall
    for n in range(m):
        i, k, wall = who[n], at[n], wall_of[n]
        for q in range(3):
            b[n + row.TURN_X + q * BLOCK] = state[i, 4 + q] - motion[wall, 6 + q]
            b[n + row.ROLLING_X + q * BLOCK] = 2.0 * b[n + row.CARRY] * spring[k, 4 + q]


@part(fastmath=FAST)
def _subtract_motion(block, m, x, motion):
    """Relative to walls with origin, velocity and rotation ``motion``."""
    b, who, wall_of = block.rows, block.particle, block.wall
    for n in range(m):
        i, wall = who[n], motion[wall_of[n]]
        ox, oy = x[i, 0] - b[n + row.CENTRE_X] - wall[0], x[i, 1] - b[n + row.CENTRE_Y] - wall[1]
        oz = x[i, 2] - b[n + row.CENTRE_Z] - wall[2]
        b[n + row.VELOCITY_X] -= wall[3] + (wall[7] * oz - wall[8] * oy)
        b[n + row.VELOCITY_Y] -= wall[4] + (wall[8] * ox - wall[6] * oz)
        b[n + row.VELOCITY_Z] -= wall[5] + (wall[6] * oy - wall[7] * ox)


@part(fastmath=FAST)
def _scale(b, m):
    """Multiply forces and torques by the shares of their contacts."""
    several = False
    for n in range(m):
        several |= b[n + row.SHARE] != 1.0
    for n in range(m if several else 0):
        share = b[n + row.SHARE]
        if share != 1.0:
            for k in range(6):  # and torque
                b[n + row.FORCE_X + k * BLOCK] *= share
            for k in range(3):
                b[n + row.ROLLING_TORQUE_X + k * BLOCK] *= share


@part(fastmath=FAST)
def _scatter(block, m, full, rows, spring, walls):
    """Give the particles of m contacts force and torque, the list its springs, and note the largest overlap."""
    b, at, who, deepest = block.rows, block.at, block.particle, walls.deepest[0]
    force, torque, one, deeper = rows.force, rows.force.reshape(rows.force.size)[4:], (1.0, 1.0, 1.0, 1.0), False
    for n in range(m):
        deeper |= 0.5 * b[n + row.OVERLAP] > deepest * b[n + row.RADIUS]
    if deeper:
        for n in range(m):
            walls.deepest[0] = max(walls.deepest[0], 0.5 * b[n + row.OVERLAP] / b[n + row.RADIUS])
    for n in range(m, full):
        for k in range(6):  # and torque
            b[n + row.FORCE_X + k * BLOCK] = 0.0
    for n in range(0, full, 4):
        i = four_of(who, (n, n + 1, n + 2, n + 3))
        radius = b[n + row.RADIUS], b[n + 1 + row.RADIUS], b[n + 2 + row.RADIUS], b[n + 3 + row.RADIUS]
        add_to_rows(b, n + row.FORCE_X, force, i, one)
        add_to_rows(b, n + row.TORQUE_X, torque, i, radius)
        block_to_rows(b, n + row.SPRING_X, spring, spring.shape[1], (at[n], at[n + 1], at[n + 2], at[n + 3]))


@part(fastmath=FAST)
def _to_walls(block, m, x, walls):
    """Subtract force and torque of m contacts from their walls; those of one wall in a row are added up first."""
    b, who, wall_of = block.rows, block.particle, block.wall
    n = 0
    while n < m:
        w, sx, sy, sz, tx, ty, tz = wall_of[n], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        ox, oy, oz = walls.motion[w, 0], walls.motion[w, 1], walls.motion[w, 2]
        while n < m and wall_of[n] == w:
            i, distance = who[n], b[n + row.DISTANCE]
            px = x[i, 0] - ox - distance * b[n + row.NORMAL_X]
            py = x[i, 1] - oy - distance * b[n + row.NORMAL_Y]
            pz = x[i, 2] - oz - distance * b[n + row.NORMAL_Z]
            fx, fy, fz = b[n + row.FORCE_X], b[n + row.FORCE_Y], b[n + row.FORCE_Z]
            sx, sy, sz = sx + fx, sy + fy, sz + fz
            tx, ty, tz = tx + (py * fz - pz * fy), ty + (pz * fx - px * fz), tz + (px * fy - py * fx)
            n += 1
        force = walls.force[w]
        force[0], force[1], force[2] = force[0] - sx, force[1] - sy, force[2] - sz
        force[3], force[4], force[5] = force[3] - tx, force[4] - ty, force[5] - tz


@part(fastmath=FAST)
def finish_block(block, m, rows, spring, stamp, walls, numbers, step, h):
    """Apply the law to a block of m wall contacts and give particles and walls their forces."""
    if m == 0:
        return
    b, at, who, wall_of = block.rows, block.at, block.particle, block.wall
    force, motion, wall_force = rows.force, walls.motion, walls.force
    full = fill_up(b, m, at)
    for n in range(m, full):
        who[n], wall_of[n] = who[m - 1], wall_of[m - 1]
    if not uniform(numbers):
        for n in range(full):
            material_row(b, n, numbers, rows.material[who[n]], walls.material[wall_of[n]])
    _gather(block, full, rows.state, spring, stamp, step)
    if np.any(motion[:, 3:]):
        _subtract_motion(block, full, rows.x, motion)
    if numbers.needs_radius:
        for n in range(full):
            b[n + row.REDUCED_RADIUS] = b[n + row.RADIUS]
    if len(rows.parcel) > 0:
        one = uniform(numbers)
        for n in range(full):
            i = who[n]
            stiffness = numbers.table[0, 0, 0] if one else numbers.table[rows.material[i], walls.material[wall_of[n]], 0]
            stiffness_of_parcel(b, n, numbers, stiffness, rows.parcel[i, 0], rows.parcel[i, 1])
    if numbers.rolls > 0:
        _gather_rolling(block, full, rows.state, spring, motion)
    apply_law(b, full, h, numbers)
    _scale(b, m)
    _to_walls(block, m, rows.x, walls)
    _scatter(block, m, full, rows, spring, walls)
    if numbers.rolls > 0:
        for n in range(m):
            for q in range(3):
                spring[at[n], 4 + q] = b[n + row.ROLLING_X + q * BLOCK]
                force[who[n], 4 + q] += b[n + row.ROLLING_TORQUE_X + q * BLOCK]
                wall_force[wall_of[n], 3 + q] -= b[n + row.ROLLING_TORQUE_X + q * BLOCK]
