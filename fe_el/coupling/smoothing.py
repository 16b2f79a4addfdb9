"""Smoothing of cell fields over a length: self-adjoint and conservative, with a constant matrix that is set up once."""
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_matrix

from fe_el.checks import positive_number, require_mesh, require_positive, whole_number
from fe_el.compiled.for_each_dimension import M, by_dimension
from fe_el.coupling.near_particles import STEPS, NearParticles, ways_between
from fe_el.coupling.polynomial import MatrixRows, Part, begin, chebyshev
from fe_el.nodes.nodal_kernels import add_integrals
from fe_el.nodes.nodal_matrix import NodalMatrix
from fe_el.nodes.nodal_space import NodalSpace
from fe_el.nodes.work_arrays import WorkArrays
from fe_el.parallel.exchange import Halo, total_of

if TYPE_CHECKING:
    from dolfinx.mesh import Mesh

LANCZOS = 200  # steps towards the bounds of a matrix's spectrum


@by_dimension
def _to_cells(dofs, values, out):
    share = 1.0 / M
    for c in range(len(dofs)):
        for k in range(values.shape[1]):
            total = 0.0
            for i in range(M):
                total += values[dofs[c, i], k]
            out[c, k] = share * total


class Nodes(NodalSpace):
    """The P1 nodes of a mesh with its cells: sums from cells, means to cells."""

    def __init__(self, mesh):
        super().__init__(mesh)
        self.total = self.comm.allreduce(self.volume.sum())

    def load(self, field):
        """Nodal integrals (nodes, k) of a cell field, complete on owned nodes."""
        out = np.zeros((self.nodes, field.shape[1]))
        add_integrals(self.dofs, self.volume, field, out)
        return self.node_halo.reverse_add(out)

    def means(self, values):
        """Cell means (cells, k) of nodal values."""
        out = np.empty((len(self.dofs), values.shape[1]))
        _to_cells(self.dofs, values, out)
        return out


