"""Cutting a mesh into parts, one per rank: slices along an axis, or parts in which cells and particles are equally much
work."""
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from fe_el import checks, dolfinx_api
from fe_el.mesh.cell_mesh import barycentric_maps, facet_neighbours
from fe_el.parallel.failures import end_all_ranks_on_errors

Balance = ArrayLike | str | Path | None  # places of particles, or a checkpoint that holds them

NEAR = 8  # cells with the nearest middles, among which is nearly always the one around a particle
PARTICLE_WORK = 10.0  # of a particle with contacts and drag, in cells of the fluid: 2 us beside 0.2 us per step


def create_mesh(comm, cells, x, axis, balance=None):
    """``dolfinx_api.create_mesh`` with slices along an axis, or parts of equal work; ``None``: dolfinx's own partition.

    Note:
        Collective.
    """
    end_all_ranks_on_errors(comm)
    cells = np.asarray(cells, np.int64)
    if axis is None and balance is None:
        return dolfinx_api.create_mesh(comm, cells, x)
    corner = x[cells] if len(cells) else np.zeros((0, cells.shape[1], x.shape[1]))
    return dolfinx_api.create_mesh(comm, cells, x, parts_of(comm, corner, cells, axis, balance))


def parts_of(comm, corner, vertex, axis, balance):
    """``destinations`` for ``dolfinx_api.create_mesh``: parts of equally many cells, or of as much work with particles.

    Args:
        corner: (cells, d+1, d) corners of the cells that this rank hands in; one rank hands in all.
        vertex: (cells, d+1) their vertex numbers.
        axis (int): along which the mesh is cut into slices; ``None``: along the one which is best at each cut.
        balance: (particles, 2 or 3) places [m], or a checkpoint that has them; ``None``: none.

    Raises:
        ValueError: for an axis that the mesh does not have, or places that are none.

    Note:
        Collective.
    """
    d = corner.shape[2]
    if axis is not None and (not isinstance(axis, (int, np.integer)) or not 0 <= axis < d):
        raise ValueError(f"slices_along is {axis!r}; the mesh has axes 0 to {d - 1}.")
    places = np.zeros((0, 3)) if balance is None else places_of(comm, balance)
    number = particles_in(corner, places[:, :d]) if len(corner) else None

    def destinations(ranks):
        if number is None:
            return np.zeros(0, np.int32), np.zeros(1, np.int32)
        return with_ghosts(owners(corner.mean(1), number, ranks, axis), np.asarray(vertex))
    return destinations


def particles_in(corner, places):
    """How many of the places (places, d) lie in each cell (cells,), as those of the nearest middles say."""
    n, m, d = corner.shape
    if not len(places):
        return np.zeros(n)
    maps, _ = barycentric_maps(np.concatenate([corner, np.zeros((n, m, 3 - d))], 2), d)
    tree, number = cKDTree(corner.mean(1)), np.zeros(n)
    for some in np.array_split(places, len(places) // 20_000 + 1):
        near = tree.query(some, min(NEAR, n))[1].reshape(len(some), min(NEAR, n))
        inside = np.einsum("pnvk,pk->pnv", maps[near][..., :d], some) + maps[near][..., 3]
        number += np.bincount(near[np.arange(len(some)), inside.min(2).argmax(1)], minlength=n)
    return number


def places_of(comm, balance):
    """Places of particles (particles, 3) on every rank, as given or from a checkpoint.

    Note:
        Collective.
    """
    if isinstance(balance, (str, Path)):
        from fe_el.run.checkpoint import places_in  # where a mesh is cut for a restart, nowhere else
        return places_in(balance, comm)
    return checks.points("places of particles (balance)", balance)


class Cut(NamedTuple):
    """One way to cut some cells in two."""

    cost: float        #: what the slower side's cells are as work, and the slower side's particles
    extent: float      #: of the cells across the cut [m]
    order: np.ndarray  #: (cells,) along the axis
    place: int         #: how many lie below


def owners(centre, number, ranks, axis=None):
    """Rank of each cell, so that all have as much work: the mesh is cut in two, and each part again.

    A cell is as much work as one, a particle as ``PARTICLE_WORK``. All ranks wait for the one with the most cells, and again
    for the one with the most particles: of the axes that one is cut for which the sum of both is least, the longest among
    those that are alike within two percent.

    Args:
        centre: (cells, d) [m].
        number: (cells,) particles in each cell.
        ranks (int): how many parts.
        axis (int): the only one to be cut; ``None``: the best.
    """
    owner, todo = np.zeros(len(centre), np.int32), [(np.arange(len(centre)), 0, ranks)]
    while todo:
        rows, first, parts = todo.pop()
        if parts == 1:
            owner[rows] = first
            continue
        axes = range(centre.shape[1]) if axis is None else [axis]
        cuts = [_cut(centre[rows, k], number[rows], parts) for k in axes]
        least = min(cut.cost for cut in cuts)
        best = max((cut for cut in cuts if cut.cost <= 1.02 * least), key=lambda cut: cut.extent)
        low, high = rows[best.order[:best.place]], rows[best.order[best.place:]]
        todo += [(low, first, parts // 2), (high, first + parts // 2, parts - parts // 2)]
    return owner


def _cut(x, number, parts):
    """The cut across an axis along which cells lie at ``x``, with the work of half of the parts below it."""
    order, low, high = np.argsort(x, kind="stable"), parts // 2, parts - parts // 2
    cells, particles = np.arange(1, len(x) + 1), np.cumsum(number[order])
    work = cells + PARTICLE_WORK * particles
    place = int(np.clip(np.searchsorted(work, work[-1] * low / parts) + 1, low, len(x) - high))
    cost = [max(of[place - 1] / low, (of[-1] - of[place - 1]) / high) for of in (cells, particles)]
    return Cut(cost[0] + PARTICLE_WORK * cost[1], np.ptp(x), order, place)


def with_ghosts(owner, vertex):
    """The rank of each cell and those of the cells across its facets, as ``dolfinx_api.create_mesh`` takes them."""
    neighbour, _ = facet_neighbours(None, vertex)
    across = np.where(neighbour >= 0, owner[neighbour], owner[:, None])
    cell, side = np.nonzero(across != owner[:, None])
    ghosts = np.unique(np.column_stack([cell, across[cell, side]]), axis=0)
    rows, ranks = np.append(np.arange(len(owner)), ghosts[:, 0]), np.append(owner, ghosts[:, 1])
    offsets = np.append(0, np.cumsum(np.bincount(rows)))
    return ranks[np.argsort(rows, kind="stable")].astype(np.int32), offsets.astype(np.int32)  # the owner comes first
