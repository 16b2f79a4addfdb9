"""Owned cells of a mesh and the nodes (P1) that belong to them, as plain arrays."""
from typing import NamedTuple

import numpy as np

from fe_el.dolfinx_api import dof_table, scalar_space
from fe_el.mesh.cell_mesh import barycentric_maps, owned_corners
from fe_el.parallel.exchange import Halo


class Cells(NamedTuple):
    """Owned cells of a mesh, for compiled loops."""

    dofs: np.ndarray  #: (cells, d + 1) nodes, without a sign
    gradient: np.ndarray  #: (cells, d + 1, d) gradients of the hat functions [1/m]
    volume: np.ndarray  #: (cells,) [m^d]
    size: np.ndarray  #: (cells,) width h [m]


class NodalSpace:
    """Cells and nodes of a mesh of triangles or tetrahedra.

    Attributes:
        dofs: (cells, d + 1) nodes of each owned cell.
        corner: (cells, d + 1, 3) their places [m].
        gradient: (cells, d + 1, d) gradients of the hat functions [1/m].
        volume: (cells,) [m^d].
        nodes, owned_nodes (int): nodes this rank knows, and owns (the first).
        node_halo (Halo): exchange of nodal arrays.

    Note:
        Collective.
    """

    def __init__(self, mesh):
        self.mesh, self.comm, self.dimension = mesh, mesh.comm, mesh.topology.dim
        self.space = scalar_space(mesh, "P", 1)
        self.corner, _ = owned_corners(mesh)
        barycentric, self.volume = barycentric_maps(self.corner, self.dimension)
        self.gradient = np.ascontiguousarray(barycentric[:, :, :self.dimension])
        self.dofs = np.ascontiguousarray(dof_table(self.space)[:len(self.volume)].astype(np.int32))
        index_map = self.space.dofmap.index_map
        self.nodes, self.owned_nodes = index_map.size_local + index_map.num_ghosts, index_map.size_local
        self.node_halo = Halo.of_index_map(self.comm, index_map)
