"""Cutting a mesh into slices along an axis, one per rank: balances particles that lie unevenly in the other directions."""
import numpy as np
from dolfinx import mesh as dmesh
from dolfinx.cpp.graph import AdjacencyList_int32

from fe_el.failures import end_all_ranks_on_errors
from fe_el.mesh import facet_neighbours


def slices_of(centre, vertex, axis):
    """A partitioner for dolfinx: slices of equally many cells along ``axis``, with the cells across their facets as ghosts.

    Args:
        centre: (cells, d) centres of the cells that this rank hands in.
        vertex: (cells, d+1) their vertex numbers.
        axis (int): 0, 1 or 2.

    Raises:
        ValueError: for an axis that the mesh does not have.
    """
    if not 0 <= axis < centre.shape[1]:
        raise ValueError(f"slices_along is {axis}; the mesh has axes 0 to {centre.shape[1] - 1}.")

    def partitioner(comm, parts, dimension, cells, ghost_mode):
        n = len(centre)
        if n == 0:
            return AdjacencyList_int32(np.zeros(0, np.int32), np.zeros(1, np.int32))
        owner = np.empty(n, np.int32)
        owner[np.argsort(centre[:, axis], kind="stable")] = np.arange(n) * parts // n
        neighbour, _ = facet_neighbours(None, np.asarray(vertex))
        across = np.where(neighbour >= 0, owner[neighbour], owner[:, None])
        rows = [[o] for o in owner]
        for cell in np.flatnonzero((across != owner[:, None]).any(1)):
            rows[cell] += sorted(set(across[cell].tolist()) - {int(owner[cell])})
        offsets = np.concatenate([[0], np.cumsum([len(r) for r in rows])]).astype(np.int32)
        return AdjacencyList_int32(np.concatenate(rows).astype(np.int32), offsets)
    return partitioner


def create_mesh(comm, cells, x, domain, axis):
    """``dolfinx.mesh.create_mesh`` with slices along an axis; ``None``: dolfinx's own partition."""
    end_all_ranks_on_errors(comm)
    cells = np.asarray(cells, np.int64)
    if axis is None:
        return dmesh.create_mesh(comm, cells, x, domain)
    centre = x[cells].mean(1) if len(cells) else np.zeros((0, x.shape[1]))
    return dmesh.create_mesh(comm, cells, x, domain, partitioner=slices_of(centre, cells, axis))
