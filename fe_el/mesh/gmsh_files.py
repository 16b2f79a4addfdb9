"""Meshes from gmsh's files, with the numbers of their physical groups."""
import importlib
import re
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI

from fe_el.checks import finite_number, positive_number
from fe_el.dolfinx_api import tags_by_vertices
from fe_el.mesh.partition import Balance, create_mesh
from fe_el.parallel.failures import end_all_ranks_on_errors

if TYPE_CHECKING:
    from dolfinx.mesh import Mesh


def import_gmsh() -> Any:
    """The module gmsh.

    Raises:
        ImportError: where it is missing, or its wheel does not find libraries of a screen, which it always wants.
    """
    try:
        return importlib.import_module("gmsh")
    except (ImportError, OSError) as error:
        raise ImportError(f"Meshes of gmsh need its Python module, which cannot be loaded ({error}); install Debian's "
                          "python3-gmsh, or pip install gmsh and, on Debian and Ubuntu, apt-get install libgl1 "
                          "libglu1-mesa libxcursor1 libxft2 libxinerama1 libgomp1.") from None


def read_mesh(path: str | Path, comm: MPI.Comm = MPI.COMM_WORLD, dimension: int = 3, slices_along: int | None = None,
              scale: float = 1.0, balance: Balance = None) -> "tuple[Mesh, Any, Any]":
    """Read a gmsh ``.msh`` file with physical groups: (mesh, cell tags, facet tags).

    ``slices_along`` (0, 1 or 2) gives every rank a slice across that axis; absent: dolfinx partitions by the graph of cells.
    ``balance``, places of the particles (particles, 2 or 3) [m] or a checkpoint that holds them, gives every rank as much
    work with cells and particles; absent: as if there were none.
    ``scale`` multiplies all coordinates: 0.001 for a mesh in millimetres. Names that gmsh has for groups stand for their
    numbers wherever facet tags and groups are taken; ``facet_tags.names`` holds them.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: for a file that gmsh cannot read, cells that are not simplices, or cells that are not in exactly one
            group.
    """
    gmsh = import_gmsh()
    end_all_ranks_on_errors(comm)
    scale, dimension = positive_number("scale of the mesh", scale), _dimension(dimension)
    if not isinstance(path, (str, Path)):
        raise ValueError(f"The path of a mesh is {path!r}; give the name of a gmsh .msh file.")
    if not Path(path).is_file():
        raise FileNotFoundError(f"There is no mesh file {path}; give the path of a gmsh .msh file.")
    message = None
    if comm.rank == 0:
        gmsh.initialize()
        gmsh.option.setNumber("General.Terminal", 0)
        try:
            gmsh.open(str(path))
        except Exception as error:  # gmsh raises nothing narrower
            message = f"gmsh cannot read {path}: {error}; give a .msh file that gmsh wrote."
    _end_if(gmsh, comm, message)
    return _from_gmsh(gmsh, comm, dimension, (slices_along, balance), scale)


def mesh_geo(path: str | Path, comm: MPI.Comm = MPI.COMM_WORLD, dimension: int = 3, slices_along: int | None = None,
             balance: Balance = None, **parameters: float) -> "tuple[Mesh, Any, Any]":
    """Mesh a gmsh ``.geo`` file with the given values of its parameters: (mesh, cell tags, facet tags).

    ``slices_along`` and ``balance`` as of :func:`read_mesh`.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: for a parameter that the file does not define in ``DefineConstant``, or cells that are not simplices.
    """
    gmsh = import_gmsh()
    end_all_ranks_on_errors(comm)
    dimension = _dimension(dimension)
    parameters = {name: finite_number(f"parameter {name} of the geometry", value) for name, value in parameters.items()}
    if not isinstance(path, (str, Path)):
        raise ValueError(f"The path of a geometry is {path!r}; give the name of a gmsh .geo file.")
    if not Path(path).is_file():
        raise FileNotFoundError(f"There is no geometry file {path}; give the path of a gmsh .geo file.")
    blocks = re.findall(r"DefineConstant\s*\[(.*?)\]", Path(path).read_text(), re.DOTALL)
    known = sorted(set(re.findall(r"(\w+)\s*=", " ".join(blocks))))
    for name in parameters:
        if name not in known:
            raise ValueError(f"{Path(path).name} has no parameter {name!r}; it has {', '.join(known) or 'none'}.")
    if comm.rank == 0:
        gmsh.initialize(["fe_el", "-v", "0"])
        with tempfile.TemporaryDirectory() as folder:  # numbers on gmsh's command line would stay in force until Python ends
            lines = [f"{name} = {value!r};\n" for name, value in parameters.items()]
            (Path(folder) / "scene.geo").write_text("".join(lines) + f'Include "{Path(path).resolve()}";\n')
            gmsh.open(str(Path(folder) / "scene.geo"))
        gmsh.model.mesh.generate(dimension)
    return _from_gmsh(gmsh, comm, dimension, (slices_along, balance))


