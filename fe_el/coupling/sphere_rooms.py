"""Parts of spheres in the few cells that they reach, a block of spheres at a time: loops without branches.

Each sphere has a room of places for cells. It enters with the cell of its centre; of all cells that came last the facets
inside spheres are found, then what these facets cut off and the cells behind them, which come next. What is wanted of one
facet or cell does not wait for that of another, so that a processor does many at once. A walk through the cells of a sphere
after the other (:mod:`fe_el.coupling.sphere_walk`) waits at each for the number of facets inside; it has no limit of cells.
"""
from typing import NamedTuple

import numpy as np

from fe_el.compiled.parts import part
from fe_el.coupling.facet_vectors import lowest, where_equal
from fe_el.coupling.sphere_cuts import FAST, FOUR, RECORD, U, beside, inside_cell, inwards

BLOCK = 128  # spheres
ROOM, LAST = U(8), U(7)  # places of a sphere; the last is for what is in no cell
EMPTY, MANY = np.int32(-1), U(64)  # in a place without a cell; cells known of a sphere that has no room for all


class Rooms(NamedTuple):
    """What is known of the spheres of a block; the places of all rooms have one number after the other."""

    cell: np.ndarray  #: (places,)
    weight: np.ndarray  #: (places,) parts of the sphere
    met: np.ndarray  #: (places,) facets of the cell that were met from their other side, as bits
    known: np.ndarray  #: (spheres,) cells
    place: np.ndarray  #: (places + 1,) that are taken, in the order in which they were
    facet: np.ndarray  #: (4 places + 4,) four times the place and the number of a facet that the sphere reaches


def empty_rooms():
    """Rooms of a block."""
    places = int(ROOM) * BLOCK
    return Rooms(np.empty(places, np.int32), np.empty(places), np.empty(places, np.uint8), np.empty(BLOCK, U),
                 np.empty(places + 1, U), np.empty(4 * places + 4, U))


@part(fastmath=FAST, error_model="numpy")
def enter(cells, spheres, first, number, rooms, notes):
    """Bring spheres into the cells of their centres."""
    cell, position, radius = spheres
    for v in range(number * int(ROOM)):
        rooms.cell[v] = EMPTY
    for v in range(number * int(ROOM)):
        rooms.weight[v] = 0.0
    for v in range(number * int(ROOM)):
        rooms.met[v] = 0
    for n in range(number):
        i, at = first + n, U(n) * ROOM
        inwards(cells, U(cell[i]), position[i, 0], position[i, 1], position[i, 2], radius[i], notes.centre, U(n) * FOUR)
        rooms.cell[at], rooms.weight[at], rooms.known[n], rooms.place[n] = cell[i], 1.0, U(1), at


@part(fastmath=FAST, error_model="numpy")
def _reached(cells, first, last, rooms, notes):
    """Facets inside spheres of the cells that came, but those met from their other side; returns their number."""
    number, facet = U(0), rooms.facet
    for n in range(first, last):
        v = rooms.place[n]
        notes.base[n] = U(rooms.cell[v]) * U(RECORD)
        reached = inside_cell(cells, notes, n) & ~U(rooms.met[v])
        for f in range(4):
            facet[number] = n * FOUR + U(f)
            number += (reached >> U(f)) & U(1)
    return number


@part(fastmath=FAST, error_model="numpy")
def _behind(cells, number, rooms, notes, count, e, taken):
    """Note what facets cut off, and take places for the cells behind them; returns the new numbers of facets and edges that
    are noted, and of places that are taken."""
    neighbour, shift, room, known, weight, met = (cells.neighbour, cells.shift, rooms.cell, rooms.known, rooms.weight,
                                                  rooms.met)
    centre, inside, cut, code, periodic = notes.centre, notes.inside, notes.cut, notes.code, len(cells.shift) > 0
    for n in range(number):
        facet = rooms.facet[n]
        t, f, h = facet // FOUR, facet % FOUR, inside[facet]
        v = rooms.place[t]
        c, own, i = U(room[v]), v & ~LAST, v // ROOM
        edges, beyond = beside(cells, notes, t, f, h)
        missed = ((beyond & ~edges) != U(0)) | ((U(met[v]) >> f) & U(1) != U(0))  # the sphere reaches the plane beside it
        last = e
        for g in range(4):
            code[e] = count * FOUR + U(g)
            e += (edges >> U(g)) & U(1)
        e = last if missed else e
        target = neighbour[c * FOUR + f]
        there, p = lowest(where_equal(room, own, target >> np.int32(2))), known[i]
        new = (target >= 0) & (there > LAST) & (not missed)
        free, fits = own + min(p, LAST), p < LAST
        room[free], rooms.place[taken] = target >> np.int32(2) if new else EMPTY, free
        for k in range(4):
            centre[taken * FOUR + U(k)] = centre[t * FOUR + U(k)]
        if periodic:
            for k in range(3):
                centre[taken * FOUR + U(k)] += shift[c, f, k] if new else 0.0
        taken += U(new & fits)
        known[i] = (p + U(1) if fits else MANY) if new else p
        behind = own + min(p if new else there, LAST)
        met[behind] |= np.uint8(U(1) << (U(target) % FOUR))
        forward, far = (v == own) | (h >= 0), abs(h)
        source, sink = v if forward else behind, behind if forward else v
        cap = (0.5 - 0.75 * far + 0.25 * far * far * far) * ((beyond == U(0)) & (not missed))
        weight[source] -= cap
        weight[sink] += cap
        at = count * U(3)
        cut[at], cut[at + U(1)], cut[at + U(2)] = facet, source, sink
        count += U(not missed)
    return count, e, taken


@part
def spread(cells, number, rooms, notes):
    """Let the spheres of a block into all cells that they reach; returns how many edges are noted."""
    first, last, count, e = U(0), U(number), U(0), U(0)
    while first < last:
        facets = _reached(cells, first, last, rooms, notes)
        first = last
        count, e, last = _behind(cells, facets, rooms, notes, count, e, last)
    return e


@part(fastmath=FAST, error_model="numpy")
def keep(room, rooms, end, negligible, index, weight):
    """Write the shares of a sphere from its parts in its room; returns the end of them."""
    total, at = 0.0, room * ROOM
    for k in range(int(LAST)):
        share = rooms.weight[at + U(k)]
        total += share if share > negligible else 0.0
    scale = 1 / total
    for k in range(int(LAST)):
        share = rooms.weight[at + U(k)]
        index[end], weight[end] = rooms.cell[at + U(k)], share * scale
        end += U(share > negligible)
    return end
