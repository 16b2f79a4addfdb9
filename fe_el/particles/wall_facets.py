"""Which facets of the cells belong to which of a list of walls."""
import numpy as np

from fe_el.mesh.cell_mesh import refuse_inner_facets, require_groups
from fe_el.particles.contacts.wall_shapes import FACETS


def walls_of_facets(mesh, cells, halo, walls):
    """(cells, d + 1) number of the wall that each facet of owned and halo cells belongs to, or -1.

    Raises:
        ValueError: for a group without facets or with facets between cells.

    Note:
        Collective.
    """
    d, out = mesh.topology.dim, np.full((len(cells.volume), mesh.topology.dim + 1), -1, np.int32)
    mesh.topology.create_connectivity(d - 1, d)
    mesh.topology.create_connectivity(d, d - 1)
    to_cell, to_facet = mesh.topology.connectivity(d - 1, d), mesh.topology.connectivity(d, d - 1)
    for number, wall in enumerate(walls):
        if wall.kind != FACETS:
            continue
        groups = require_groups(mesh, wall.facet_tags, wall.groups)
        refuse_inner_facets(mesh, wall.facet_tags, groups)
        facet = wall.facet_tags.indices[np.isin(wall.facet_tags.values, groups)]
        cell = to_cell.array[to_cell.offsets[facet]]
        facet, cell = facet[cell < cells.owned], cell[cell < cells.owned]
        out[cell, np.argmax(to_facet.array.reshape(-1, d + 1)[cell] == facet[:, None], axis=1)] = number
    return halo.forward(out)


def facets_at_nodes(space, cells, facet_wall):
    """Nodes (facets, d) of this rank's wall facets, the outward area of each of their corners (facets, d) [m^2], and their
    walls (facets,)."""
    d = space.dimension
    cell, facet = np.nonzero(facet_wall[:cells.owned] >= 0)
    area_normal = -space.gradient[cell, facet] * cells.volume[cell, None]  # d volume / height, over d corners
    corner = np.array([[v for v in range(d + 1) if v != f] for f in range(d + 1)])[facet].reshape(-1, d)
    return space.dofs[cell[:, None], corner], area_normal, facet_wall[cell, facet]
