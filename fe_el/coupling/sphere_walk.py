"""Parts of a sphere in any number of cells: a walk through the facets that it touches."""
import numpy as np

from fe_el.compiled.parts import part
from fe_el.coupling.sphere_cuts import FAST, FOUR, RECORD, U, beside, inside_cell


@part(fastmath=FAST, error_model="numpy")
def walk_through(cells, slot, limit, number, index, weight, notes):
    """Walk from a sphere's cell through the facets that it touches; what a facet's edges take is left to be done.

    Args:
        slot: (cells,) all -1: place of a cell in the list.
        limit: cells that a sphere may be in.
        number: entry of ``index`` and ``weight`` in which the sphere's cell is, with all of it.
        notes: of the facets and edges; the first centre is the sphere's.

    Returns:
        The number of cells, 0 for more than the limit, and the number of edges that were noted.
    """
    neighbour, shift, periodic, outside = cells.neighbour, cells.shift, len(cells.shift) > 0, U(len(index)) - U(1)
    centre, inside, cut, code = notes.centre, notes.inside, notes.cut, notes.code
    known, done, count, e, fits = U(1), U(0), U(0), U(0), True
    while fits and done < known:
        c, at = U(index[number + done]), done * FOUR
        notes.base[done] = c * U(RECORD)
        reached = inside_cell(cells, notes, done)
        slot[c] = np.int32(done)
        for f in range(4):
            target, h = neighbour[c * FOUR + U(f)] >> 2, inside[at + U(f)]
            before = slot[target] if target >= 0 else -1
            if not (reached >> U(f)) & U(1) or 0 <= before <= np.int32(done):  # met from its other side
                continue
            edges, beyond = beside(cells, notes, done, U(f), h)
            if beyond & ~edges:  # the sphere reaches the plane beside the facet
                continue
            for g in range(4):
                code[e] = count * FOUR + U(g)
                e += (edges >> U(g)) & U(1)
            if target >= 0 and before < 0:
                fits = known < limit
                if not fits:
                    break
                before, slot[target] = np.int32(known), np.int32(known)
                index[number + known], weight[number + known] = target, 0.0
                for k in range(4):
                    centre[known * FOUR + U(k)] = centre[at + U(k)] + (shift[c, f, k] if periodic and k < 3 else 0.0)
                known += U(1)
            own, behind = number + done, number + U(before) if target >= 0 else outside  # behind a wall
            forward, far = (done == U(0)) | (h >= 0), abs(h)
            source, sink = own if forward else behind, behind if forward else own
            cap = 0.5 - 0.75 * far + 0.25 * far * far * far if beyond == U(0) else 0.0
            weight[source] -= cap
            weight[sink] += cap
            to = count * U(3)
            cut[to], cut[to + U(1)], cut[to + U(2)] = at + U(f), source, sink
            count += U(1)
        done += U(1)
    for k in range(known):
        slot[U(index[number + U(k)])] = -1
    return known if fits else U(0), e


@part(fastmath=FAST, error_model="numpy")
def keep_walk(known, number, negligible, index, weight):
    """Shares of a sphere from its parts, which stand from entry ``number`` on; returns the end of them."""
    total, end, own = 0.0, number, index[number]
    for k in range(known):
        share = weight[number + U(k)]
        there = share > negligible
        index[end], weight[end] = index[number + U(k)], share
        total, end = total + (share if there else 0.0), end + U(there)
    if end == number:
        index[number], weight[number], total, end = own, 1.0, 1.0, number + U(1)
    for k in range(number, end):
        weight[U(k)] /= total
    return end
