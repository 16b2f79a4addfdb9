"""Cutting a mesh into slices along an axis, one per rank: balances particles that lie unevenly in the other directions."""
import numpy as np

from fe_el import dolfinx_api
from fe_el.mesh.cell_mesh import facet_neighbours
from fe_el.parallel.failures import end_all_ranks_on_errors


def slices_of(centre, vertex, axis):
    """``destinations`` for ``dolfinx_api.create_mesh``: slices of equally many cells, those across facets as ghosts.

    Args:
        centre: (cells, d) centres of the cells that this rank hands in.
        vertex: (cells, d+1) their vertex numbers.
        axis (int): 0, 1 or 2.

    Raises:
        ValueError: for an axis that the mesh does not have.
    """
    if not isinstance(axis, (int, np.integer)) or not 0 <= axis < centre.shape[1]:
        raise ValueError(f"slices_along is {axis!r}; the mesh has axes 0 to {centre.shape[1] - 1}.")

    def destinations(ranks):
        n = len(centre)
        if n == 0:
            return np.zeros(0, np.int32), np.zeros(1, np.int32)
        owner = np.empty(n, np.int32)
        owner[np.argsort(centre[:, axis], kind="stable")] = np.arange(n) * ranks // n
        neighbour, _ = facet_neighbours(None, np.asarray(vertex))
        across = np.where(neighbour >= 0, owner[neighbour], owner[:, None])
        rows = [[o] for o in owner]
        for cell in np.flatnonzero((across != owner[:, None]).any(1)):
            rows[cell] += sorted(set(across[cell].tolist()) - {int(owner[cell])})
        offsets = np.concatenate([[0], np.cumsum([len(r) for r in rows])]).astype(np.int32)
        return np.concatenate(rows).astype(np.int32), offsets
    return destinations


def create_mesh(comm, cells, x, axis):
    """``dolfinx_api.create_mesh`` with slices along an axis; ``None``: dolfinx's own partition."""
    end_all_ranks_on_errors(comm)
    cells = np.asarray(cells, np.int64)
    if axis is None:
        return dolfinx_api.create_mesh(comm, cells, x)
    centre = x[cells].mean(1) if len(cells) else np.zeros((0, x.shape[1]))
    return dolfinx_api.create_mesh(comm, cells, x, slices_of(centre, cells, axis))
