"""From a dolfinx mesh to plain arrays: cell geometry, neighbours and the halo of cells of other ranks."""
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from fe_el.dolfinx_api import geometry_nodes
from fe_el.parallel.exchange import Halo


class CellMesh(NamedTuple):
    """Cells known to this rank: the owned ones first, in dolfinx's order, then the halo.

    Vectors have three components; in two dimensions the third is zero. Facet f of a cell lies opposite vertex f.
    """

    corner: np.ndarray      #: (cells, d+1, 3) vertex coordinates of each cell [m]
    barycentric: np.ndarray  #: (cells, d+1, 4): coordinate f of a point x is b[:3] . x + b[3]; b[:3] = grad of P1 basis f
    neighbour: np.ndarray   #: (cells, d+1) cell across facet f, or -1
    shift: np.ndarray       #: (cells or 0, d+1, 3) added to a point that crosses facet f (periodic meshes) [m]
    volume: np.ndarray      #: (cells,) volume, in two dimensions area times thickness [m^3]
    vertex: np.ndarray      #: (cells, d+1) global vertex numbers
    vertex_cells: np.ndarray  #: cells at each local vertex, concatenated
    vertex_start: np.ndarray  #: (vertices + 1,) first entry of each vertex in ``vertex_cells``
    local_vertex: np.ndarray  #: (cells, d+1) index into ``vertex_start``
    owned: int              #: number of owned cells


def check_simplices(mesh):
    """Raise ``ValueError`` unless the cells are triangles or tetrahedra that fill their space, with ghosts between ranks.

    Note:
        Collective.
    """
    name, d = mesh.topology.cell_name(), mesh.topology.dim
    if name not in ("triangle", "tetrahedron"):
        raise ValueError(f"The mesh has cells of type {name}; fe_el needs triangles (2D) or tetrahedra (3D). "
                         "Mesh the geometry with simplices (gmsh does by default: remove Recombine).")
    if mesh.geometry.dim != d:
        raise ValueError(f"The mesh has {name} cells in {mesh.geometry.dim} dimensions; read it with gdim={d}.")
    ghosts, shared = mesh.comm.allreduce(np.array([mesh.topology.index_map(k).num_ghosts for k in (d, 0)]))
    if shared and not ghosts:  # facets between ranks would be taken for boundaries
        raise ValueError("The mesh has no ghost cells between its ranks; make it with "
                         "create_cell_partitioner(GhostMode.shared_facet), or by fe_el.read_mesh, mesh_geo or box.")


def owned_corners(mesh):
    """Vertex coordinates (cells, d+1, 3) and global vertex numbers (cells, d+1) of the owned cells."""
    d = mesh.topology.dim
    n = mesh.topology.index_map(d).size_local
    corner = mesh.geometry.x[geometry_nodes(mesh)[:n]]
    local = mesh.topology.connectivity(d, 0).array.reshape(-1, d + 1)[:n]
    vertex = mesh.topology.index_map(0).local_to_global(local.ravel().astype(np.int32)).reshape(n, d + 1)
    return corner.copy(), vertex.astype(np.int64)


def barycentric_maps(corner, dimension):
    """Affine maps to barycentric coordinates (cells, d+1, 4) and the cell measures (cells,)."""
    d = dimension
    edges = corner[:, 1:, :d] - corner[:, :1, :d]
    measure = np.abs(np.linalg.det(edges)) / (2 if d == 2 else 6)
    if len(measure) and not measure.min() > 0:
        cell = int(np.argmin(measure))
        raise ValueError(f"Cell {cell} of the mesh has measure {measure[cell]:g}; every cell needs a positive one. "
                         "Remove flat or duplicate cells (gmsh: Optimize).")
    inverse = np.linalg.inv(np.transpose(edges, (0, 2, 1)))
    b = np.zeros((len(corner), d + 1, 4))
    b[:, 1:, :d] = inverse
    b[:, 0, :d] = -inverse.sum(1)
    b[:, :, 3] = -np.einsum("cfk,ck->cf", b[:, :, :3], corner[:, 0])
    b[:, 0, 3] += 1
    return b, measure


