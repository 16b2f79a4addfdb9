"""Boundary conditions of the fluid: facets and nodes of the tagged groups, and their values."""
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from fe_el.checks import function_or_class_of, number_or_function
from fe_el.fluid import cell_kernels, node_kernels
from fe_el.fluid.boundary_values import velocity_at, volume_flux
from fe_el.fluid.cell_node_fluid import CellNodeFluid
from fe_el.fluid.state import StepState
from fe_el.fluid.walls import WallFriction, held_directions
from fe_el.mesh.cell_mesh import group_numbers, refuse_inner_facets, require_groups
from fe_el.nodes import nodal_kernels
from fe_el.parallel.exchange import raise_everywhere, sums_of


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
        refuse_inner_facets(mesh, facet_tags, (group,))
        d = mesh.topology.dim
        mesh.topology.create_connectivity(d, d - 1)
        to_cell, to_facet = mesh.topology.connectivity(d - 1, d), mesh.topology.connectivity(d, d - 1)
        facet = facet_tags.indices[facet_tags.values == group]
        cell = to_cell.array[to_cell.offsets[facet]].astype(np.int64)
        facet, cell = facet[cell < len(corner)], cell[cell < len(corner)]
        self.cell, self.local = cell, np.argmax(to_facet.array.reshape(-1, d + 1)[cell] == facet[:, None], axis=1)
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
        nodal_kernels.add_to_nodes(self.facet_nodes, values, total)


