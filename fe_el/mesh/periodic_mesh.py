"""Boxes of simplices that are periodic in some directions, for every function space, on any number of ranks.

The topology is built from wrapped vertex numbers, the geometry is kept cell by cell with unwrapped coordinates. So facets,
ghosts, function spaces and the walk of particles see the wrap by themselves, and cost nothing at run time.
"""
from collections.abc import Sequence
from typing import Any

import numpy as np
from dolfinx import mesh as dmesh
from mpi4py import MPI

from fe_el.dolfinx_api import create_mesh, geometry_nodes, with_geometry
from fe_el.mesh.box_mesh import check_box
from fe_el.mesh.partition import Balance, parts_of


def _wrapped_cells(lengths, cells, periodic):
    """Cells of the box by wrapped vertex numbers, and their unwrapped coordinates (cells, d+1, d)."""
    d, n = len(cells), np.array(cells)
    if d == 3:
        box = dmesh.create_box(MPI.COMM_SELF, [np.zeros(3), np.array(lengths, float)], list(cells),
                               dmesh.CellType.tetrahedron)
    else:
        box = dmesh.create_rectangle(MPI.COMM_SELF, [np.zeros(2), np.array(lengths, float)], list(cells),
                                     dmesh.CellType.triangle, diagonal=dmesh.DiagonalType.crossed)
    nodes = geometry_nodes(box)
    x = box.geometry.x[:, :d].copy()
    half = np.rint(x / np.array(lengths) * n * 2).astype(np.int64)  # crossed triangles have vertices at the centres
    wrapped = np.where(periodic, half % (2 * n), half)
    _, number = np.unique(np.ravel_multi_index(wrapped.T, 2 * n + 1), return_inverse=True)
    return number[nodes].astype(np.int64), x[nodes]


def _cellwise_geometry(cell_x):
    """A COMM_SELF mesh in which no two cells share a vertex, its cells in the order of ``cell_x``."""
    count, m, d = cell_x.shape
    order = np.arange(count)
    for _ in range(2):  # create_mesh reorders cells: permute once so that the order comes out right
        out = create_mesh(MPI.COMM_SELF, np.arange(count * m).reshape(count, m), cell_x[order].reshape(-1, d))
        got = np.array(out.topology.original_cell_index)
        if np.array_equal(order[got], np.arange(count)):
            break
        order = np.empty(count, int)
        order[got] = np.arange(count)
    out.geometry.x[geometry_nodes(out).ravel(), :d] = cell_x.reshape(-1, d)
    return out


def periodic_box(lengths: Sequence[float] | np.ndarray, cells: Sequence[int], periodic: Sequence[bool] | None = None,
                 comm: MPI.Comm = MPI.COMM_WORLD, slices_along: int | None = None,
                 balance: Balance = None) -> tuple[dmesh.Mesh, Any]:
    """A rectangle (crossed triangles) or box (tetrahedra) from the origin, periodic in the chosen directions.

    Args:
        lengths: 2 or 3 edge lengths [m].
        cells: squares or cubes per direction; at least 3 in a periodic direction.
        periodic: one truth value per direction; absent: all periodic.
        slices_along (int): axis across which every rank gets a slice; absent: dolfinx partitions by the graph of cells.
        balance: places of the particles (particles, 2 or 3) [m], or a checkpoint that holds them: every rank gets as much
            work with cells and particles; absent: as if there were none.

    Returns:
        (mesh, facet_tags): sides that are not periodic have the tags of :func:`fe_el.box`. Vertices at the wrap have no
        single coordinate: use cell-wise geometry (fe_el does) in your own forms and output.

    Raises:
        ValueError: for lengths or numbers out of range, or places that are none.

    Note:
        Collective.
    """
    check_box(lengths, cells)
    d = len(cells)
    wraps = np.ones(d, bool) if periodic is None else np.asarray(periodic, bool)
    if wraps.shape != (d,) or (np.array(cells)[wraps] < 3).any():
        raise ValueError(f"The box has cells {list(cells)} and periodic {wraps.tolist()}; give one truth value per "
                         f"direction "
                         "and at least 3 cells in every periodic one.")
    numbers, cell_x = _wrapped_cells(lengths, cells, wraps)
    first = np.zeros((numbers.max() + 1, d))
    first[numbers[::-1].ravel()] = cell_x[::-1].reshape(-1, d)
    root = comm.rank == 0
    parts = None
    if slices_along is not None or balance is not None:
        parts = parts_of(comm, *((cell_x, numbers) if root else (cell_x[:0], numbers[:0])), slices_along, balance)
    graph = create_mesh(comm, numbers if root else numbers[:0], first if root else first[:0], parts)
    original = np.array(graph.topology.original_cell_index)
    dofs = geometry_nodes(graph)
    inputs = np.array(graph.geometry.input_global_indices)[dofs]
    wanted = np.stack([cell_x[original, np.argmax(numbers[original] == inputs[:, [k]], axis=1)] for k in range(d + 1)], 1)
    mesh = with_geometry(graph, _cellwise_geometry(wanted))
    mesh.period = np.zeros(3)
    mesh.period[:d] = np.where(wraps, lengths, 0.0)
    return mesh, _side_tags(mesh, lengths, wraps)


def _side_tags(mesh, lengths, periodic):
    """Tags 1 to 6 of the sides that are not periodic, from the coordinates that each facet's own cell has."""
    d = mesh.topology.dim
    mesh.topology.create_connectivity(d - 1, d)
    mesh.topology.create_connectivity(d, d - 1)
    to_cell, to_facet = mesh.topology.connectivity(d - 1, d), mesh.topology.connectivity(d, d - 1)
    x = mesh.geometry.x[geometry_nodes(mesh)]
    facets, values = [], []
    for facet in range(mesh.topology.index_map(d - 1).size_local):
        cells = to_cell.links(facet)
        if len(cells) != 1 or periodic.all():
            continue
        local = int(np.flatnonzero(to_facet.links(cells[0]) == facet)[0])
        centre = np.delete(x[cells[0]], local, 0).mean(0)
        for k in np.flatnonzero(~periodic):
            for side, at in enumerate((0.0, lengths[k])):
                if abs(centre[k] - at) < 1e-9 * lengths[k]:
                    facets.append(facet)
                    values.append(2 * k + side + 1)
    return dmesh.meshtags(mesh, d - 1, np.array(facets, np.int32), np.array(values, np.int32))
