"""What a cell-node scheme needs of the mesh: sizes and gradients of the cells, nodes, and sums over cells at the nodes."""
from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from fe_el.mesh.cell_mesh import check_simplices
from fe_el.nodes.nodal_kernels import scatter
from fe_el.nodes.nodal_space import Cells, NodalSpace
from fe_el.nodes.work_arrays import WorkArrays
from fe_el.parallel.exchange import Halo
from fe_el.parallel.failures import end_all_ranks_on_errors
from fe_el.parallel.messages import ranks_of


class CellsAndNodes(NodalSpace):
    """Owned cells of a mesh of triangles or tetrahedra, and the nodes (P1) that belong to them.

    Raises:
        ValueError: for cells that are not simplices.

    Note:
        Collective.
    """

    time: float  #: that a scheme on them has come to [s]

    def __init__(self, mesh):
        check_simplices(mesh)
        end_all_ranks_on_errors(mesh.comm)
        super().__init__(mesh)
        d, self.ranks, self.work, self.num_cells = self.dimension, ranks_of(mesh.comm), WorkArrays(), len(self.volume)
        touched = np.zeros(self.nodes, bool)
        touched[self.dofs] = True
        self.sum_halo = Halo.of_index_map(self.comm, self.space.dofmap.index_map, touched)
        self.h = self.volume ** (1 / d) * (2 ** 0.5 if d == 2 else 6 ** (1 / 3))
        self.cells = Cells(self.dofs.view(np.uint32), self.gradient, self.volume, self.h)
        self.node_position = np.zeros((self.nodes, 3))
        self.node_position[self.dofs] = self.corner
        self.node_halo.forward(self.node_position)

    def at_cells(self, value: ArrayLike | Callable[[float, np.ndarray], ArrayLike], shape: tuple[int, ...],
                 time: float | None = None) -> np.ndarray:
        """Cell means (cells, ...) of a constant, an array, or a function (time, points (cells, 3)); absent time: now.

        A function is called for one point of every cell at a time, d + 1 times, which is exact for quadratic functions.
        """
        if callable(value):
            now, corners = self.time if time is None else time, self.dimension + 1
            near = (2 / 3, 0.58541019662496845)[self.dimension - 2]  # the share of the nearest corner
            far = (1 - near) / self.dimension
            rest = far * self.corner.sum(1)
            value = sum(np.asarray(value(now, rest + (near - far) * self.corner[:, k]),
                                   float) for k in range(corners)) / corners
        value = np.asarray(value, float)
        if not np.isfinite(value).all():
            raise ValueError(f"A source at time {self.time:g} is not finite; give finite numbers.")
        return np.broadcast_to(value, shape)

    def nodal_zeros(self, shape: tuple[int, ...]) -> np.ndarray:
        """Zeros (nodes, *shape)."""
        return np.zeros((self.nodes, *shape))

    @cached_property
    def node_volume(self) -> np.ndarray:
        """(nodes, 1) volume that belongs to each node [m^3]; collective when it is first asked for."""
        total = self.nodal_zeros((1,))
        scatter(self.dofs, self.volume[:, None], total)
        self.complete(total)
        return total

    def complete(self, *sums: np.ndarray) -> None:
        """Make nodal sums of owned cells complete on every rank whose own cells have the node; elsewhere they stay zero."""
        self.sum_halo.complete(*sums)
