"""Sub-steps of contacts: one for any law, and many at once in compiled code with the built-in laws."""
import math

from fe_el.compiled.borrowed import borrowed
from fe_el.compiled.cache import njit
from fe_el.parallel.messages import largest
from fe_el.particles.contacts.pair_forces import pair_forces
from fe_el.particles.contacts.wall_shapes import move_walls, shape_forces
from fe_el.particles.contacts.walls import facet_forces
from fe_el.particles.contacts.waves import part_of, refresh_images, wave_length
from fe_el.particles.ghosts import forward_state
from fe_el.particles.motion import drift_on


@njit
def prune(gap, reach, near):
    """List the pairs whose gap was less than ``reach``; returns their number."""
    number = 0
    for k in range(len(gap)):
        near[number] = k  # one entry longer than the gaps
        number += gap[k] < reach
    return number


@njit
def update_near(moved, gap, wall_gap, listed, wall_listed, reach, number, walls):
    """Widen the lists of what may touch, particles having moved by up to ``sqrt(moved)`` of their room; returns the last
    three.

    ``gap`` and ``wall_gap`` are those of all pairs when they were found, over the room of both; of these the first
    ``number`` and ``walls`` entries of ``listed`` and ``wall_listed`` may touch by now.
    """
    need = math.sqrt(moved)
    if need >= reach:
        reach = max(2 * need, 1 / 16)
        reach = reach if reach < 1 else math.inf  # all
        number, walls = prune(gap, reach, listed), prune(wall_gap, reach, wall_listed)
    return reach, number, walls


@njit
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


@njit
def all_forces(particles, pairs, found, near, facets, shapes, walls, moved, step, block, laws, h, deepest):
    """Forces of walls and pairs with built-in laws, when particles have moved by up to ``sqrt(moved)`` of their room.

    Returns:
        touching pairs and walls, a particle behind a wall or -1, largest overlap over diameter so far, and ``near`` anew.
    """
    x, state, force, radius, _, material = particles
    near = update_near(moved, *found, *near)
    listed, wall_listed = found[2][:near[1]], found[3][:near[2]]
    touching_walls, behind = wall_forces(particles, wall_listed, facets, shapes, walls, step, block[1], laws[1], h)
    touching, deepest = pair_forces(x, state, force, radius, material, listed, *pairs, step, block[0], laws[0], h, deepest)
    return touching + touching_walls, behind, max(deepest, walls[3][0]), near


@njit
def wave(number, ahead, h, particles, drift, ghosts, waves, pairs, found, near, facets, shapes, walls, step, block, laws,
         deepest):
    """``number`` sub-steps that follow each other through the tiles; displacements are meant to stay below ``ahead``,
    a share of the particles' room.

    Returns:
        largest squares of displacement, velocity and its change, over the room, and what :func:`all_forces` returns.
    """
    x, state, force, radius, inverse_mass, material = particles
    starts, pair_at, wall_at, shape_at, image_at, images, strips, apart, apart_strips, _, width = waves
    owned, slabs, touching, behind = len(drift[2]), (len(starts) - 1) // strips, 0, -1
    blocks, rows = (strips + (number - 1) * (apart_strips + 1) + width - 1) // width, slabs + (number - 1) * (apart + 1)
    moved, speed, change, reach = 0.0, 0.0, 0.0, -1.0
    near = update_near(ahead * ahead, *found, *near)
    for row in range(blocks * rows):
        block_end = (row // rows + 1) * width
        for s in range(number):
            slab, back = row % rows - s * (apart + 1), s * (apart_strips + 1)
            low, high = max(block_end - width - back, 0), min(block_end - back, strips)
            if slab < 0 or slab >= slabs or low >= high:
                continue
            c, e = slab * strips + low, slab * strips + high
            d2, v2, c2 = drift_on(x, state, force, inverse_mass, drift, 1.0, h, starts[c], starts[e])
            moved, speed, change = max(moved, d2), max(speed, v2), max(change, c2)
            moved = math.inf if math.isnan(d2) else moved
            refresh_images(images[image_at[c]:image_at[e]], ghosts[3], ghosts[5], owned, x, state, force)
            near = update_near(moved, *found, *near)
            if near[0] != reach:  # the lists were made anew
                reach, a, b = near[0], part_of(found[2], near[1], pair_at), part_of(found[3], near[2], wall_at)
            p, q = shape_at[c], shape_at[e]
            own = shapes[0][p:q], shapes[1][p:q], shapes[2][p:q], shapes[3][p:q], shapes[4], shapes[5]
            n, fell = wall_forces(particles, found[3][b[c]:b[e]], facets, own, walls, step + s, block[1], laws[1], h)
            m, deepest = pair_forces(x, state, force, radius, material, found[2][a[c]:a[e]], *pairs, step + s, block[0],
                                     laws[0], h,
                                     deepest)
            behind, touching = max(fell, behind), touching + (n + m if s == number - 1 else 0)
    return moved, speed, change, touching, behind, max(deepest, walls[3][0]), near


@njit
def sub_steps(most, h, age, wall_rate, particles, drift, ghosts, ranks, waves, pairs, found, near, facets, shapes, walls,
              step, block, laws, deepest):
    """Sub-steps with built-in laws, at most ``most``, until the lists are out of date; the first kick is half a step.
    Collective.

    ``wall_rate`` is the largest speed of a wall over the room it has before the lists are out of date [1/s].

    Returns:
        sub-steps made, whether the lists are out of date, and what :func:`all_forces` returns, of any sub-step for a
        particle behind a wall.
    """
    particles, drift, ghosts, ranks, waves = borrowed((particles, drift, ghosts, ranks, waves))
    pairs, found, facets, shapes, walls, block, laws = borrowed((pairs, found, facets, shapes, walls, block, laws))
    x, state, force, _, inverse_mass, _ = particles
    owned, made, touching, behind, stale, number, ahead, part = len(drift[2]), 0, 0, -1, False, 1, 0.0, 0.5
    while made < most and not stale:
        if number == 1:
            moved, speed, change = drift_on(x, state, force, inverse_mass, drift, part, h, 0, owned)
            forward_state(ghosts, owned, x, state)
            force[owned:] = 0.0
            move_walls(shapes[4], shapes[5], walls[0], h)
            moved = largest(ranks, moved)
            touching, back, deepest, near = all_forces(particles, pairs, found, near, facets, shapes, walls, moved,
                                                       step + made + 1, block, laws, h, deepest)
        else:
            moved, speed, change, touching, back, deepest, near = wave(
                number, ahead, h, particles, drift, ghosts, waves, pairs, found, near, facets, shapes, walls,
                step + made + 1, block, laws, deepest)
        behind, made, part = max(behind, back), made + number, 1.0
        room = 1 - math.sqrt(moved)
        stale = not room >= 0 or wall_rate * h * (age + made) > 1
        if len(waves[0]) > 1 and wall_rate == 0.0 and not stale:
            number, ahead = wave_length(min(most - made, waves[9]), room, h, math.sqrt(speed), math.sqrt(change))
            ahead += math.sqrt(moved)
    return made, stale, touching, behind, deepest, near