def _dimension(value):
    """2 or 3."""
    if not isinstance(value, int) or value not in (2, 3):
        raise ValueError(f"The dimension of the mesh is {value!r}; it must be 2 or 3.")
    return value


def _end_if(gmsh, comm, message):
    """Close gmsh and raise ``ValueError`` on every rank if rank 0 has a message. Collective."""
    message = comm.bcast(message)
    if message:
        if comm.rank == 0:
            gmsh.finalize()
        raise ValueError(message)


def _fault(gmsh, dimension):
    """What makes gmsh's present model no mesh for fe_el, in a sentence; ``None``: nothing."""
    model, wanted = gmsh.model, {2: "Triangle 3", 3: "Tetrahedron 4"}[dimension]
    kinds = [model.mesh.getElementProperties(k)[0] for k in model.mesh.getElementTypes(dimension)]
    if any(k != wanted for k in kinds) or not kinds:
        return (f"The mesh has cells of type {', '.join(kinds) or 'none'}; fe_el needs {wanted} (first-order simplices). "
                f"Mesh again "
                f"in {dimension} dimensions, without Recombine and with ElementOrder 1, or give another dimension=.")
    what = {2: "Surface", 3: "Volume"}[dimension]
    for _, tag in model.getEntities(dimension):
        groups = model.getPhysicalGroupsForEntity(dimension, tag)
        if len(groups) != 1:
            return (f"{what} {tag} is in {len(groups)} physical groups ({', '.join(map(str, groups)) or 'none'}); every "
                    f"{what.lower()} "
                    f"needs exactly one (gmsh: Physical {what}).")
    if dimension == 2:
        z = np.asarray(model.mesh.getNodes()[1])[2::3]
        if len(z) and np.ptp(z) > 1e-9 * max(np.abs(model.mesh.getNodes()[1]).max(), 1e-300):
            return "The two-dimensional mesh does not lie in a plane of constant z; turn it into the x-y plane."
    return None


def _elements(model, dimension, number):
    """Vertices (elements, dimension+1) as ``number`` says, and physical group (elements,), of gmsh's elements."""
    vertices, groups = [np.zeros((0, dimension + 1), np.int64)], [np.zeros(0, np.int32)]
    for _, group in model.getPhysicalGroups(dimension):
        for entity in model.getEntitiesForPhysicalGroup(dimension, group):
            for nodes in model.mesh.getElements(dimension, entity)[2]:
                vertices.append(number[np.asarray(nodes, np.int64)].reshape(-1, dimension + 1))
                groups.append(np.full(len(vertices[-1]), group, np.int32))
    return np.concatenate(vertices), np.concatenate(groups)


def _from_gmsh(gmsh, comm, dimension, parts, scale=1.0):
    """The mesh of gmsh's present model on rank 0, which is closed. Collective."""
    _end_if(gmsh, comm, _fault(gmsh, dimension) if comm.rank == 0 else None)
    d = dimension
    x, cells, facets = np.zeros((0, d)), np.zeros((0, d + 1), np.int64), np.zeros((0, d), np.int64)
    cell_groups = facet_groups = np.zeros(0, np.int32)
    names = None
    if comm.rank == 0:
        tags, points, _ = gmsh.model.mesh.getNodes()
        order = np.argsort(tags)
        x, number = points.reshape(-1, 3)[order, :d], np.zeros(int(tags.max()) + 1, np.int64)
        number[tags[order]] = np.arange(len(tags))
        cells, cell_groups = _elements(gmsh.model, d, number)
        facets, facet_groups = _elements(gmsh.model, d - 1, number)
        names = {gmsh.model.getPhysicalName(d, tag): tag for d, tag in gmsh.model.getPhysicalGroups(d - 1)}
        gmsh.finalize()
    mesh = create_mesh(comm, cells, scale * x, *parts)
    facet_tags = tags_by_vertices(mesh, d - 1, facets, facet_groups)
    facet_tags.names = {name: tag for name, tag in comm.bcast(names).items() if name}
    return mesh, tags_by_vertices(mesh, d, cells, cell_groups), facet_tags
