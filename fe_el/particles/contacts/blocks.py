"""Blocks of contacts: what the loops of a contact law read and write, row by row.

A block holds ``BLOCK`` contacts as rows of one flat array: entry ``row + n`` belongs to contact n, with ``row`` one of the
places below. Pairs, mesh facets and primitive walls fill the same rows, so there is one kernel per law. Some rows hold one
thing when the law is called and another when it returns. Velocities are those of the half step before the forces; damping
sees the normal velocity carried on to the full step, the tangential spring what really was slipped.
"""
from typing import NamedTuple

import numpy as np

BLOCK = 264  # no power of two: the rows of one contact would share few sets of the cache
ROWS = 36
B = BLOCK

# on entry
CENTRE_X, CENTRE_Y, CENTRE_Z = 0, B, 2 * B  # vector from the second to the first centre (a wall: from its nearest point)
SQUARE = 3 * B  # of its length
REACH = 4 * B  # sum of the radii (a wall: the radius)
RADIUS = 5 * B  # walls only
RADII = 5 * B  # difference of the radii, pairs only
VELOCITY_X, VELOCITY_Y, VELOCITY_Z = 6 * B, 7 * B, 8 * B  # relative, of the centres
SPIN_X, SPIN_Y, SPIN_Z = 9 * B, 10 * B, 11 * B  # r1 w1 + r2 w2
INVERSE_MASS = 12 * B  # of the reduced mass
SPRING_X, SPRING_Y, SPRING_Z = 13 * B, 14 * B, 15 * B  # tangential
LAST_VELOCITY = 16 * B  # normal velocity half a step before
STIFFNESS = 17 * B  # k_n, or Young's modulus E*
DAMPING = 18 * B
FRICTION = 19 * B
STIFFNESS_RATIO = 20 * B  # k_t / k_n, or G* / E*
DAMPING_RATIO = 21 * B  # tangential over normal
REDUCED_RADIUS = 22 * B  # R*
TURN_X, TURN_Y, TURN_Z = 23 * B, 24 * B, 25 * B  # w1 - w2
ROLLING_X, ROLLING_Y, ROLLING_Z = 26 * B, 27 * B, 28 * B  # rolling spring
ROLLING_FRICTION = 29 * B
ATTRACTION = 30 * B  # cohesion energy density, or surface energy (linear law)
CARRY = 34 * B  # 1/2, or 0 at first touch
SHARE = 35 * B  # factor of the force (walls only)

# between the loops of a law
NORMAL_X, NORMAL_Y, NORMAL_Z, DISTANCE, OVERLAP = CENTRE_X, CENTRE_Y, CENTRE_Z, SQUARE, REACH
ARM, NORMAL_VELOCITY, NORMAL_FORCE = SPIN_X, SPIN_Y, SPIN_Z  # ARM: of the force, over the radius
TANGENTIAL_STIFFNESS, TANGENTIAL_DAMPING, NORMAL_STIFFNESS = 31 * B, 32 * B, 33 * B

# on return, with new springs and the normal velocity for the next step
FORCE_X, FORCE_Y, FORCE_Z = VELOCITY_X, VELOCITY_Y, VELOCITY_Z  # on the first body
TORQUE_X, TORQUE_Y, TORQUE_Z = SPIN_X, SPIN_Y, SPIN_Z  # on both, per radius: arm times force, crossed with the normal
ROLLING_TORQUE_X, ROLLING_TORQUE_Y, ROLLING_TORQUE_Z = TURN_X, TURN_Y, TURN_Z  # on the first body


class Block(NamedTuple):
    """A block, and to whom its contacts belong."""

    rows: np.ndarray  #: (ROWS * BLOCK,)
    at: np.ndarray  #: (BLOCK,) pairs, or entries of a list of walls
    particle: np.ndarray  #: (BLOCK,) walls only
    wall: np.ndarray  #: (BLOCK,) walls only


def aligned(rows, width):
    """An array (rows, width) to be filled, which starts at a line of the cache."""
    memory = np.empty(rows * width + 7)
    start = -(memory.ctypes.data // 8) % 8
    return memory[start:start + rows * width].reshape(rows, width)


def new_block():
    """An empty block.

    It is made once: memory that is asked for and given back at each sub-step can cost as much as a hundred contacts.
    """
    block = aligned(ROWS, BLOCK)
    block[:] = 1.0
    return Block(block.ravel(), np.empty(BLOCK, np.uint64), np.empty(BLOCK, np.uint64), np.empty(BLOCK, np.uint64))
