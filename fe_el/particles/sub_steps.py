"""Sub-steps of contacts: one for any laws and ranks, and many at once in compiled code where nothing else has a say."""
import math

from numba import njit

from fe_el.particles.ghosts import pack, unpack
from fe_el.particles.motion import kick_and_drift
from fe_el.particles.pair_forces import pair_forces
from fe_el.particles.wall_shapes import move_walls, shape_forces
from fe_el.particles.walls import facet_forces


@njit(cache=True)
def prune(gap, reach, near):
    """List the pairs whose gap was less than ``reach``; returns their number."""
    number = 0
    for k in range(len(gap)):
        near[number] = k  # one entry longer than the gaps
        number += gap[k] < reach
    return number


@njit(cache=True)
def update_near(moved, skin, gap, wall_gap, listed, wall_listed, reach, number, walls):
    """Widen the lists of what may touch, as particles have moved by up to ``sqrt(moved)``; returns the last three anew.

    ``gap`` and ``wall_gap`` are those of all pairs when they were found; of these the first ``number`` and ``walls`` entries of
    ``listed`` and ``wall_listed`` may touch by now.
    """
    need = 2 * math.sqrt(moved)
    if need >= reach:
        reach = max(2 * need, skin / 16)
        reach = reach if reach < skin else math.inf  # all
        number, walls = prune(gap, reach, listed), prune(wall_gap, 0.5 * reach, wall_listed)
    return reach, number, walls


@njit(cache=True)
def wall_forces(particles, listed, facets, shapes, walls, step, block, numbers, h):
    """Forces of facets, planes and cylinders: (contacts, particle that came onto or behind a wall or -1)."""
    touching, behind = 0, -1
    if len(listed):
        n = facet_forces(*particles, listed, *facets[:4], step, *facets[4:], *walls, block, numbers, h)
        touching, behind = max(n, 0), max(-1 - n, behind)
    if len(shapes[0]):
        n = shape_forces(*particles, *shapes[:4], step, *shapes[4:], *walls, block, numbers, h)
        touching, behind = touching + max(n, 0), max(-1 - n, behind)
    return touching, behind


@njit(cache=True)
def all_forces(particles, pairs, found, near, facets, shapes, walls, moved, skin, step, block, laws, h, deepest):
    """Forces of walls and pairs with built-in laws, when particles have moved by up to ``sqrt(moved)``.

    Returns:
        touching pairs and walls, a particle behind a wall or -1, largest overlap over diameter so far, and ``near`` anew.
    """
    x, state, force, radius, _, material = particles
    near = update_near(moved, skin, *found, *near)
    listed, wall_listed = found[2][:near[1]], found[3][:near[2]]
    touching_walls, behind = wall_forces(particles, wall_listed, facets, shapes, walls, step, block, laws[1], h)
    touching, deepest = pair_forces(x, state, force, radius, material, listed, *pairs, step, block, laws[0], h, deepest)
    return touching + touching_walls, behind, max(deepest, walls[3][0]), near


@njit(cache=True)
def sub_steps(most, h, part, age, skin, wall_speed, particles, drift, images, pairs, found, near, facets, shapes, walls, step,
              block, laws, deepest):
    """Sub-steps of one rank with built-in laws, at most ``most``, until the lists are out of date.

    Returns:
        sub-steps made, whether the lists are out of date, and what :func:`all_forces` returns, of any sub-step for a particle
        behind a wall.
    """
    x, state, force, _, inverse_mass, _ = particles
    external, inverse_inertia, x0 = drift
    owned, made, touching, behind, stale = len(x0), 0, 0, -1, False
    while made < most and not stale:
        moved = kick_and_drift(x, state, force, external, inverse_mass, inverse_inertia, x0, part, h, owned)
        part, made = 1.0, made + 1
        pack(images[0], x, state, images[1])
        unpack(images[1], images[2], owned, owned, x, state)
        force[owned:] = 0.0
        move_walls(shapes[4], shapes[5], walls[0], h)
        touching, back, deepest, near = all_forces(particles, pairs, found, near, facets, shapes, walls, moved, skin, step + made,
                                                   block, laws, h, deepest)
        behind = max(behind, back)
        stale = not math.sqrt(moved) + wall_speed * h * (age + made) <= 0.5 * skin
    return made, stale, touching, behind, deepest, near
