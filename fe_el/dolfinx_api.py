"""dolfinx 0.5 (Debian 12), 0.9 (Debian 13) and 0.11 (wheels) behind one set of calls.

All that differs between them is in this file: no other file asks for a version. mpi4py is imported first, because the wheels
of dolfinx find their MPI through it.
"""
import importlib
import itertools
import os
import sys

import numpy as np

KNOWN = ((0, 5), (0, 9), (0, 11))


def _refuse(found):
    """Raise ``ImportError`` with one sentence that says what was found and what to do."""
    known = ", ".join(f"{major}.{minor}" for major, minor in KNOWN)
    raise ImportError(f"fe_el needs dolfinx ({known}) with a PETSc of real numbers, and found {found}; install Debian's "
                      "python3-dolfinx and use /usr/bin/python3, or, with Python 3.12 or later, pip install "
                      "dolfinx-solver-real.") from None


try:
    from mpi4py import MPI  # noqa: F401  # isort: skip
    import dolfinx
    from petsc4py import PETSc
except ImportError as error:
    _refuse(f"none ({error})")
VERSION = tuple(int(part) for part in dolfinx.__version__.split(".")[:2])
if VERSION not in KNOWN:
    _refuse(f"dolfinx {dolfinx.__version__}")
if np.issubdtype(PETSc.ScalarType, np.complexfloating):
    _refuse(f"dolfinx {dolfinx.__version__} with complex numbers")

import ufl  # noqa: E402
from dolfinx import cpp, fem, geometry, io  # noqa: E402
from dolfinx import mesh as dmesh  # noqa: E402

FOUND = {"dolfinx": dolfinx.__version__, "petsc": ".".join(map(str, PETSc.Sys.getVersion()))}  # by whatever name installed
OLD, NEW = VERSION < (0, 6), VERSION >= (0, 10)
if not OLD:
    import basix.ufl
    import dolfinx.fem.petsc


# -- meshes ------------------------------------------------------------------------------------------------------------
def create_mesh(comm, cells, x, destinations=None):
    """A mesh of triangles or tetrahedra with the cells across the facets between ranks as ghosts.

    Args:
        cells: (cells, d+1) vertex numbers of the cells that this rank hands in.
        x: (vertices, d) coordinates of the vertices that this rank hands in [m].
        destinations: function of the number of ranks that gives, for each of these cells, its owner and the ranks where it
            is a ghost, as one array, and the (cells + 1,) first entry of each; absent: dolfinx partitions by the graph of
            cells.

    Note:
        Collective.
    """
    cells, x = np.ascontiguousarray(cells, np.int64), np.ascontiguousarray(x, float)
    domain = ufl.Mesh(_coordinate_element(cells.shape[1] - 1))
    ghosts = dmesh.GhostMode.shared_facet  # none by default since 0.6: facets between ranks would look like boundaries
    if destinations is None:
        place = dmesh.create_cell_partitioner(*(() if OLD else (ghosts, 2) if NEW else (ghosts,)))
    else:
        place = lambda comm, ranks, *_: cpp.graph.AdjacencyList_int32(*destinations(ranks))
    if OLD:
        return dmesh.create_mesh(comm, cells, x, domain, ghost_mode=ghosts, partitioner=place)
    return dmesh.create_mesh(comm, cells, *((domain, x) if NEW else (x, domain)), place)


def _coordinate_element(dimension):
    kind = {2: "triangle", 3: "tetrahedron"}[dimension]
    if OLD:
        return ufl.VectorElement("Lagrange", kind, 1)
    return basix.ufl.element("Lagrange", kind, 1, shape=(dimension,))


def with_geometry(mesh, other):
    """A mesh with the topology of ``mesh`` and the geometry of ``other``, which has the same cells in the same order."""
    if OLD:
        return dmesh.Mesh(cpp.mesh.Mesh(mesh.comm, mesh.topology, other.geometry), mesh.ufl_domain())
    new = cpp.mesh.Mesh_float64(mesh.comm, mesh.topology._cpp_object, other.geometry._cpp_object)
    return dmesh.Mesh(new, mesh.ufl_domain())


def geometry_nodes(mesh):
    """(cells, d+1) rows of ``mesh.geometry.x`` that are the vertices of each cell, ghosts included."""
    if OLD:
        return mesh.geometry.dofmap.array.reshape(-1, mesh.topology.dim + 1)
    return mesh.geometry.dofmaps[0] if NEW else mesh.geometry.dofmap


