"""Point particles that meet walls: the way from cell to cell, thrown back where it leads through a wall's facet."""
from typing import NamedTuple

import numpy as np

from fe_el.compiled.cache import njit
from fe_el.particles.location import INSIDE

BEYOND = -1e-10  # barycentric coordinate from which a point is behind a facet of the boundary
HOPS = 10_000


class Rebound(NamedTuple):
    """What a meeting with a wall depends on, and the impulses on the walls."""

    acceleration: np.ndarray  #: (particles, 3) of the step [m/s^2]
    mass: np.ndarray          #: (particles,) [kg]
    motion: np.ndarray        #: (walls, 9) point, velocity and angular velocity of each wall
    restitution: float        #: part of the normal velocity that is left
    tangential: float         #: part of the tangential velocity that is left
    impulse: np.ndarray       #: (walls, 3), added up [N s]


@njit
def _throw_back(i, x, v, normal, depth, wall, rebound):
    """Throw particle i, which is ``depth`` behind a wall, back; ``normal`` leads off the wall.

    What the acceleration towards the wall gave it on the way behind the wall, and takes from it on the way off again, is
    taken from the velocity: so a point under gravity gains no energy, and comes to rest on the wall.
    """
    motion, restitution = rebound.motion, rebound.restitution
    arm = x - motion[wall, :3]
    slip = np.empty(3)
    slip[0] = v[0] - motion[wall, 3] - motion[wall, 7] * arm[2] + motion[wall, 8] * arm[1]
    slip[1] = v[1] - motion[wall, 4] - motion[wall, 8] * arm[0] + motion[wall, 6] * arm[2]
    slip[2] = v[2] - motion[wall, 5] - motion[wall, 6] * arm[1] + motion[wall, 7] * arm[0]
    into, pull = 0.0, 0.0
    for k in range(3):
        into -= slip[k] * normal[k]
        pull -= rebound.acceleration[i, k] * normal[k]
    pull, off, away = max(pull, 0.0), restitution * depth, 0.0
    if into > 0.0:
        square = restitution ** 2 * max(into * into - 2 * pull * depth, 0.0)
        if pull > 0.0:
            off = min(off, 0.5 * square / pull)
        away = np.sqrt(max(square - 2 * pull * off, 0.0))
    for k in range(3):
        x[k] += (depth + off) * normal[k]
        if into > 0.0:
            change = (into + away) * normal[k] + (rebound.tangential - 1) * (slip[k] + into * normal[k])
            v[k] += change
            rebound.impulse[wall, k] -= rebound.mass[i] * change


@njit
def reflect_at_planes(wall, point, normal, held, position, velocity, rebound):
    """Throw particles back that are behind a plane."""
    for i in range(len(position)):
        if held[i]:
            continue
        depth = 0.0
        for k in range(3):
            depth -= (position[i, k] - point[k]) * normal[k]
        if depth > 0.0:
            _throw_back(i, position[i], velocity[i], normal, depth, wall, rebound)


@njit
def reflect_at_facets(barycentric, neighbour, shift, facet_wall, cell, start, position, velocity, rebound):
    """Follow every particle from its cell at ``start`` to its position; updates cell, position and velocity in place.

    ``facet_wall`` (cells, d+1) is the wall of each facet, or -1: there a particle leaves, and keeps its last cell.
    """
    normal = np.empty(3)
    for i in range(len(cell)):
        c, x, p = cell[i], position[i], start[i].copy()
        for _ in range(HOPS):
            facet, first = -1, 2.0
            for f in range(barycentric.shape[1]):
                b = barycentric[c, f]
                end = b[0] * x[0] + b[1] * x[1] + b[2] * x[2] + b[3]
                if end < (INSIDE if neighbour[c, f] >= 0 else BEYOND):
                    here = b[0] * p[0] + b[1] * p[1] + b[2] * p[2] + b[3]
                    when = here / (here - end) if here > 0.0 else 0.0
                    if when < first:
                        facet, first = f, when
            if facet < 0:
                break
            p += first * (x - p)
            b, target = barycentric[c, facet], neighbour[c, facet]
            if target >= 0:
                if len(shift):
                    p += shift[c, facet]
                    x += shift[c, facet]
                c = target
                continue
            if facet_wall[c, facet] < 0:
                break
            size = np.sqrt(b[0] * b[0] + b[1] * b[1] + b[2] * b[2])
            normal[:] = b[:3] / size
            depth = -(b[0] * x[0] + b[1] * x[1] + b[2] * x[2] + b[3]) / size
            _throw_back(i, x, velocity[i], normal, depth, facet_wall[c, facet], rebound)
        cell[i] = c
