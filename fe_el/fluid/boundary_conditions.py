"""Boundary conditions of the fluid: facets and nodes of the tagged groups, and their values."""
import numpy as np

from fe_el.checks import require_positive
from fe_el.fluid import node_kernels
from fe_el.mesh import require_groups


class BoundaryFacets:
    """Owned boundary facets of one group.

    Attributes:
        cell, local: owned cell and its vertex opposite the facet.
        area_normal: (facets, d) outward normal times area [m^2].
        centre: (facets, 3) [m].
        points: (d, facets, 3) of a quadrature with equal weights, exact for parabolic profiles [m].
        nodes: local numbers of the P1 nodes on the group (on every rank that has them).
        number: facets of the group at each of these nodes, on all ranks.
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
        at = corner[self.cell[:, None], keep]
        self.centre = at.mean(1)
        pull = 1 / 3 ** 0.5 if d == 2 else 0.5  # how far the points lie from the centre towards the vertices
        self.points = np.stack([self.centre + pull * (at[:, k] - self.centre) for k in range(d)])
        number = np.zeros(num_nodes)
        self.add_to_nodes(np.ones(len(self.cell)), number)
        node_halo.complete(number)
        self.nodes = np.flatnonzero(number)
        self.number = number[self.nodes]

    def add_to_nodes(self, values, total):
        """Add one value for each facet of this rank to each of its nodes, in ``total`` (nodes,)."""
        node_kernels.add_to_nodes(self.facet_nodes, values, total)


def volume_flux(facets, value, time, dimension):
    """Volume per time that leaves through each facet with a velocity value [m^3/s]."""
    mean = sum(velocity_at(value, time, at, dimension) for at in facets.points) / dimension
    return (mean * facets.area_normal).sum(1)


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


def ramp(value, duration):
    """Velocity of an inlet that rises smoothly from zero to ``value`` within ``duration`` [s].

    Args:
        value: d numbers, or a function (time, position).

    Raises:
        ValueError: for a duration that is not positive.
    """
    require_positive("duration of the ramp", duration)

    def rising(time, position):
        s = min(max(time / duration, 0.0), 1.0)
        return s * s * (3 - 2 * s) * np.asarray(value(time, position) if callable(value) else value, float)
    return rising


class Boundaries:
    """Boundary conditions of a fluid on tagged facets: what is set, and the values at its nodes at each step."""

    def boundary(self, group):
        """Facets and nodes of a boundary group."""
        if self.facet_tags is None:
            raise ValueError(f"Boundary group {group} was named, but no facet_tags were given; pass facet_tags=.")
        if group not in self._facets:
            self._facets[group] = BoundaryFacets(self.mesh, self.facet_tags, group, self.dofs, self.corner, self.gradient,
                                                 self.volume, self.node_halo, self.nodes)
        return self._facets[group]

    def set_velocity(self, group, value):
        """Superficial velocity on an inlet: d numbers, or a function (time, position (points, 3)) -> (points, d)."""
        facets = self.boundary(group)
        velocity_at(value, 0.0, facets.centre, self.dimension)
        self.inlets.append((facets, value))
        self.ready = False

    def set_pressure(self, group, value=0.0):
        """Pressure on an outlet [Pa]: a number or a function of time. Fluid may enter there without bringing energy."""
        if not callable(value) and not np.isfinite(value):
            raise ValueError(f"The pressure is {value}; it must be finite [Pa].")
        self.outlets.append((self.boundary(group), value))
        self.ready = False

    def set_no_slip(self, group):
        """No-slip wall."""
        self.no_slip.append(self.boundary(group))
        self.ready = False

    def set_slip(self, group):
        """Slip wall: no flow through it and no friction."""
        facets = self.boundary(group)
        normal = np.zeros((self.nodes, self.dimension))
        np.add.at(normal, facets.facet_nodes, facets.area_normal[:, None])
        self.node_halo.complete(normal)
        length = np.linalg.norm(normal, axis=1)
        self.slip.append((facets.nodes, (normal / np.maximum(length, 1e-300)[:, None])[facets.nodes]))
        self.ready = False

    def check_inflow(self):
        """Raise ``ValueError`` if a domain without outlet is given a net inflow."""
        net = sum(volume_flux(f, v, 0.0, self.dimension).sum() for f, v in self.inlets)
        total = sum(np.linalg.norm(velocity_at(v, 0.0, f.centre, self.dimension), axis=1)
                    @ np.linalg.norm(f.area_normal, axis=1) for f, v in self.inlets)
        net, total = self.comm.allreduce(float(net)), self.comm.allreduce(float(total))
        if abs(net) > 1e-9 * max(total, 1e-300):
            raise ValueError(f"The inlets let {-net:g} m^3/s into a domain without outlet; add set_pressure(group).")

    def set_boundary_values(self, phi):
        """Interstitial velocities of the fixed nodes at the new time; walls win over inlets. ``phi`` None: one, on all ranks."""
        d, constant = self.dimension, phi is None and not any(callable(value) for _, value in self.inlets)
        if constant and self._values_set:
            return
        self._values_set = constant
        for facets, value in self.inlets:
            k, ratio = facets.nodes, 1.0
            if phi is not None:
                void = self.work.zeros("void", self.nodes)
                facets.add_to_nodes(phi[facets.cell], void)
                self.node_halo.complete(void)
                ratio = (facets.number / void[k])[:, None]
            self.boundary_velocity[k] = velocity_at(value, self.time, self.node_position[k], d) * ratio
        for facets in self.no_slip:
            self.boundary_velocity[facets.nodes] = 0.0

    def inflow_at(self, time):
        """Volume per time that the inlets let in, on the nodes of owned facets [m^3/s]; the same memory each time."""
        def add(steady, total):
            for facets, value in self.inlets:
                if callable(value) != steady:
                    facets.add_to_nodes(-volume_flux(facets, value, time, self.dimension) / self.dimension, total)
        if self._steady_inflow is None:
            self._steady_inflow = self.nodal_zeros(())
            add(True, self._steady_inflow)
        total = self.work.empty("inflow", self.nodes)
        total[:] = self._steady_inflow
        add(False, total)
        return total

    def impose(self, u):
        """Give the fixed nodes their velocities, and take the normal part from slip walls, in place."""
        node_kernels.impose(u, self.slip_nodes, self.slip_normals, self.held, self.boundary_velocity)

    def boundary_force(self, group):
        """Force of the fluid on a no-slip boundary group, by pressure and by shear: two arrays (d,) [N].

        The shear is what the nodes of the wall need to keep their velocity, so the two balance the fluid's momentum exactly.
        Call it after :meth:`advance`. Nodes that two groups share count for both.
        """
        facets, d, own = self.boundary(group), self.dimension, self.owned_nodes
        p = self.pressure.x.array[facets.facet_nodes].mean(1) if len(facets.cell) else np.zeros(0)
        pressure = (p[:, None] * facets.area_normal).sum(0).reshape(d)
        nodes = facets.nodes[facets.nodes < own]
        return self.comm.allreduce(pressure), self.comm.allreduce(-self.reaction[nodes].sum(0))