class Boundaries(CellNodeFluid):
    """Boundary conditions of a fluid on tagged facets: what is set, and the values at its nodes at each step."""

    def boundary(self, group: int | str) -> BoundaryFacets:
        """Facets and nodes of a boundary group."""
        if self.facet_tags is None:
            raise ValueError(f"Boundary group {group} was named, but no facet_tags were given; pass facet_tags=.")
        number, *others = self._numbers(group)
        if others:
            raise ValueError(f"The boundary group is {(number, *others)}; give one group, by its number or name.")
        if number not in self._facets:
            self._facets[number] = BoundaryFacets(self.mesh, self.facet_tags, number, self.dofs, self.corner, self.gradient,
                                                  self.volume, self.node_halo, self.nodes)
        return self._facets[number]

    def _numbers(self, groups):
        """The groups, by number or by their names in gmsh, as int."""
        return group_numbers(self.facet_tags, groups)

    def _set(self, kind, groups, *what):
        """Give groups a condition, in place of what they had."""
        self._conditions |= {group: (kind, self.boundary(group), *what) for group in self._numbers(groups)}  # all or none
        self.inlets, self.outlets, self.no_slip, self.slip = (
            [tuple(c[1:]) for c in self._conditions.values() if c[0] == k]
            for k in ("velocity", "pressure", "no slip", "slip"))
        self.ready = False

    def set_velocity(self, groups: int | str | Sequence[int | str],
                     value: ArrayLike | Callable[[float, np.ndarray], ArrayLike]) -> None:
        """Superficial velocity on inlets: d numbers, or a function (time, position (points, 3)) -> (points, d).

        Numbers that lead along a boundary and not through it make it a no-slip wall that moves with this velocity.
        """
        for facets in map(self.boundary, self._numbers(groups)):
            velocity_at(value, 0.0, facets.centre, self.dimension)  # refused for one, set for none
        for group in self._numbers(groups):
            facets = self.boundary(group)
            velocity = velocity_at(value, 0.0, facets.centre, self.dimension)
            through, size = np.abs((velocity * facets.area_normal).sum(1)).sum(), np.abs(velocity).sum()
            through, size = self.comm.allreduce(np.array([through, size * np.abs(facets.area_normal).max(initial=0.0)]))
            if callable(value) or through > 1e-12 * size:
                self._set("velocity", group, value)
            else:
                self._set("no slip", group, value, None)

    def set_pressure(self, groups: int | str | Sequence[int | str], value: float | Callable[[float], float] = 0.0) -> None:
        """Pressure on outlets [Pa]: a number or a function of time. Fluid may enter there without bringing energy."""
        self._set("pressure", groups, number_or_function("pressure of an outlet", value))

    def set_no_slip(self, groups: int | str | Sequence[int | str],
                    velocity: ArrayLike | Callable[[float, np.ndarray], ArrayLike] | None = None,
                    law: Callable[..., np.ndarray] | None = None) -> None:
        """No-slip walls: no flow through them; friction as the mesh, the drag beside the wall or a wall law has it.

        Args:
            groups: one or several boundary groups.
            velocity: interstitial velocity of the wall along itself [m/s]: d numbers, or a function (time, position (points,
                3))
                -> (points, d); absent: at rest. Only its part along the wall counts.
            law: wall law of turbulent layers, for instance :class:`Spalding`; absent: the layer is resolved, or laminar.

        Raises:
            ValueError: for a velocity that leads through the wall.
        """
        if law is not None:
            function_or_class_of("wall law", law, "an object such as Spalding(), or leave it out")
        for group in self._numbers(groups) if velocity is not None else ():
            facets = self.boundary(group)
            through = (velocity_at(velocity, self.time, facets.centre, self.dimension) * facets.area_normal).sum(1)
            size = np.linalg.norm(velocity_at(velocity, self.time, facets.centre, self.dimension), axis=1)
            bad = np.abs(through) > 0.2 * size * np.linalg.norm(facets.area_normal, axis=1) + 1e-300
            message = (f"The velocity of no-slip wall {group} leads through the wall at {facets.centre[bad][0].tolist()}; "
                       f"give a "
                       "velocity along the wall, or use set_velocity for fluid that flows in.") if bad.any() else None
            raise_everywhere(self.comm, ValueError, message)
        self._set("no slip", groups, velocity, law)

    def set_slip(self, groups: int | str | Sequence[int | str]) -> None:
        """Slip walls: no flow through them and no friction."""
        self._set("slip", groups)

    def _hold_nodes(self):
        """Nodes and directions that boundaries hold, and the friction of the walls."""
        self.fixed, self.fixed_pressure = np.zeros(self.nodes, bool), np.zeros(self.nodes, bool)
        walls = [f for f, *_ in (*self.no_slip, *self.slip)]
        self.slip_nodes, self.slip_normals, corners = held_directions(self, walls)
        self.fixed[corners] = True
        for facets, _ in self.inlets:
            self.fixed[facets.nodes] = True
        for facets, _ in self.outlets:
            self.fixed_pressure[facets.nodes] = True
        self.at_wall = np.zeros(self.nodes, bool)
        for facets, *_ in self.no_slip:
            self.at_wall[facets.nodes] = True
        self.held, self._wall_share = np.flatnonzero(self.fixed), None
        self.wall_friction = WallFriction(self, self.no_slip) if self.no_slip else None

    def check_closed(self, step: StepState) -> None:
        """Raise ``ValueError`` if more fluid comes into a domain without outlet than room for it: by inlets, sources,
        particles."""
        made, size = cell_kernels.totals(step.acting.supply, self.volume)
        come = step.inflow.sum()
        sums = sums_of(self.comm, -come, -made, abs(come) + size, self.volume.sum())
        net = sums[0] + sums[1]
        if abs(net) > 1e-6 * sums[2] + 1e-10 * sums[3] / step.dt:
            raise ValueError(f"At time {self.time:g} s inlets let {sums[0]:g} m^3/s into a domain without outlet, and "
                             f"particles and mass "
                             f"sources displace {sums[1]:g} m^3/s, together {net:g} m^3/s; add set_pressure(group).")

    def set_boundary_values(self, phi: np.ndarray | None) -> None:
        """Interstitial velocities of the fixed nodes at the new time. ``phi`` None: one, on all ranks."""
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

    def inflow_at(self, time: float) -> np.ndarray:
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

    def impose(self, u: np.ndarray) -> None:
        """Give the fixed nodes their velocities, and take the normal part from slip walls, in place."""
        node_kernels.impose(u, self.slip_nodes, self.slip_normals, self.held, self.boundary_velocity)

    def boundary_force(self, group: int | str) -> tuple[np.ndarray, np.ndarray]:
        """Force of the fluid on a boundary group, by pressure and by friction: two arrays (d,) [N].

        Friction is what the terms of the wall, and what keeps its nodes from moving through it, take from the fluid's
        momentum
        in the step; where groups meet, each node's part goes to them by their facets. On a group of inlets, or any other
        than
        no-slip and slip walls, there is no friction. Call it after :meth:`advance`.

        Raises:
            RuntimeError: before the first step.
        """
        facets, d = self.boundary(group), self.dimension
        step = self.last_step
        if step is None or not self.ready:
            raise RuntimeError(f"The force on boundary {group} is not known before a step; call advance first.")
        p = self.pressure.x.array[facets.facet_nodes].mean(1) if len(facets.cell) else np.zeros(0)
        pressure = (p[:, None] * facets.area_normal).sum(0).reshape(d)
        return self.comm.allreduce(pressure), self.comm.allreduce(self._friction_on(facets, step))

    def _friction_on(self, facets, step):
        """This rank's part of the friction of a step on the wall with these facets (d,) [N]."""
        walls = [f for f, *_ in (*self.no_slip, *self.slip)]
        if not any(f is facets for f in walls):
            return np.zeros(self.dimension)
        if self._wall_share is None:  # facets of all walls at each node
            self._wall_share = np.zeros(self.nodes)
            for wall in walls:
                self._wall_share[wall.nodes] += wall.number
            for inlet, _ in self.inlets:
                self._wall_share[inlet.nodes] = np.inf
        mine = facets.nodes < self.owned_nodes
        nodes = facets.nodes[mine]
        share = (facets.number[mine] / self._wall_share[nodes])[:, None]
        friction = 0.0 if self.wall_friction is None else self.wall_friction.force_on(facets)
        held = np.where(self.fixed[nodes, None], step.reaction[nodes], self.state.slip_force[nodes])
        return friction - (share * (held - step.taken[nodes] + step.given[nodes])).sum(0)
