"""Sub-steps of contacts: one for any law, and many at once in compiled code with the built-in laws."""
import math

import numpy as np

from fe_el.compiled.borrowed import borrowed
from fe_el.compiled.cache import njit
from fe_el.compiled.parts import part
from fe_el.parallel.messages import largest
from fe_el.particles.contacts.pair_forces import pair_forces
from fe_el.particles.contacts.records import Near, ShapeRows
from fe_el.particles.contacts.velocity_verlet import drift_on
from fe_el.particles.contacts.wall_shapes import move_walls, note_forces, push_walls, shape_forces
from fe_el.particles.contacts.wall_surfaces import carry_facets
from fe_el.particles.contacts.walls import facet_forces
from fe_el.particles.contacts.waves import ghosts_moved, part_of, refresh_images, wave_length
from fe_el.particles.ghosts import forward_state

FIRST = 1 / 16  # share of the particles' room at which lists begin


@njit
def prune(gap, reach, near):
    """List the pairs whose gap was less than ``reach``; returns their number."""
    number = 0
    for k in range(len(gap)):
        near[number] = k  # one entry longer than the gaps
        number += gap[k] < reach
    return number


@part
def update_near(moved, candidates, near):
    """Widen the lists of what may touch, particles having moved by up to ``sqrt(moved)`` of their room: ``near`` anew."""
    need = math.sqrt(moved)
    if need < near.reach:
        return near
    reach = max(2 * need, FIRST)
    reach = reach if reach < 1 else math.inf  # all
    return Near(reach, prune(candidates.gap, reach, candidates.listed),
                prune(candidates.wall_gap, reach, candidates.wall_listed))


@njit
def near_numbers(moved, candidates, near):
    """The same for callers that are not compiled, to whom numba 0.56 can give numbers, but no record."""
    near = update_near(moved, candidates, near)
    return near.reach, near.pairs, near.facets


@part
def wall_forces(rows, listed, facets, shapes, walls, block, numbers, step, h):
    """Forces of facets, planes and cylinders: (contacts, particle that came onto or behind a wall or -1)."""
    touching, behind = 0, -1
    if len(listed):
        n = facet_forces(rows, listed, facets, walls, block, numbers, step, h)
        touching, behind = max(n, 0), max(-1 - n, behind)
    if len(shapes.particle):
        n = shape_forces(rows, shapes, walls, block, numbers, step, h)
        touching, behind = touching + max(n, 0), max(-1 - n, behind)
    return touching, behind


@njit
def forces_of_walls(rows, listed, facets, shapes, walls, block, numbers, step, h):
    """The same for callers that are not compiled."""
    return wall_forces(rows, listed, facets, shapes, walls, block, numbers, step, h)


@part
def all_forces(assembly, near, moved, step, h, deepest):
    """Forces of walls and pairs with built-in laws, when particles have moved by up to ``sqrt(moved)`` of their room.

    Returns:
        touching pairs and walls, a particle behind a wall or -1, largest overlap over diameter so far, and the numbers of
        ``near`` anew.
    """
    a, candidates = assembly, assembly.candidates
    near = update_near(moved, candidates, near)
    touching_walls, behind = wall_forces(a.rows, candidates.wall_listed[:near.facets], a.facets, a.shapes, a.walls,
                                         a.wall_block, a.wall_law, step, h)
    touching, deepest = pair_forces(a.rows, candidates.listed[:near.pairs], a.pairs, a.pair_block, a.pair_law, step, h,
                                    deepest)
    return touching + touching_walls, behind, max(deepest, a.walls.deepest[0]), near.reach, near.pairs, near.facets


@part
def shapes_of(shapes, begin, end):
    """Part of the entries of planes and cylinders."""
    return ShapeRows(shapes.particle[begin:end], shapes.wall[begin:end], shapes.spring[begin:end], shapes.stamp[begin:end],
                     shapes.kind, shapes.shape)


