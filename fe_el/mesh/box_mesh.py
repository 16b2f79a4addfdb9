"""Boxes of simplices with tagged sides, for scripts."""
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from dolfinx import mesh as dmesh
from mpi4py import MPI

from fe_el.checks import numbers
from fe_el.dolfinx_api import geometry_nodes
from fe_el.mesh.partition import Balance, create_mesh

SIDES = {"x-": 1, "x+": 2, "y-": 3, "y+": 4, "z-": 5, "z+": 6}


def check_box(lengths, cells):
    """Raise ``ValueError`` unless there are 2 or 3 positive lengths and as many positive numbers of cells."""
    size, number = numbers("lengths of the box", lengths), numbers("cells of the box", cells)
    if size.shape not in ((2,), (3,)) or number.shape != size.shape or not (size > 0).all() or not np.isfinite(size).all() \
            or not (number >= 1).all() or (number % 1).any():
        raise ValueError(f"The box has lengths {size.tolist()} and cells {number.tolist()}; give 2 or 3 positive numbers "
                         "each, whole ones for the cells.")


def _on_side(k, at, tolerance, x):
    """Whether points x (3, points) have coordinate k at a value."""
    return np.abs(x[k] - at) < tolerance


def box(lengths: Sequence[float] | np.ndarray, cells: Sequence[int], comm: MPI.Comm = MPI.COMM_WORLD,
        slices_along: int | None = None, balance: Balance = None) -> tuple[dmesh.Mesh, Any]:
    """A rectangle (crossed triangles) or box (tetrahedra) from the origin.

    Args:
        lengths: 2 or 3 edge lengths [m].
        cells: squares or cubes per direction.
        slices_along (int): axis across which every rank gets a slice; absent: dolfinx partitions by the graph of cells.
        balance: places of the particles (particles, 2 or 3) [m], or a checkpoint that holds them: every rank gets as much
            work with cells and particles; absent: as if there were none.

    Returns:
        (mesh, facet_tags): the sides x-, x+, y-, y+, z-, z+ have the tags 1 to 6.

    Raises:
        ValueError: for lengths or numbers that are not positive, or places that are none.

    Note:
        Collective.
    """
    check_box(lengths, cells)
    d = len(lengths)
    whole, cut = comm, slices_along is not None or balance is not None
    if cut:
        comm = MPI.COMM_SELF
    corners = [np.zeros(d), np.asarray(lengths, float)]
    if d == 2:
        mesh = dmesh.create_rectangle(comm, corners, cells, dmesh.CellType.triangle, ghost_mode=dmesh.GhostMode.shared_facet,
                                      diagonal=dmesh.DiagonalType.crossed)
    else:
        mesh = dmesh.create_box(comm, corners, cells, dmesh.CellType.tetrahedron, ghost_mode=dmesh.GhostMode.shared_facet)
    if cut:
        nodes = geometry_nodes(mesh) if whole.rank == 0 else np.zeros((0, d + 1), np.int64)
        x = mesh.geometry.x[:, :d] if whole.rank == 0 else np.zeros((0, d))
        mesh = create_mesh(whole, nodes, x, slices_along, balance)
    found, sides = [], []
    for k in range(d):
        for side, at in enumerate((0.0, lengths[k])):
            found.append(dmesh.locate_entities_boundary(mesh, d - 1, partial(_on_side, k, at, 1e-10 * lengths[k])))
            sides.append(np.full(len(found[-1]), 2 * k + side + 1, np.int32))
    facets, values = np.concatenate(found), np.concatenate(sides)
    order = np.argsort(facets, kind="stable")
    return mesh, dmesh.meshtags(mesh, d - 1, facets[order], values[order])
