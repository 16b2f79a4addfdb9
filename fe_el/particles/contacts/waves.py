"""Several sub-steps in one pass over the memory, for beds that do not fit into the caches.

The particles are sorted by slabs, and in these by strips. A slab can make its next sub-step as soon as its neighbours have
made the last one, so a few sub-steps follow each other through the bed like waves, a few slabs apart, and what they need
stays in the caches. In wide beds they do so in one block of strips after the other; each sub-step's block lies a few strips
behind that of the last. Without blocks every particle gets its forces in the same order as in one sub-step after the other
on the same lists.

On several ranks slabs are layers by the distance from the other ranks' particles, and all that touch ghosts are in the first
one. So a sub-step exchanges ghosts where it begins, as it does without waves, and goes away from the other ranks, with the
next ones behind it.
"""
import numpy as np

from fe_el.compiled.cache import njit
from fe_el.compiled.parts import part
from fe_el.particles.contacts import neighbours
from fe_el.particles.contacts.records import Tiles

FROM = 15000  # particles
SLAB = 500  # particles at least
FINE = 2  # slabs in the reach of a contact
STRIPS = 2  # the same of strips
AT_ONCE = 8  # sub-steps at most
IN_CACHE = 32000  # particles, with their contacts
NONE = Tiles(*(np.zeros(1, np.int64),) * 6, np.zeros((0, 4)), strips=1, apart=0, apart_strips=0, at_once=1, width=1,
             first_image=0)


