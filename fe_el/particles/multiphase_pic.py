"""Multiphase particle-in-cell: the stress of crowded particles on a mesh in place of their contacts."""
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fe_el.checks import finite_number, of_kind, positive_number, require_tags, whole_number
from fe_el.nodes.nodal_space import NodalSpace
from fe_el.nodes.work_arrays import WorkArrays
from fe_el.parallel.exchange import Halo, largest_of, sums_of
from fe_el.particles import motion
from fe_el.particles import packing_kernels as kernels
from fe_el.particles.contacts.wall_shapes import FACETS, PLANE, FacetWalls
from fe_el.particles.particles import Particles
from fe_el.particles.reflection import Rebound, reflect_at_facets, reflect_at_planes
from fe_el.particles.solids_stress import SolidsStress
from fe_el.particles.wall_facets import facets_at_nodes, walls_of_facets

if TYPE_CHECKING:
    from fe_el.particles.contacts.wall_shapes import Wall

NONE_LATE = np.zeros(0)  # Particles puts back those who came in during the step
COURANT = 0.05  # share of a cell that particles may cross in a part of a step: fronts over-fill beyond
MOST = 1000  # parts of a step


class MultiphasePIC:
    """The MP-PIC method (Snider, J. Comput. Phys. 170, 2001, 523), in the place of :class:`Contacts`: particles are points
    that a stress keeps apart where they crowd, at any time step. The stress knows what leaves and enters the cells of now;
    so where particles could over-fill what they cross a step is made in parts, in which none crosses more than a twentieth.

    Volume and momentum of the particles go to the nodes of the mesh by its hat functions, and changes of velocity come back
    by the same functions. The stress is that of the solid fraction at the *end* of the step, by the iteration of a convex
    problem, in place of Snider's limiter, which loses momentum: so particles keep their momentum to round-off, less what
    walls take, close packing is kept in one step, and the stress gives back no energy that it has not taken up. Collisions
    take the scatter of the velocities at a node (:func:`fe_el.particles.packing_kernels.damping_of`).

    Particles do not turn. Walls may be changed between two steps.

    Args:
        particles (Particles): the particles.
        stress (SolidsStress): absent: with its defaults.
        walls: one or a list of :class:`FacetWalls` and :class:`PlaneWall`; ``(facet_tags, groups)`` is short for
            ``FacetWalls(facet_tags, groups)``; absent: none. A bed that rests needs walls of facets: planes only throw
            particles back.
        restitution (float): of collisions between particles, 0 to 1.
        wall_restitution, tangential_restitution (float): parts of the normal and of the tangential velocity that are left
            after a wall, 0 to 1.
        tolerance (float): of the solid fractions at the nodes at the end of the step.
        iterations (int): at most; more where that does not do are made in the next step.

    Attributes:
        max_solid_fraction (float): largest at a node at the start of the last step, or of a part of it.
        steps_last, steps_largest (int): parts of the last step, and most of any so far.
        iterations_last (int): of the last step.
        momentum_imbalance (float): what particles and walls gained together over the sum of what particles gained.

    Raises:
        ValueError: for numbers out of range, other walls, or a boundary group without facets.

    Note:
        Collective.
    """

    largest_overlap = 0.0  # as of Contacts

    def __init__(self, particles: "Particles", stress: SolidsStress | None = None,
                 walls: "Wall | Sequence[Any] | None" = None, restitution: float = 0.9, wall_restitution: float = 0.9,
                 tangential_restitution: float = 1.0, tolerance: float = 1e-4, iterations: int = 200) -> None:
        of_kind("particles", particles, Particles)
        self.particles, self.mesh, self.comm = particles, particles.mesh, particles.comm
        self.stress = of_kind("stress", SolidsStress() if stress is None else stress, SolidsStress)
        if isinstance(walls, tuple):
            walls = FacetWalls(*walls) if len(walls) == 2 and hasattr(walls[0], "indices") else list(walls)
        self.walls = list(np.atleast_1d(np.array(walls, object))) if walls is not None else []
        self.restitution, self.wall_restitution, self.tangential_restitution = restitution, wall_restitution, \
            tangential_restitution
        self.tolerance = positive_number("tolerance of the solid fraction", tolerance)
        self.iterations = whole_number("number of iterations", iterations, 1)
        self.space, self._work = NodalSpace(particles.mesh), WorkArrays()
        index_map, touched = self.space.space.dofmap.index_map, np.zeros(self.space.nodes, bool)
        touched[self.space.dofs] = True
        self._sums = Halo.of_index_map(self.comm, index_map, touched)
        several = touched.astype(float)
        self._sums.complete(several)
        self._part = np.where(touched, 1 / np.maximum(several, 1.0), 0.0)  # of a node: ranks share some
        self._owned = np.arange(self.space.nodes) < self.space.owned_nodes
        self.room = self._node_rooms()
        self.pressure, self._cells, self._known = np.zeros(self.space.nodes), None, None
        self.seconds = {"solids stress": 0.0}
        self.max_solid_fraction, self.momentum_imbalance = 0.0, 0.0
        self.iterations_last = self.steps_last = self.steps_largest = 0
        self._take_up()

    def _node_rooms(self):
        """(nodes,) volume that belongs to each node [m^3]."""
        space, room = self.space, np.zeros(self.space.nodes)
        volume = self.particles.cells.volume[:len(space.dofs)]
        np.add.at(room, space.dofs, (volume / space.dofs.shape[1])[:, None])
        self._sums.complete(room)
        return room

    def _take_up(self):
        """Check what may have changed, and find the walls of facets and nodes anew where walls or cells did. Collective."""
        for name in ("restitution", "wall_restitution", "tangential_restitution"):
            value = getattr(self, name)
            if not 0 <= finite_number(name.replace("_", " "), value) <= 1:
                raise ValueError(f"The {name.replace('_', ' ')} is {value}; it must be from 0 to 1.")
        p = self.particles
        for wall in self.walls:
            if getattr(wall, "kind", None) not in (FACETS, PLANE) or isinstance(wall, type):
                raise ValueError(f"{wall!r} is no wall of MultiphasePIC; use FacetWalls, PlaneWall or (facet_tags, groups).")
            if wall.kind == FACETS:
                require_tags("facet tags of a wall", wall.facet_tags, p.mesh)
            if wall.drive is not None or wall.load is not None or wall.kind == PLANE and np.any(wall.angular_velocity):
                raise ValueError("A wall of MultiphasePIC has a drive, a load, or is a plane that turns; set its velocity "
                                 "between two steps instead.")
        if self._known != self.walls or self._cells is not p.cells:
            self.facet_wall = walls_of_facets(p.mesh, p.cells, p.halo, self.walls)
            self.at_walls = facets_at_nodes(self.space, p.cells, self.facet_wall)
            self._known, self._cells = list(self.walls), p.cells
        self.motion = np.array([wall.motion() for wall in self.walls]).reshape(len(self.walls), 9)

    # -- one step ------------------------------------------------------------------------------------------------------

    def advance(self, dt: float) -> None:
        """Advance the particles by ``dt`` [s]; ``FloatingPointError`` where they are too fast for 1000 parts."""
        p, tick, dt = self.particles, time.perf_counter(), positive_number("time step", dt)
        if not p.total_number or p.all_held():
            return
        self._take_up()
        self.wall_impulse, self.gains = np.zeros((max(len(self.walls), 1), 3)), np.zeros(4 + self.space.dimension)
        self.max_solid_fraction, self.iterations_last, self.steps_last, done = 0.0, 0, 0, 0.0
        p.properties["_pushed"] = np.zeros((len(p), 3))
        while done < dt:
            span = self._span(dt - done)
            self._part_of_step(dt, done, span)
            done, self.steps_last = dt if span == dt - done else done + span, self.steps_last + 1
        p.mean_contact_force = p.properties.pop("_pushed") / dt
        self.steps_largest = max(self.steps_largest, self.steps_last)
        self._ledger(dt)
        self.seconds["solids stress"] += time.perf_counter() - tick
        p.put_in_order()

    def _span(self, rest):
        """Length of the next part of a step of which ``rest`` is left [s]. A node takes up what is within as many cells as
        particles cross, at most: that fits where they are few. Collective."""
        p = self.particles
        rate = kernels.crossing_rate(p.cells.barycentric, p.cell, p.velocity, p.force, p.inertia, p.gravity, p.held, rest)
        crossed, allowed = rest * float(largest_of(self.comm, rate)[0]), COURANT
        if crossed > allowed:
            self._to_nodes(p.position, p.inertia)
            allowed = max(allowed, (self.stress.close_packing / self.fullest) ** (1 / self.space.dimension) - 1)
        if crossed > MOST * allowed:
            raise FloatingPointError(f"Particles cross {crossed:.3g} cells in {rest:g} s, and MultiphasePIC makes a step of "
                                     f"at most {MOST} parts of {allowed:.3g} cells; use a smaller step.")
        return rest / max(int(np.ceil(crossed / allowed)), 1)

    def _part_of_step(self, dt, done, span):
        """A part of a step of dt, the first ``done`` of which is made."""
        p = self.particles
        self._reach(span)
        self._take_up()
        start, before, force = p.position.copy(), p.velocity.copy(), p.force.copy()
        if span < dt:
            kernels.force_in_part(p.force, p.mean_contact_force, p.inertia, p.gravity, p.relaxation_rate, p.held, dt, done,
                                  span, force)
        motion.free_flight(p.position, p.velocity, force, p.inertia, p.gravity, p.relaxation_rate, p.held, NONE_LATE, span)
        free, mass = p.velocity.copy(), np.where(p.held, 0.0, p.inertia)
        weight, sums = self._to_nodes(start, mass)
        self.max_solid_fraction = max(self.max_solid_fraction, self.fullest)
        mean, change, held = self._change_of_nodes(span, weight, sums)
        rows = self.space.dofs, p.cells.barycentric, p.cell
        kernels.from_nodes(*rows, start, p.held, self._damping(span, sums), mean, change, p.velocity)
        kernels.move(p.position, before, free, p.velocity, p.relaxation_rate, p.held, span)
        p.properties["_pushed"] += mass[:, None] * (p.velocity - free)
        self._reflect(start, before, mass, span)
        gain = mass[:, None] * (p.velocity - free)
        self.gains += [*gain.sum(0), *held, np.abs(gain).sum()]
        p.locate()

    def _reach(self, dt):
        """Let the halo of cells be as wide as particles may go in the step. Collective."""
        p = self.particles
        pull = np.linalg.norm(p.force, axis=1) / p.inertia + np.linalg.norm(p.gravity)
        way = float(largest_of(self.comm, dt * (p.speed() + dt * pull.max(initial=0.0)))[0])
        if way > p.halo_width:
            p.reach_halo(2 * way)

    def _to_nodes(self, position, mass):
        """Volumes of the corners of each cell (cells, d + 1), and the sums at the nodes (nodes, d + 4)."""
        p, space = self.particles, self.space
        weight = self._work.zeros("weight", *space.dofs.shape)
        sums = self._work.zeros("sums", space.nodes, space.dimension + 4)
        kernels.to_nodes(space.dofs, p.cells.barycentric, p.cell, position, p.velocity, p.volume, mass, p.primary_diameter,
                         weight, sums)
        self._sums.complete(sums)
        self.solid_fraction = sums[:, 0] / np.maximum(self.room, 1e-300)
        self.fullest = float(largest_of(self.comm, self.solid_fraction.max(initial=0.0))[0])
        return weight, sums

    def _damping(self, dt, sums):
        """(nodes,) part of the scatter that collisions take."""
        out = self._work.empty("damping", self.space.nodes)
        kernels.damping_of(sums, self.solid_fraction, self.pressure, self.restitution, self.stress.close_packing, dt, out)
        return out

    def _change_of_nodes(self, dt, weight, sums):
        """Mean velocity (nodes, d), its change by the stress and by walls, and the impulse (d,) on what is held [N s].

        Stress and velocity at the end of the step belong together: with the expansion E v of the particles at the nodes,
        s = s_0 - dt E v / room, v = v_0 + dt E^T q / mass, q = tau(s) / s. That is the minimum of a convex function; steps
        by a bound of its curvature go there, accelerated (Beck & Teboulle 2009) and begun anew where they overshoot.
        """
        space, work, n, d = self.space, self._work, self.space.nodes, self.space.dimension
        mass = work.empty("mass", n)
        mass[:] = sums[:, 1]
        mean = sums[:, 2:2 + d] / np.maximum(mass, 1e-300)[:, None]
        columns, bound = work.zeros("columns", n), work.zeros("bound", n)
        nodes, area_normal, _ = self.at_walls
        kernels.column_sums(space.dofs, space.gradient, weight, columns)
        kernels.sizes_at_walls(nodes, area_normal, self.solid_fraction, columns)
        self._sums.complete(columns)
        kernels.row_bounds(space.dofs, space.gradient, weight, columns, mass, bound)
        kernels.sizes_at_walls(nodes, area_normal, self.solid_fraction * columns / np.maximum(mass, 1e-300), bound)
        self._sums.complete(bound)
        carried, new, fraction, momentum = self.pressure.copy(), np.zeros(n), self.solid_fraction.copy(), 1.0
        velocity, force, rate = (work.empty(name, *shape) for name, shape in (("velocity", (n, d)), ("force", (n, d)),
                                                                             ("rate", (n,))))
        for count in range(1, self.iterations + 1):
            self._velocity_of(carried, weight, mean, mass, dt, velocity, force)
            rate.fill(0.0)
            kernels.expansion_of(space.dofs, space.gradient, weight, velocity, rate)
            kernels.expansion_at_walls(nodes, area_normal, self.solid_fraction, velocity, rate)
            self._sums.complete(rate)
            largest = kernels.new_pressures(self.solid_fraction, rate, self.room, bound, dt, self.stress.numbers,
                                                   carried, fraction, new)
            along = float((self._part * bound * (carried - new)) @ (new - self.pressure))
            largest, along = largest_of(self.comm, largest)[0], sums_of(self.comm, along)[0]
            momentum, last = (1.0, 1.0) if along > 0 else (0.5 + np.sqrt(0.25 + momentum ** 2), momentum)
            carried[:] = new + (last - 1) / momentum * (new - self.pressure)
            self.pressure, new = new, self.pressure
            if largest < self.tolerance:
                break
        self.iterations_last += count
        self._velocity_of(self.pressure, weight, mean, mass, dt, velocity, force, self.wall_impulse)
        held = dt * force[self._owned & (mass <= 0)].sum(0)
        return mean, velocity - mean, held

    def _velocity_of(self, pressure, weight, mean, mass, dt, velocity, force, impulse=None):
        """Velocity of the nodes under a pressure; the impulse on the walls is added up if asked for."""
        space = self.space
        force.fill(0.0)
        kernels.force_of(space.dofs, space.gradient, weight, pressure, force)
        if impulse is None:
            impulse = self._work.empty("no_impulse", *self.wall_impulse.shape)
        kernels.force_of_walls(*self.at_walls, self.solid_fraction, pressure, force, impulse, dt)
        self._sums.complete(force)
        kernels.accelerate(mean, force, mass, dt, velocity)

    def _reflect(self, start, before, mass, dt):
        """Throw particles back from walls, and move the planes."""
        p = self.particles
        rebound = Rebound((p.velocity - before) / dt, mass, self.motion, float(self.wall_restitution),
                          float(self.tangential_restitution), self.wall_impulse)
        for k, wall in enumerate(self.walls):
            if wall.kind == PLANE:
                wall.moved(wall.point + dt * self.motion[k, 3:6], wall.shape)
                reflect_at_planes(k, wall.point, wall.normal, p.held, p.position, p.velocity, rebound)
        reflect_at_facets(p.cells.barycentric, p.cells.neighbour, p.cells.shift, self.facet_wall, p.cell, start, p.position,
                          p.velocity, rebound)

    def _ledger(self, dt):
        """Forces on the walls, and what is left of the momentum that particles, walls and what is held gained together."""
        d, sums = self.space.dimension, sums_of(self.comm, *self.gains, *self.wall_impulse.ravel())
        impulse = sums[4 + d:].reshape(-1, 3)
        for wall, on_wall in zip(self.walls, impulse):
            wall.force = on_wall / dt
        left = sums[:3] + impulse.sum(0)
        left[:d] += sums[3:3 + d]
        self.momentum_imbalance = float(np.abs(left).max() / max(sums[3 + d], 1e-300))

    # -- checkpoints -----------------------------------------------------------------------------------------------------

    def saved(self) -> dict[str, tuple]:
        """The pressures at the nodes that the next step starts from, and where walls are, for a checkpoint."""
        own, space = self.space.owned_nodes, self.space
        place = np.zeros((space.nodes, 3))
        place[space.dofs] = space.corner
        space.node_halo.forward(place)
        return {"nodes": (place[:own], {"pressure": self.pressure[:own]}),
                "same": (None, {"walls": np.array([wall.point for wall in self.walls]).reshape(-1, 3)})}

    def restore(self, state: dict[str, dict]) -> None:
        """Take them back."""
        self.pressure[:self.space.owned_nodes] = state["nodes"]["pressure"]
        self.space.node_halo.forward(self.pressure)
        for wall, point in zip(self.walls, state["same"]["walls"]):
            wall.point = point.copy()