def tags_by_vertices(mesh, dimension, entities, values):
    """Mesh tags of cells or facets that are given, each on one rank, by the vertex numbers with which the mesh was made.

    Note:
        Collective.
    """
    entities, values = io.utils.distribute_entity_data(mesh, dimension, np.asarray(entities, np.int64),
                                                       np.asarray(values, np.int32))
    mesh.topology.create_connectivity(dimension, 0)
    mesh.topology.create_connectivity(dimension, mesh.topology.dim)
    rows = cpp.graph.AdjacencyList_int32(np.ascontiguousarray(entities, np.int32))
    if OLD:
        tags = dmesh.meshtags_from_entities(mesh, dimension, rows, values)
        return dmesh.meshtags(mesh, dimension, tags.indices, tags.values)  # those of Python take attributes
    return dmesh.MeshTags(cpp.mesh.create_meshtags(mesh.topology._cpp_object, dimension, rows, values))


def is_of_mesh(thing, mesh):
    """Whether mesh tags or a Function belong to a mesh; true for what knows of none, such as an expression."""
    space = getattr(thing, "function_space", None)
    theirs = getattr(thing, "mesh", None) if space is None else space.mesh
    if theirs is mesh:
        return True
    theirs, topology = getattr(theirs or thing, "topology", None), mesh.topology
    return theirs is None or getattr(theirs, "_cpp_object", theirs) is getattr(topology, "_cpp_object", topology)


def cells_at(mesh, points):
    """A cell of this rank at each of the points (points, 3), one of those that touch it.

    Raises:
        IndexError: for a point in no cell.
    """
    if OLD:
        near = geometry.compute_collisions(geometry.BoundingBoxTree(mesh, mesh.topology.dim), points)
    else:
        near = geometry.compute_collisions_points(geometry.bb_tree(mesh, mesh.topology.dim), points)
    near = geometry.compute_colliding_cells(mesh, near, points)
    return np.array([near.links(k)[0] for k in range(len(points))], np.int32)


# -- function spaces ---------------------------------------------------------------------------------------------------
def scalar_space(mesh, family, degree):
    """Function space of a scalar: family "P" (continuous) or "DG", and its degree."""
    return fem.FunctionSpace(mesh, (family, degree)) if OLD else fem.functionspace(mesh, (family, degree))


def vector_space(mesh, family, degree):
    """Function space of a vector with as many components as the space has dimensions: family "P" or "DG", and its degree."""
    if OLD:
        return fem.VectorFunctionSpace(mesh, (family, degree))
    return fem.functionspace(mesh, (family, degree, (mesh.geometry.dim,)))


def taylor_hood_space(mesh):
    """Mixed space of a velocity P2 and a pressure P1."""
    if OLD:
        cell = mesh.ufl_cell()
        return fem.FunctionSpace(mesh, ufl.MixedElement(ufl.VectorElement("P", cell, 2), ufl.FiniteElement("P", cell, 1)))
    cell = mesh.basix_cell()
    velocity = basix.ufl.element("P", cell, 2, shape=(mesh.geometry.dim,))
    return fem.functionspace(mesh, basix.ufl.mixed_element([velocity, basix.ufl.element("P", cell, 1)]))


def element_of(space):
    """Family of a function space, "P" (continuous Lagrange), "DG" or another word, and its degree."""
    element = space.ufl_element()
    if OLD:
        family, degree = element.family(), element.degree()
        return {"Lagrange": "P", "Discontinuous Lagrange": "DG"}.get(family, family), degree
    family = element.family_name
    return "DG" if family == "P" and element.discontinuous else family, element.embedded_superdegree


def dof_table(space):
    """(cells, n) numbers of the degrees of freedom of each cell, ghosts included; the components of a vector share one."""
    table = space.dofmap.list
    return table.array.reshape(-1, space.dofmap.dof_layout.num_dofs) if OLD else table


def interpolation_points(space):
    """Points of the reference cell at which the space interpolates."""
    points = space.element.interpolation_points
    return points if NEW else points()


# -- PETSc -------------------------------------------------------------------------------------------------------------
_problems = itertools.count()


def linear_problem(a, L, bcs, solution, options):
    """``dolfinx.fem.petsc.LinearProblem``: its ``solve()`` assembles and solves a = L into ``solution``.

    Args:
        a, L: UFL forms.
        bcs: list of Dirichlet conditions.
        options (dict): PETSc options of the solver.
    """
    prefix = {"petsc_options_prefix": f"fe_el_problem_{next(_problems)}_"} if NEW else {}
    return fem.petsc.LinearProblem(a, L, bcs=bcs, u=solution, petsc_options=options, **prefix)


def petsc_vector(function):
    """The PETSc vector that shares the memory of a Function."""
    return function.vector if OLD else function.x.petsc_vec


# -- HDF5 --------------------------------------------------------------------------------------------------------------
def import_h5py():
    """The module h5py, which finds its own HDF5 first.

    ``dolfinx.fem.petsc`` of the wheels opens PETSc for all libraries that are loaded later (for users of numba), and with it
    another HDF5, with which h5py cannot be imported.
    """
    flags = sys.getdlopenflags()
    sys.setdlopenflags(flags | getattr(os, "RTLD_DEEPBIND", 0))
    try:
        return importlib.import_module("h5py")
    finally:
        sys.setdlopenflags(flags)