def facet_neighbours(corner, vertex):
    """Cell and facet across each facet: (cells, d+1) arrays, -1 at the boundary."""
    n, m = vertex.shape
    keys = np.stack([np.sort(np.delete(vertex, f, 1), 1) for f in range(m)], 1).reshape(n * m, m - 1)
    order = np.lexsort(keys.T)
    same = np.flatnonzero((keys[order[1:]] == keys[order[:-1]]).all(1))
    a, b = order[same], order[same + 1]
    other = np.full(n * m, -1, np.int64)
    other[a], other[b] = b, a
    cell = np.where(other >= 0, other // m, -1).reshape(n, m).astype(np.int32)
    return cell, np.where(other >= 0, other % m, -1).reshape(n, m)


def _facet_shifts(corner, vertex, neighbour, facet):
    """Difference of the coordinates of a shared facet as its two cells see it: zero unless the mesh is periodic."""
    n, m = vertex.shape
    total = corner.sum(1)
    centre = (total[:, None] - corner) / (m - 1)
    across = centre[neighbour, facet]
    shift = np.where((neighbour >= 0)[:, :, None], across - centre, 0.0)
    scale = np.abs(corner[:, 1:] - corner[:, :1]).max() if n else 1.0
    shift[np.abs(shift) < 1e-9 * scale] = 0.0
    return shift if shift.any() else np.zeros((0, m, 3))


def _halo_cells(comm, corner, width, period):
    """Owner rank and remote index of the cells of other ranks within ``width`` of ours."""
    centre = corner.mean(1)
    radius = np.sqrt(((corner - centre[:, None]) ** 2).sum(2).max(1)) if len(corner) else np.zeros(0)
    everything = comm.allgather((centre, radius))
    owners, remote = [], []
    box = period if period is not None and np.any(period) else None
    fold = (lambda x: np.where(period > 0, x % np.where(period > 0, period, 1), x)) if box is not None else (lambda x: x)
    tree = cKDTree(fold(centre), boxsize=box)
    for rank, (c, r) in enumerate(everything):
        if rank == comm.rank or not len(c) or not len(centre):
            continue
        reach = width + r + radius.max()
        near = np.flatnonzero(tree.query(fold(c), distance_upper_bound=reach.max())[0] <= reach)
        owners.append(np.full(len(near), rank))
        remote.append(near)
    if not owners:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    return np.concatenate(owners), np.concatenate(remote)


def cell_mesh(mesh, halo_width=0.0, thickness=1.0, period=None):
    """Plain arrays of the cells of this rank and of all cells of other ranks within ``halo_width`` of them.

    Args:
        mesh: dolfinx mesh of triangles or tetrahedra.
        halo_width (float): how far the halo reaches beyond the owned cells [m].
        thickness (float): depth of a two-dimensional mesh [m].
        period (array): lengths of a periodic box, zero where it is not periodic [m].

    Returns:
        (CellMesh, Halo): the arrays, and the exchange of cell values between owners and halo.

    Raises:
        ValueError: for cells that are not simplices, or flat ones.

    Note:
        Collective.
    """
    check_simplices(mesh)
    comm, d = mesh.comm, mesh.topology.dim
    corner, vertex = owned_corners(mesh)
    owned = len(corner)
    halo = Halo(comm, [[]] * comm.size, [[]] * comm.size)
    if comm.size > 1:
        owners, remote = _halo_cells(comm, corner, halo_width, period)
        halo = Halo.of_requests(comm, owned + np.arange(len(owners)), owners, remote)
        extra = len(owners)
        corner = halo.forward(np.concatenate([corner, np.zeros((extra,) + corner.shape[1:])]))
        vertex = halo.forward(np.concatenate([vertex, np.zeros((extra, d + 1), np.int64)]))
    barycentric, measure = barycentric_maps(corner, d)
    lower, upper = comm.allgather(corner.min((0, 1))), comm.allgather(corner.max((0, 1)))
    size = np.max(np.max(upper, 0) - np.min(lower, 0))
    # points are located as if moved by this much: a point on a facet is in the same cell whatever the order of the cells
    barycentric[:, :, 3] += barycentric[:, :, :3] @ (1e-12 * size * np.array([1.0, 0.618, 0.382]))
    neighbour, facet = facet_neighbours(corner, vertex)
    unique, local = np.unique(vertex.ravel(), return_inverse=True)
    order = np.argsort(local, kind="stable")
    start = np.concatenate([[0], np.cumsum(np.bincount(local, minlength=len(unique)))])
    arrays = CellMesh(corner, barycentric, neighbour, _facet_shifts(corner, vertex, neighbour, facet),
                      measure * (thickness if d == 2 else 1.0), vertex, (order // (d + 1)).astype(np.int32),
                      start.astype(np.int64), local.reshape(-1, d + 1).astype(np.int32), owned)
    return arrays, halo


def boundary_facets(mesh, facet_tags, groups):
    """Corners (facets, d, 3), vertex numbers (facets, d) and group (facets,) of the tagged boundary facets, on every rank.

    They are ordered by place, so that the order does not depend on the ranks.

    Raises:
        ValueError: if a group has no facet.

    Note:
        Collective.
    """
    d = mesh.topology.dim
    groups = require_groups(mesh, facet_tags, groups)
    refuse_inner_facets(mesh, facet_tags, groups)
    mesh.topology.create_connectivity(d, d - 1)
    to_cell, to_facet = mesh.topology.connectivity(d - 1, d), mesh.topology.connectivity(d, d - 1)
    corner, vertex = owned_corners(mesh)
    rows = []
    for facet, tag in zip(facet_tags.indices, facet_tags.values):
        cells = to_cell.links(facet)
        if tag in groups and len(cells) == 1 and cells[0] < len(corner):
            local = int(np.flatnonzero(to_facet.links(cells[0]) == facet)[0])
            rows.append((cells[0], local, tag))
    rows = np.array(rows, np.int64).reshape(-1, 3)
    keep = np.array([[v for v in range(d + 1) if v != f] for f in range(d + 1)])
    pick = keep[rows[:, 1]]
    parts = mesh.comm.allgather((corner[rows[:, :1], pick], vertex[rows[:, :1], pick], rows[:, 2]))
    corners, vertices, groups = (np.concatenate([p[i] for p in parts]) for i in range(3))
    order = by_place(corners.mean(1))
    return corners[order], vertices[order], groups[order]


def by_place(x):
    """Order of points (points, 3) by their coordinates, to a billionth of their extent."""
    return np.lexsort(np.round((x - x.min(0)) / np.ptp(x, 0).max() * 1e9).T[::-1]) if len(x) > 1 else np.arange(len(x))


def exterior_facets(mesh, facet_tags, groups):
    """Corners (facets, d, 3) of all boundary facets, and whether each is in one of the groups, on every rank.

    Note:
        Collective.
    """
    d = mesh.topology.dim
    mesh.topology.create_connectivity(d - 1, d)
    mesh.topology.create_connectivity(d, d - 1)
    to_cell, to_facet = mesh.topology.connectivity(d - 1, d), mesh.topology.connectivity(d, d - 1)
    corner, _ = owned_corners(mesh)
    chosen = set(facet_tags.indices[np.isin(facet_tags.values, groups)].tolist())
    corners, flags = [], []
    for facet in range(mesh.topology.index_map(d - 1).size_local):
        cells = to_cell.links(facet)
        if len(cells) == 1 and cells[0] < len(corner):
            local = int(np.flatnonzero(to_facet.links(cells[0]) == facet)[0])
            corners.append(np.delete(corner[cells[0]], local, 0))
            flags.append(facet in chosen)
    parts = mesh.comm.allgather((np.array(corners).reshape(-1, d, 3), np.array(flags, bool)))
    return np.concatenate([c for c, _ in parts]), np.concatenate([f for _, f in parts])


def refuse_inner_facets(mesh, facet_tags, groups):
    """Raise ``ValueError`` on every rank if a group has facets between two cells: they are no boundary.

    Note:
        Collective.
    """
    d = mesh.topology.dim
    mesh.topology.create_connectivity(d - 1, d)
    count = np.diff(mesh.topology.connectivity(d - 1, d).offsets)
    for group in groups:
        number = mesh.comm.allreduce(int((count[facet_tags.indices[facet_tags.values == group]] > 1).sum()))
        if number:
            raise ValueError(f"Boundary group {group} has facets between two cells ({number}, those between ranks counted "
                             f"by each); walls, "
                             "inlets and outlets are outer facets. Tag outer facets alone, or cut the mesh open along the "
                             "group (gmsh: "
                             "Plugin Crack).")


def group_numbers(facet_tags, groups):
    """One or several groups, by number or by their names in gmsh, as a tuple of int.

    Raises:
        ValueError: for a name that no group has, or anything but whole numbers and names.
    """
    names, out = getattr(facet_tags, "names", {}), []
    for group in [groups] if np.ndim(groups) == 0 else groups:
        if isinstance(group, str) and group in names:
            out.append(names[group])
        elif isinstance(group, (int, np.integer)) and not isinstance(group, bool):
            out.append(int(group))
        else:
            known = f"one of its names, {sorted(names)}" if names else "the tag of a boundary group (it has no names)"
            raise ValueError(f"The boundary group is {group!r}; give a whole number or {known}.")
    if not out:
        raise ValueError(f"The boundary groups are {groups!r}; give at least one.")
    return tuple(out)


def require_groups(mesh, facet_tags, groups):
    """The groups as a tuple of int, after checking that each has a facet on some rank."""
    groups = group_numbers(facet_tags, groups)
    present = sorted(set().union(*mesh.comm.allgather(set(np.unique(facet_tags.values).tolist()))))
    for group in groups:
        if group not in present:
            raise ValueError(f"The mesh has no boundary group {group}; it has {present}. "
                             "Use one of these, or tag the facets (gmsh: Physical Surface).")
    return groups
