"""Springs of live contacts, kept while the lists are made anew, by what does not change: ids, facets, walls."""
from typing import NamedTuple

import numpy as np

from fe_el.compiled.cache import njit
from fe_el.parallel.exchange import move


class Kept(NamedTuple):
    """Springs of the live contacts of one list."""

    particle: np.ndarray  #: (contacts,) rows of the particles
    partner: np.ndarray  #: (contacts,) id of the other particle, or number of the facet or wall
    spring: np.ndarray  #: (contacts, width)


def none(width):
    """No springs, of so many numbers each."""
    return Kept(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, width)))


def renumbered(kept, old, ids):
    """Rows of the particles as they are now (``ids``), after some were inserted or removed; ``old`` holds those before."""
    order = np.argsort(ids)
    place = np.searchsorted(ids, old, sorter=order)
    row = order[np.minimum(place, len(order) - 1)] if len(order) else np.zeros(len(old), np.int64)
    here = ids[row] == old if len(order) else np.zeros(len(old), bool)
    keep = here[kept.particle]
    return Kept(row[kept.particle[keep]], kept.partner[keep], kept.spring[keep])


def moved(comm, every, destination, before, now):
    """Send the springs of particles that changed rank after them.

    Args:
        comm: MPI communicator.
        every: list of :class:`Kept`.
        destination: rank that each particle went to.
        before, now: ids of the particles before and after; those that arrived stand behind those that stayed.

    Note:
        Collective.
    """
    leaving, out = destination != comm.rank, []
    place = np.cumsum(~leaving) - 1
    stayed = int((~leaving).sum())
    arrived = now[stayed:]
    order = np.argsort(arrived)
    for particle, partner, spring in every:
        go = leaving[particle]
        who = before[particle[go]]
        ids, other, stretch = move(comm, destination[particle[go]], [who, partner[go], spring[go]])
        index = stayed + order[np.searchsorted(arrived, ids, sorter=order)]
        out.append(Kept(np.concatenate([place[particle[~go]], index]), np.concatenate([partner[~go], other]),
                        np.concatenate([spring[~go], stretch])))
    return out


@njit
def collect_springs(first, second, partner_id, spring, stamp, step, mirror, owned, ids):
    """Springs of the contacts of this step: (particle, partner's id, spring), for the first partner, and where ``mirror`` is
    set for both."""
    number, width = 0, spring.shape[1]
    for k in range(len(first)):
        if stamp[k] == step:
            number += 2 if mirror and second[k] < owned else 1
    particle, partner = np.empty(number, np.uint32), np.empty(number, np.int64)
    stretch, n = np.empty((number, width)), np.uint64(0)
    for k in range(len(first)):
        if stamp[k] == step:
            particle[n], partner[n] = first[k], partner_id[second[k]]
            for q in range(width):
                stretch[n, q] = spring[k, q]
            n += np.uint64(1)
            if mirror and second[k] < owned:
                particle[n], partner[n] = second[k], ids[first[k]]
                for q in range(width):
                    stretch[n, q] = -spring[k, q]
                stretch[n, 3] = spring[k, 3]  # the normal velocity is the same from both sides
                n += np.uint64(1)
    return particle, partner, stretch


@njit
def by_particle(owned, particle, partner):
    """Where the contacts of each particle begin among all, which these are, and their partners."""
    one, start, order = np.uint32(1), np.zeros(owned + 1, np.uint32), np.empty(len(particle), np.uint32)
    other = np.empty(len(particle), np.int64)
    for k in range(len(particle)):
        start[particle[k] + one] += one
    for i in range(owned):
        start[i + 1] += start[i]
    at = start.copy()
    for k in range(len(particle)):
        n = at[particle[k]]
        order[n], other[n], at[particle[k]] = k, partner[k], n + one
    return start, order, other


@njit
def restore_springs(first, second, partner_id, likely, contacts, stretch, mutual, step, spring, stamp):
    """Copy springs that were kept to the contacts of a new list, and stamp these as of this step and the others as older.

    Only the ``likely`` entries of the list are looked at, those that are in contact or nearly so. A ``mutual`` contact, one
    of two particles, may have been kept for what is its second one now. For ``contacts`` see :func:`by_particle`.
    """
    start, order, other = contacts
    one, width, none, owned = np.uint32(1), spring.shape[1], np.uint32(len(order)), len(start) - 1
    stamp[:] = -2
    for k in likely:
        i, j, found, sign = first[k], second[k], none, 1.0
        for s in range(start[i], start[i + one]):
            if other[s] == partner_id[j]:
                found = order[s]
        if mutual and found == none and j < owned:
            for s in range(start[j], start[j + one]):
                if other[s] == partner_id[i]:
                    found, sign = order[s], -1.0
        if found != none:
            for q in range(width):
                spring[k, q] = stretch[found, q] * sign
            spring[k, 3] = stretch[found, 3]  # the normal velocity is the same from both sides
            stamp[k] = step