def tiles(position, period, reach):
    """Number of each particle's tile: slab times the number of strips, and strip; and the number of strips.

    Slabs cut the direction that gives the thinnest, strips the next, where slabs alone hold too much. In a periodic
    direction two that are as far from the middle count as one.
    """
    lower, _, extent = neighbours.bounds(position)
    fold = np.array(period) > 0 if period is not None else np.zeros(3, bool)
    length = np.maximum(np.where(fold, period if period is not None else 0.0, extent), 1e-300)  # a line has no width
    across, along = np.argsort(-extent / (1 + fold), kind="stable")[:2]

    def cut(axis, most):
        count = max(int(min(most, len(position))), 1)
        origin = 0.0 if fold[axis] else lower[axis]
        part = np.clip(((position[:, axis] - origin) / length[axis] * count).astype(np.int64), 0, count - 1)
        return (np.minimum(part, count - 1 - part), (count + 1) // 2) if fold[axis] else (part, count)
    slab, slabs = cut(across, min(FINE * length[across] / reach, len(position) * (1 + fold[across]) / SLAB))
    wide = len(position) * (FINE + 2) * AT_ONCE > IN_CACHE * slabs
    strip, strips = cut(along, STRIPS * length[along] / reach) if wide else (np.zeros_like(slab), 1)
    return slab * strips + strip, strips


@njit
def _distances(position, boxes):
    """Of each position from the nearest box (boxes, 2, 3), zero inside [m]."""
    out = np.empty(len(position))
    for i in range(len(position)):
        least = np.inf
        for b in range(len(boxes)):
            square = 0.0
            for k in range(3):
                gap = max(boxes[b, 0, k] - position[i, k], position[i, k] - boxes[b, 1, k], 0.0)
                square += gap * gap
            least = min(least, square)
        out[i] = np.sqrt(least)
    return out


def layers(position, boxes, reach):
    """Number of each particle's layer by its distance from boxes (boxes, 2, 3) of other ranks' particles; where there are
    none, from the end of the longest direction."""
    lower, _, extent = neighbours.bounds(position)
    along = int(np.argmax(extent))
    distance = _distances(position, boxes) if len(boxes) else position[:, along] - lower[along]
    return (distance / max(reach / FINE, distance.max() * SLAB / len(position))).astype(np.int64)


def first_tile(starts, tile, near):
    """Tiles as one where any of the particles ``near`` other ranks are: beginnings, and the number of each particle's."""
    last = int(tile[near].max(initial=0))
    return np.append(0, starts[last + 1:]), np.maximum(tile - last, 0)


@njit
def by_tile(first, second, tile, strips, count):
    """The pairs in the order of the later slab and the later strip of the two.

    Returns:
        pairs, where those of each tile begin, how far apart their slabs and their strips may be.
    """
    start, apart, apart_strips = np.zeros(count + 1, np.int64), np.int32(0), np.int32(0)
    slab, strip = np.empty(len(tile), np.int32), np.empty(len(tile), np.int32)
    for n in range(len(tile)):  # once for each particle: divisions take long
        slab[n] = tile[n] // strips
        strip[n] = tile[n] - slab[n] * strips
    place = np.empty(len(first), np.uint32)
    for k in range(len(first)):
        i, j, p, q = slab[first[k]], slab[second[k]], strip[first[k]], strip[second[k]]
        place[k] = max(i, j) * strips + max(p, q)
        start[place[k] + np.uint32(1)] += 1
        apart, apart_strips = max(apart, abs(i - j)), max(apart_strips, abs(p - q))
    for c in range(count):
        start[c + 1] += start[c]
    at, one, two = start.copy(), np.empty_like(first), np.empty_like(second)
    for k in range(len(first)):
        n = at[place[k]]
        one[n], two[n] = first[k], second[k]
        at[place[k]] = n + 1
    return one, two, start, apart, apart_strips


def at_once(particles, slabs, apart, strips, apart_strips):
    """How many sub-steps may follow each other, in blocks of how many strips, so that particles between them stay in the
    caches.

    A block is fetched once for all of its sub-steps, with what these add on its side: the choice fetches the least.
    """
    best, lag = None, max(particles, 1) * (apart + 1) / slabs
    for number in range(2, AT_ONCE + 1):
        block = int(IN_CACHE / (lag * number) * strips)
        behind = (apart_strips + 1) * (number - 1)
        if block >= strips:
            block, share = strips + behind, 1 / number
        else:
            share = (block + behind) / (number * block) if block else np.inf
        if best is None or share < best[0]:
            best = share, number, block if block else strips + behind
    return best[1], best[2]


@njit
def wave_length(most, room, step, speed, change):
    """How many sub-steps keep displacements within ``room``, with twice the speed and its change there are now: (number,
    reach).

    All of them are over the room of each particle.
    """
    number, ahead = 1, 0.0
    for n in range(2, most + 1):
        reach = 2 * n * step * (speed + n * change)
        if reach <= room:
            number, ahead = n, reach
    return number, ahead


@part
def refresh_images(which, source, shift, owned, first, rows):
    """Set some of the periodic images, before which there are ``first`` other ghosts, to their particles."""
    x, state, force = rows.x, rows.state, rows.force
    for k in range(len(which)):
        n = which[k]
        i, g = source[n], owned + first + n
        for q in range(3):
            x[g, q] = x[i, q] + shift[first + n, q]
            state[g, 1 + q], state[g, 4 + q] = state[i, 1 + q], state[i, 4 + q]
        for q in range(8):
            force[g, q] = 0.0


@part
def ghosts_moved(rows, owned, x0):
    """Largest square of the displacement of a ghost from x0 (ghosts, 4), over its room."""
    x, largest = rows.x, 0.0
    for n in range(len(x0)):
        dx, dy, dz = x[owned + n, 0] - x0[n, 0], x[owned + n, 1] - x0[n, 1], x[owned + n, 2] - x0[n, 2]
        square = x0[n, 3] * (dx * dx + dy * dy + dz * dz)
        if not square <= largest:
            largest = square
    return largest


@part
def part_of(listed, number, at):
    """Where the entries of each tile begin among the first ``number`` of a list of places in the whole list."""
    out, n = np.empty(len(at), np.int64), 0
    for c in range(len(at)):
        while n < number and listed[n] < at[c]:
            n += 1
        out[c] = n
    return out