@part
def wave(number, ahead, h, assembly, ghosts, tiles, near, step, deepest):
    """``number`` sub-steps that follow each other through the tiles; displacements are meant to stay below ``ahead``,
    a share of the particles' room. Collective.

    Returns:
        largest squares of displacement, velocity and its change, over the room, and what :func:`all_forces` returns.
    """
    rows, drift, pairs, candidates, walls = (assembly.rows, assembly.drift, assembly.pairs, assembly.candidates,
                                             assembly.walls)
    starts, strips, width, apart, apart_strips = tiles.starts, tiles.strips, tiles.width, tiles.apart, tiles.apart_strips
    owned, slabs, touching, behind = len(drift.x0), (len(starts) - 1) // strips, 0, -1
    blocks = (strips + (number - 1) * (apart_strips + 1) + width - 1) // width
    lines = slabs + (number - 1) * (apart + 1)
    moved, speed, change, reach = 0.0, 0.0, 0.0, -1.0
    near = update_near(ahead * ahead, candidates, near)
    for line in range(blocks * lines):
        block_end = (line // lines + 1) * width
        for s in range(number):
            slab, back = line % lines - s * (apart + 1), s * (apart_strips + 1)
            low, high = max(block_end - width - back, 0), min(block_end - back, strips)
            if slab < 0 or slab >= slabs or low >= high:
                continue
            c, e = slab * strips + low, slab * strips + high
            d2, v2, c2 = drift_on(rows, drift, 1.0, h, starts[c], starts[e])
            moved, speed, change = max(moved, d2), max(speed, v2), max(change, c2)
            if slab == 0 and ghosts.ranks[0] > 1:  # whatever ghosts touch, here and on other ranks, is in this slab
                forward_state(ghosts, owned, rows.x, rows.state)
                rows.force[owned:] = 0.0
                d2 = max(d2, ghosts_moved(rows, owned, tiles.ghost_x0))
                moved = max(moved, d2)
            moved = math.inf if math.isnan(d2) else moved
            refresh_images(tiles.images[tiles.image_starts[c]:tiles.image_starts[e]], ghosts.images, ghosts.shift, owned,
                           tiles.first_image, rows)
            near = update_near(moved, candidates, near)
            if near.reach != reach:  # the lists were made anew
                reach = near.reach
                at_pair = part_of(candidates.listed, near.pairs, tiles.pairs)
                at_facet = part_of(candidates.wall_listed, near.facets, tiles.facets)
            n, fell = wall_forces(rows, candidates.wall_listed[at_facet[c]:at_facet[e]], assembly.facets,
                                  shapes_of(assembly.shapes, tiles.shapes[c], tiles.shapes[e]), walls, assembly.wall_block,
                                  assembly.wall_law, step + s, h)
            m, deepest = pair_forces(rows, candidates.listed[at_pair[c]:at_pair[e]], pairs, assembly.pair_block,
                                     assembly.pair_law, step + s, h, deepest)
            behind, touching = max(fell, behind), touching + (n + m if s == number - 1 else 0)
    return moved, speed, change, touching, behind, max(deepest, walls.deepest[0]), near.reach, near.pairs, near.facets


@njit
def sub_steps(most, h, age, room_of_walls, assembly, ghosts, tiles, near, step, deepest):
    """Sub-steps with built-in laws, at most ``most``, until the lists are out of date; the first kick is half a step. With
    ``most`` zero nothing moves, and the forces are found once. Collective.

    ``room_of_walls`` holds the largest speed of a wall over the room it has before the lists are out of date [1/s], and that
    room [m].

    Returns:
        sub-steps made, whether the lists are out of date, and what :func:`all_forces` returns, of any sub-step for a
        particle behind a wall.
    """
    assembly, ghosts, tiles = borrowed(assembly), borrowed(ghosts), borrowed(tiles)
    rows, drift, shapes, walls = assembly.rows, assembly.drift, assembly.shapes, assembly.walls
    loaded, (wall_rate, wall_room) = walls.load[:, 4].max() > 0, room_of_walls
    owned, made, touching, behind, stale, ahead, part = len(drift.x0), 0, 0, -1, False, 0.0, 0.5
    first, number = np.int64(0), np.int64(1)  # as literals they would be compiled for twice
    if most == 0:
        touching, behind, deepest, reach, pairs, facets = all_forces(assembly, near, 0.0, step, h, deepest)
        return 0, stale, touching, behind, deepest, reach, pairs, facets
    while made < most and not stale:
        if number == 1:
            moved, speed, change = drift_on(rows, drift, part, h, first, owned)
            forward_state(ghosts, owned, rows.x, rows.state)
            rows.force[owned:] = 0.0
            if loaded:
                push_walls(walls.load, walls.motion, ghosts.ranks, h)
            move_walls(shapes.kind, shapes.shape, walls.motion, h)
            if len(walls.carried):
                carry_facets(assembly.facets.facets, walls.carried, walls.motion, walls.turn, h)
            moved = largest(ghosts.ranks, moved)
            touching, back, deepest, reach, pairs, facets = all_forces(assembly, near, moved, step + made + 1, h, deepest)
            if loaded:
                note_forces(walls.load, walls.force)
        else:
            moved, speed, change, touching, back, deepest, reach, pairs, facets = wave(
                number, ahead, h, assembly, ghosts, tiles, near, step + made + 1, deepest)
            moved = largest(ghosts.ranks, moved)
        near = Near(reach, pairs, facets)
        behind, made, part = max(behind, back), made + number, 1.0
        room = 1 - math.sqrt(moved)
        stale = not room >= 0 or wall_rate * h * (age + made) > 1 or loaded and walls.load[:, 6].max() > wall_room
        if tiles.at_once > 1 and wall_rate == 0.0 and not stale:
            speed, change = largest(ghosts.ranks, speed), largest(ghosts.ranks, change)
            number, ahead = wave_length(min(most - made, tiles.at_once), room, h, math.sqrt(speed), math.sqrt(change))
            ahead += math.sqrt(moved)
    return made, stale, touching, behind, deepest, near.reach, near.pairs, near.facets