class HelmholtzSmoothing:
    """Smoothing by one implicit step of diffusion with D = length^2 / dt: (1 - length^2 laplace) a = a_before.

    Cell values become nodal loads, the Helmholtz problem (P1, lumped mass) is solved, and its cell means are returned. The
    solver is a Chebyshev polynomial of fixed degree in the constant matrix, for all components at once: so the map is linear
    and self-adjoint to round-off, whatever its tolerance, and the mean is split off, so integrals are kept to round-off.

    Args:
        mesh: dolfinx mesh.
        length (float): smoothing length [m]; l^2 is half the second moment of the kernel per direction.
        tolerance (float): bound of the solver's relative error in the energy norm: of the kernel's shape, as sums and
            symmetry do not depend on it; :meth:`near` cuts the kernel off where it has fallen to that. With 1e-2 the solids
            of a jet on cells of 1.4 lengths are 0.5 % from those of the exact solution, and the gas at them 0.1 %; the mesh
            itself takes 12 % off the kernel with cells of 0.8 lengths.

    Attributes:
        iterations (int): degree of the polynomial.

    Raises:
        ValueError: for a length that is not positive.

    Note:
        Collective.
    """

    def __init__(self, mesh: "Mesh", length: float, tolerance: float = 1e-2) -> None:
        require_mesh(mesh)
        self.length = length = positive_number("smoothing length", length)
        if not positive_number("tolerance of the smoothing", tolerance) < 1:
            raise ValueError(f"The tolerance of the smoothing is {tolerance}; it must be between 0 and 1.")
        self.nodes, self._work = Nodes(mesh), WorkArrays()
        nodes, m = self.nodes, self.nodes.dofs.shape[1]
        matrix = NodalMatrix(nodes.space, nodes.dofs)
        stiffness = length ** 2 * np.einsum("cik,cjk,c->cij", nodes.gradient, nodes.gradient, nodes.volume)
        elements = stiffness + np.eye(m) * (nodes.volume / m)[:, None, None]
        matrix.add(elements)
        matrix.assemble()
        self._local_rows(matrix.matrix)
        self._ways, self._reach = ways_between(matrix, nodes, length), float(np.log(1 / tolerance))
        low, high = self._spectrum(elements)
        self.mass = nodes.load(np.ones((len(nodes.dofs), 1)))[:nodes.owned_nodes, 0]
        self._all = Part(np.arange(nodes.owned_nodes, dtype=np.uint32), self.matrix_rows, self.halo, self.rows)
        self.middle, self.half = 0.5 * (high + low), max(0.5 * (high - low), 1e-12 * high)
        root = np.sqrt(high / low)
        rate = (root - 1) / (root + 1)
        self.iterations = max(int(np.ceil(np.log(tolerance / 2) / np.log(max(rate, 1e-12)))), 2) + 1  # one for what is lost
        ratios = [self.half / self.middle]
        for _ in range(self.iterations - 1):
            ratios.append(1 / (2 * self.middle / self.half - ratios[-1]))
        rho = np.array(ratios)
        self.first, self.second = rho[1:] * rho[:-1], 2 * rho[1:] / self.half
        found, comm = self.solve(self.mass[:, None], self._all)[:, 0], nodes.comm  # of a constant, nearly one
        self.scale = float(np.divide(*comm.allreduce(np.array([self.mass.sum(), self.mass @ found]))))
        self.missing = (1 - self.scale * found) / self.mass  # what the polynomial then loses of a load, over the mass

    def _spectrum(self, elements):
        """Bounds of the spectrum of D^-1 H: those of the elements (Fried 1972), or Lanczos' of the matrix with a tenth to
        spare, which slivers do not make three times as wide; rounded, so that they do not depend on the ranks. Lanczos'
        lower one counts once it stands still; H is the mass and what is not negative: its least share in D is a bound, too.
        """
        nodes, n, comm = self.nodes, self.nodes.owned_nodes, self.nodes.comm
        scale = 1 / np.sqrt(np.einsum("cii->ci", elements))
        spectrum = np.linalg.eigvalsh(elements * scale[:, :, None] * scale[:, None, :])
        low = -comm.allreduce(-spectrum[:, 0].min(initial=np.inf), op=_max())
        high = comm.allreduce(spectrum[:, -1].max(initial=0.0), op=_max())
        of, root = self.matrix_rows, np.sqrt(self.matrix_rows.inverse_diagonal)
        matrix = csr_matrix((of.value, of.column.astype(np.int64), of.start.astype(np.int64)), (n, self.rows))
        place, x = np.zeros((nodes.nodes, 3)), np.zeros((self.rows, 1))
        place[nodes.dofs] = nodes.corner
        size = max(comm.allgather(float(np.abs(place).max(initial=0.0))))
        v, last, along, beside = np.sin(place[:n] @ [1e4, 1.4e4, 1.7e4] / size), np.zeros(n), [], [0.0]
        v /= np.sqrt(comm.allreduce(v @ v))
        share = nodes.load(np.ones((len(nodes.dofs), 1)))[:n, 0] * of.inverse_diagonal
        low, least = max(low, -comm.allreduce(-share.min(initial=np.inf), op=_max())), [np.inf]
        for k in range(LANCZOS):
            x[:n, 0] = root * v
            w = root * (matrix @ self.halo.forward(x)[:, 0]) - beside[-1] * last
            along.append(comm.allreduce(v @ w))
            w -= along[-1] * v
            length = np.sqrt(comm.allreduce(w @ w))
            if not length > 1e-10:
                break
            beside.append(length)
            v, last = w / length, v
            if k % 10 == 9:
                found = _ritz(along, beside)
                least.append(found[0])
                if least[-2] - least[-1] < 0.003 * least[-1]:
                    low = max(low, float(f"{0.9 * least[-1]:.1e}"))
                    break
        return low, min(high, float(f"{1.1 * _ritz(along, beside)[-1]:.1e}"))

    def _local_rows(self, matrix):
        """The owned rows as arrays with local columns, and the exchange for the columns of other ranks."""
        comm, first = self.nodes.comm, matrix.getOwnershipRange()[0]
        start, column, value = matrix.getValuesCSR()
        starts, n = np.array(comm.allgather(first)), self.nodes.owned_nodes
        local = column.astype(np.int64) - first
        ghosts = np.unique(column[(local < 0) | (local >= n)]).astype(np.int64)
        outside = (local < 0) | (local >= n)
        self.border = np.unique(np.searchsorted(start, np.flatnonzero(outside), side="right") - 1)  # rows with ghosts
        local[outside] = n + np.searchsorted(ghosts, column[outside])
        self.ghost_owners = np.searchsorted(starts, ghosts, side="right") - 1
        self.halo = Halo.of_requests(comm, n + np.arange(len(ghosts)), self.ghost_owners, ghosts - starts[self.ghost_owners])
        self.rows = n + len(ghosts)
        self.matrix_rows = MatrixRows(start.astype(np.uint64), local.astype(np.uint32), value.copy(),
                                      1 / csr_matrix((value, local, start), (n, self.rows)).diagonal())

    def solve(self, load: np.ndarray, part: Part) -> np.ndarray:
        """Approximate H^-1 load of (owned nodes, k) by the Chebyshev polynomial, with H and load cut off to a part: (its
        rows, k), for now."""
        columns = [self._solve(load, column, part) for column in range(0, load.shape[1], 8)]
        return columns[0] if len(columns) == 1 else np.hstack(columns)

    def _solve(self, load, column, part):
        """The same for up to eight columns of the load."""
        n, k, steps = len(part.at), load.shape[1], len(self.first) if self.nodes.comm.size == 1 else 1
        width = 4 if k - column <= 4 else 8
        b = self._work.empty(("b", column, width), n, width)
        x_old, x, new = (self._work.empty((name, column, width), part.size, width) for name in range(3))
        begin(part.at, part.rows.inverse_diagonal, 1 / self.middle, load, column, b, x_old, x)
        for i in range(0, len(self.first), steps):
            now = slice(i, i + steps)
            part.halo.forward(x)
            chebyshev(part.rows, b, x_old, x, new, self.first[now], self.second[now])
            for _ in self.first[now]:
                x_old, x, new = x, new, x_old
        return x[:n, :k - column]

    def __call__(self, field: np.ndarray) -> np.ndarray:
        """Smoothed cell field (owned cells, k)."""
        nodes, n = self.nodes, self.nodes.owned_nodes
        if not field.shape[1]:
            return field.copy()
        values, load = np.empty((nodes.nodes, field.shape[1])), nodes.load(field)[:n]
        values[:n] = self.scale * self.solve(load, self._all) + self.missing[:, None] * load
        values[:n] += total_of(nodes.comm, load.sum(0) - self.mass @ values[:n]) / nodes.total  # round-off
        return nodes.means(nodes.node_halo.forward(values))

    def near(self, filled: np.ndarray, before: NearParticles | None = None) -> NearParticles:
        """The same for fields of particles in the filled cells (owned cells,), a mask; of the step ``before`` if that
        serves."""
        if before is None:
            return NearParticles(self, filled, self._ways, self._reach)
        cells = before.cells_of_next(filled)
        return before if cells is None else NearParticles(self, cells, self._ways, self._reach, before.steps % STEPS)


