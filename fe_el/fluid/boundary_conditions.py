"""Boundary conditions of the fluid: facets and nodes of the tagged groups, and their values."""
import numpy as np

from fe_el.mesh import require_groups


class BoundaryFacets:
    """Owned boundary facets of one group.

    Attributes:
        cell, local: owned cell and its vertex opposite the facet.
        area_normal: (facets, d) outward normal times area [m^2].
        centre: (facets, 3) [m].
        nodes: local numbers of the P1 nodes on the group (on every rank that has them).
    """

    def __init__(self, mesh, facet_tags, group, dofs, corner, gradient, volume, node_halo, num_nodes):
        require_groups(mesh, facet_tags, group)
        d = mesh.topology.dim
        mesh.topology.create_connectivity(d - 1, d)
        mesh.topology.create_connectivity(d, d - 1)
        to_cell, to_facet = mesh.topology.connectivity(d - 1, d), mesh.topology.connectivity(d, d - 1)
        rows = []
        for facet in facet_tags.indices[facet_tags.values == group]:
            cells = to_cell.links(facet)
            if len(cells) == 1 and cells[0] < len(corner):
                rows.append((cells[0], int(np.flatnonzero(to_facet.links(cells[0]) == facet)[0])))
        rows = np.array(rows, np.int64).reshape(-1, 2)
        self.cell, self.local = rows[:, 0].copy(), rows[:, 1].copy()
        # |grad of the opposite basis function| = area / (d volume)
        self.area_normal = -gradient[self.cell, self.local] * (d * volume[self.cell])[:, None]
        keep = np.array([[v for v in range(d + 1) if v != f] for f in range(d + 1)])[self.local]
        self.facet_nodes = dofs[self.cell[:, None], keep]
        self.centre = corner[self.cell[:, None], keep].mean(1)
        mark = np.zeros(num_nodes)
        mark[self.facet_nodes] = 1.0
        node_halo.forward(node_halo.reverse_add(mark))
        self.nodes = np.flatnonzero(mark > 0)


def velocity_at(value, time, position, dimension):
    """Velocity (points, d) from a constant or a function ``value(time, position (points, 3))``.

    Raises:
        ValueError: if it has the wrong shape or is not finite.
    """
    v = np.asarray(value(time, position) if callable(value) else value, float)
    try:
        v = np.broadcast_to(v, (len(position), dimension))
    except ValueError:
        raise ValueError(f"The velocity has shape {v.shape}; give {dimension} numbers, or a function (time, position) "
                         f"that returns an array (points, {dimension}).") from None
    if not np.isfinite(v).all():
        raise ValueError(f"The boundary velocity at time {time:g} is not finite; give finite numbers [m/s].")
    return v
