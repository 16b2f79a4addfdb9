"""PETSc matrices on the nodes of a mesh, filled cell by cell."""
import ctypes
from typing import NamedTuple

import numpy as np
from petsc4py import PETSc

from fe_el.nodes import nodal_kernels

_petsc = ctypes.CDLL(PETSc.__file__)  # petsc4py 3.22 has no matrices from coordinates
_petsc.MatSetPreallocationCOO.argtypes = [ctypes.c_void_p, ctypes.c_ssize_t, ctypes.c_void_p, ctypes.c_void_p]
_petsc.MatSetValuesCOO.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int]


class Entries(NamedTuple):
    """Entries of a matrix, for compiled loops that add to them."""

    place: np.ndarray  #: (cells, m, m) entry of each pair of nodes of a cell
    values: np.ndarray  #: (entries,)


class NodalMatrix:
    """Square sparse matrix on the nodes of a P1 space, with an entry for each pair of nodes of a cell.

    This rank's part of the sum over cells is built in plain arrays, row by row; :meth:`assemble` hands it to PETSc.

    Attributes:
        matrix: PETSc matrix.
        values: (entries,) sums over the cells of this rank.
        place: (cells, m, m) entry of each pair of nodes of a cell.
        starts, columns: rows of the entries, and the nodes they belong to.
    """

    def __init__(self, space, dofs):
        PETSc.garbage_cleanup(space.mesh.comm)  # PETSc keeps what Python has dropped until all ranks ask for it
        index_map = space.dofmap.index_map
        self.matrix = PETSc.Mat().create(space.mesh.comm)
        self.matrix.setSizes(((index_map.size_local, None), (index_map.size_local, None)))
        self.matrix.setType("aij")
        m, nodes = dofs.shape[1], index_map.size_local + index_map.num_ghosts
        pairs = np.repeat(dofs, m, 1).ravel().astype(np.int64) * nodes + np.tile(dofs, (1, m)).ravel()
        pairs, place = np.unique(pairs, return_inverse=True)
        self.place, self.values = place.reshape(-1, m, m).astype(np.uint32), np.zeros(len(pairs))
        row, column = pairs // max(nodes, 1), pairs % max(nodes, 1)
        self.starts, self.columns = np.searchsorted(row, np.arange(nodes + 1)), column.astype(np.uint32)
        rows, columns = (index_map.local_to_global(i.astype(np.int32)).astype(PETSc.IntType) for i in (row, column))
        self._check(_petsc.MatSetPreallocationCOO(self.matrix.handle, rows.size, rows.ctypes.data, columns.ctypes.data))
        self.dofs, self._row, self._nodes, self._diagonal = dofs, row, None, self.matrix.createVecRight()

    @property
    def entries(self):
        """Places and values of the entries."""
        return Entries(self.place, self.values)

    def add(self, elements):
        """Add element matrices (cells, m, m)."""
        nodal_kernels.add_elements(self.dofs, self.place, elements, self.values)

    def fix(self, nodes, lift, boundary):
        """Replace rows and columns of fixed nodes (a mask) by a diagonal; what columns carried of ``boundary`` goes to
        ``lift``."""
        if self._nodes is not nodes:
            at = np.flatnonzero(nodes[self._row] | nodes[self.columns])
            self._nodes, self._at, self._kept = nodes, at.astype(np.uint32), np.empty(len(at))
            self._at_row, self._at_column = self._row[at].astype(np.uint32), self.columns[at]
        nodal_kernels.fix_rows(self._at, self._at_row, self._at_column, nodes, self.values, self._kept, lift, boundary)

    def release(self):
        """The entries as they were before :meth:`fix`."""
        self.values[self._at] = self._kept

    def assemble(self):
        """Sum ``values`` of all ranks into the matrix."""
        self._check(_petsc.MatSetValuesCOO(self.matrix.handle, self.values.ctypes.data, int(PETSc.InsertMode.INSERT_VALUES)))

    def subtract_product(self, u, out):
        """Subtract this rank's part times u (nodes, parts) from ``out``."""
        nodal_kernels.subtract_product(self.starts, self.columns, self.values, u, out)

    def diagonal_places(self):
        """Entry of the diagonal for each node of this rank's cells (nodes,); zero for others."""
        places = np.zeros(len(self.starts) - 1, np.int64)
        at = np.flatnonzero(self._row == self.columns)
        places[self._row[at]] = at
        return places

    def diagonal(self):
        """Diagonal entries (owned nodes,) of the matrix; the same memory each time."""
        self.matrix.getDiagonal(self._diagonal)
        return self._diagonal.array

    @staticmethod
    def _check(code):
        if code:
            raise RuntimeError(f"PETSc failed with error code {code} while filling a matrix.")