class PatchAverage:
    """Smoothing without a solve: cells to nodes to cells, weighted with volume; self-adjoint and conservative.

    Args:
        mesh: dolfinx mesh.
        repeats (int): how often; the reach grows with its square root, by about one cell for one.

    Raises:
        ValueError: for fewer than one repeat.

    Note:
        Collective.
    """

    def __init__(self, mesh: "Mesh", repeats: int = 1) -> None:
        require_mesh(mesh)
        self.repeats = whole_number("number of repeats", repeats, 1)
        self.nodes = Nodes(mesh)
        self.mass = self.nodes.node_halo.forward(self.nodes.load(np.ones((len(self.nodes.dofs), 1))))

    def __call__(self, field: np.ndarray) -> np.ndarray:
        """Smoothed cell field (owned cells, k)."""
        for _ in range(self.repeats):
            field = self.nodes.means(self.nodes.node_halo.forward(self.nodes.load(field)) / self.mass)
        return field


class FixedValues:
    """The paper's eq. 5 for mean particle velocities: values of filled cells stay, empty cells get smoothed neighbours.

    (1 + kappa - length^2 laplace) a = (1 + kappa) a_before in filled cells, kappa and a_before zero in empty ones, on the
    nodes (P1, lumped mass); filled cells then keep their own value exactly.

    Args:
        mesh: dolfinx mesh.
        length (float): smoothing length [m].
        kappa (float): fixing factor.

    Note:
        Collective.
    """

    def __init__(self, mesh, length, kappa=1e5):
        require_positive("smoothing length", length)
        require_positive("fixing factor kappa", kappa)
        from fe_el.nodes.linear_solver import LinearSolver
        self.nodes, self.kappa = Nodes(mesh), float(kappa)
        nodes = self.nodes
        self.stiffness = length ** 2 * np.einsum("cik,cjk,c->cij", nodes.gradient, nodes.gradient, nodes.volume)
        self.matrix = NodalMatrix(nodes.space, nodes.dofs)
        self.solver = LinearSolver(self.matrix.matrix, "fixed_values", "cg", "jacobi", 1e-10)

    def __call__(self, field, filled):
        """Field (owned cells, k) continued from the cells where ``filled`` is true into the empty ones."""
        nodes, m = self.nodes, self.nodes.dofs.shape[1]
        weight = np.where(filled, 1 + self.kappa, 1.0) * nodes.volume / m
        self.matrix.values.fill(0.0)
        self.matrix.add(self.stiffness + np.eye(m) * weight[:, None, None])
        self.matrix.assemble()
        self.solver.new_values()
        load = nodes.load(np.where(filled, 1 + self.kappa, 0.0)[:, None] * field)
        values = np.zeros((nodes.nodes, field.shape[1]))
        for k in range(field.shape[1]):
            values[:nodes.owned_nodes, k] = self.solver.solve(load[:nodes.owned_nodes, k], np.zeros(nodes.owned_nodes))
        out = nodes.means(nodes.node_halo.forward(values))
        return np.where(filled[:, None], field, out)


def _ritz(along, beside):
    """Eigenvalues of the tridiagonal matrix of Lanczos' method."""
    between = np.diag(beside[1:len(along)], 1)
    return np.linalg.eigvalsh(np.diag(along) + between + between.T)


def _max():
    from mpi4py import MPI
    return MPI.MAX
