"""Contacts between particles and with walls, in sub-steps of a fraction of the contact time."""
import time

import numpy as np

from fe_el.checks import of_kind, positive_number, require_tags
from fe_el.compiled.direct_calls import Direct
from fe_el.parallel.exchange import largest_of, raise_everywhere
from fe_el.parallel.messages import largest, ranks_of
from fe_el.particles import motion
from fe_el.particles.contacts import contact_lists
from fe_el.particles.contacts.array_law import ArrayLaw, array_forces
from fe_el.particles.contacts.contact_laws import HertzMindlin, LinearSpringDashpot
from fe_el.particles.contacts.law_kernels import constant_rows, new_block
from fe_el.particles.contacts.sub_steps import all_forces, sub_steps, update_near, wall_forces
from fe_el.particles.contacts.wall_shapes import FACETS, FacetWalls, move_walls
from fe_el.particles.particles import LostParticle, Particles


class Contacts:
    """Contacts of particles under a contact law, by velocity Verlet sub-steps.

    ``law``, ``wall_law``, the list ``walls``, motion and place of each wall, and diameter, density, material and position of
    particles may be changed between two steps: the next one takes them up.

    Args:
        particles (Particles): the particles.
        law: :class:`LinearSpringDashpot`, :class:`HertzMindlin` or :class:`ArrayLaw` of particle-particle contacts.
        walls: one or a list of :class:`FacetWalls`, :class:`PlaneWall`, :class:`CylinderWall`; ``(facet_tags, groups)`` is
            short for ``FacetWalls(facet_tags, groups)``; absent: none.
        wall_law: law of wall contacts; absent: ``law``.
        steps_per_contact (int): sub-steps in the shortest contact. The mean restitution, over pairs that touch at any
            moment of a sub-step, is within 0.005 of the law's at 12, 0.002 at 20 and 0.001 at 50.
        skin (float): reach of the neighbour lists beyond contact [m]; absent: adapted to the motion of each particle.

    Attributes:
        steps_last (int): sub-steps of the last advance.
        largest_overlap (float): largest overlap over the smaller diameter so far.

    Raises:
        ValueError: for a boundary group without facets, fewer than 10 steps per contact, or an unknown wall.

    Note:
        Collective.
    """

    def __init__(self, particles, law, walls=None, wall_law=None, steps_per_contact=50, skin=None):
        of_kind("particles", particles, Particles)
        if not positive_number("steps_per_contact", steps_per_contact) >= 10:
            raise ValueError(f"steps_per_contact is {steps_per_contact}; at least 10 are needed to resolve a contact.")
        if skin is not None:
            positive_number("skin", skin)
        self.particles, self.law, self._wall_law = particles, law, wall_law
        self.steps_per_contact = steps_per_contact
        if isinstance(walls, tuple):
            walls = FacetWalls(*walls) if len(walls) == 2 and hasattr(walls[0], "indices") else list(walls)
        self.walls = list(np.atleast_1d(np.array(walls, object))) if walls is not None else []
        self._check_parts()
        self._sub_steps, self._all_forces = Direct(sub_steps), Direct(all_forces)
        self.lists = contact_lists.ContactLists(particles, list(self.walls), skin, self._spring_width())
        self.block, self.ranks = (new_block(), new_block()), ranks_of(particles.comm)
        self.step, self.layout, self.stale = 1, None, False
        self.seconds = {"neighbours": 0.0, "contacts": 0.0}
        self.touching, self.touching_walls, self.largest_overlap, self.steps_last, self.behind = 0, 0, 0.0, 0, None

    @property
    def wall_law(self):
        """Law of wall contacts: ``law`` unless another was given."""
        return self._wall_law or self.law

    @wall_law.setter
    def wall_law(self, law):
        self._wall_law = law

    def _spring_width(self):
        rolls = max(getattr(law, "rolls", 0) for law in (self.law, self.wall_law))
        return 7 if rolls else 4

    def _check_parts(self):
        """Whether laws and walls go together."""
        for law in (self.law, self.wall_law):
            of_kind("contact law", law, LinearSpringDashpot, HertzMindlin, ArrayLaw)
        for wall in self.walls:
            if isinstance(wall, type) or not hasattr(wall, "motion"):
                raise ValueError(f"{wall!r} is no wall; use FacetWalls, PlaneWall, CylinderWall or (facet_tags, groups).")
            if wall.kind == FACETS:
                require_tags("facet tags of a wall", wall.facet_tags, self.particles.mesh)
        if self.walls and isinstance(self.wall_law, ArrayLaw):
            raise ValueError("An ArrayLaw acts between particles only; give walls a wall_law, for instance HertzMindlin.")
        self._check_materials()

    def _take_up(self):
        """What was changed since the last step: laws, walls, and sizes, masses and places of particles. Collective."""
        p, lists = self.particles, self.lists
        self._check_parts()
        if self._spring_width() > lists.width:
            raise ValueError("The contact law now has rolling friction, for which the contacts keep no springs; make new "
                             "Contacts with this law.")
        if self.walls != lists.walls:
            self.lists = lists.with_walls(list(self.walls), self.step, self.layout)
            self.layout, self.stale = p.layout if self.layout is not None else None, True
        elif largest_of(p.comm, float(self.lists.take_up() and self.layout == p.layout))[0]:
            self.stale = True
        for block, law in zip(self.block, (self.law, self.wall_law)):
            if not isinstance(law, ArrayLaw):
                constant_rows(block[0], law.numbers)

    def _check_materials(self):
        for what, indices, law in (("particle", self.particles.material, self.law), *(
                ("wall", np.array([w.material]), self.wall_law) for w in self.walls)):
            count = getattr(law, "materials", None)
            if count and len(indices) and indices.max() >= count:
                raise ValueError(f"A {what} has material {indices.max()}, but the law has {count} material(s), numbered "
                                 f"from 0; "
                                 "give the law a larger table.")

    @property
    def rebuilds(self):
        """How often the neighbour lists were made."""
        return self.lists.rebuilds

    def step_limit(self):
        """Largest sub-step [s]: the shortest contact time in the run over ``steps_per_contact``.

        Where more than three pieces of wall meet in one point their stiffnesses add up.
        """
        p = self.particles
        count = max(getattr(law, "materials", None) or 1 for law in (self.law, self.wall_law))
        density = p.inertia / p.volume if "added_mass" in p.properties else p.density
        light, small = motion.lightest_and_smallest(p.material, density, p.diameter, count)
        extremes = (p.speed(), p.diameter.max()) if len(p) else np.zeros(2)
        speed, biggest, *rest = largest_of(p.comm, *extremes, *light, *small)
        light, small = np.array(rest).reshape(2, count)
        if not biggest > 0:
            raise ValueError("There are no particles; insert some before advancing contacts.")
        speed = max(2 * speed, np.sqrt(np.linalg.norm(p.gravity) * biggest), 1e-3)
        there = light > 0
        times = [self._shortest(self.law, light + light[:, None], small + small[:, None], there & there[:, None], speed)]
        if self.walls:
            together = max(self.lists.meeting / 3, 1.0)  # three at right angles, as in a corner, do not add up
            times.append(self._shortest(self.wall_law, light[:, None] + 0 * light, small[:, None] + 0 * small,
                                        there[:, None] & (light > -1), speed) / np.sqrt(together))
        return min(times) / self.steps_per_contact

    @staticmethod
    def _shortest(law, inverse_mass, inverse_radius, there, speed):
        """Shortest contact time of the pairs of materials that are ``there`` [s]."""
        pairs = getattr(law, "materials", None) or 1
        if pairs < len(there):  # one law for all materials
            inverse_mass, inverse_radius = inverse_mass.max(keepdims=True), inverse_radius.max(keepdims=True)
            there = np.ones((1, 1), bool)
        mass, radius = 1 / np.where(there, inverse_mass, np.inf), 1 / np.where(there, inverse_radius, np.inf)
        mass, radius = np.where(there, mass, np.inf), np.where(there, radius, 1.0)
        return law.contact_time(mass, radius, speed)

    def advance(self, dt):
        """Advance the particles by ``dt`` [s] in velocity Verlet sub-steps."""
        p, tick, renewing = self.particles, time.perf_counter(), self.seconds["neighbours"]
        if not p.total_number:
            self.steps_last = 0
            return  # none have come yet, or all have left
        self._take_up()
        if p.all_held() and not self.lists.has_moving_shapes():
            self.steps_last = 0
            return  # nothing can move
        self.steps_last = max(int(np.ceil(dt / self.step_limit() - 1e-9)), 1)
        h, done = dt / self.steps_last, 0
        self.wall_impulse = np.zeros((max(len(self.walls), 1), 3))
        if self.layout != p.layout:
            self._rebuild(h)
            self._first_forces()
        elif self.stale:
            self._rebuild(h)
        elif "added_mass" in p.properties:
            self.lists.weigh()
        p.properties["_start_velocity"] = p.velocity.copy()
        self._drive(dt)
        while done < self.steps_last:
            done += self._run(h, self.steps_last - done)
            if done < self.steps_last:
                self._rebuild(h)
        del p.properties["_external"], p.properties["_fading"]
        start = p.properties.pop("_start_velocity")
        p.mean_contact_force = motion.mean_force(p.velocity, start, p.inertia, self._external(), dt)
        for wall, impulse in zip(self.walls, p.comm.allreduce(self.wall_impulse)):
            wall.force = impulse * h / dt
        self.lists.move_walls()
        self.seconds["contacts"] += time.perf_counter() - tick - (self.seconds["neighbours"] - renewing)

    def _external(self):
        """(particles, 3) force by all but contacts, of what is not held [N]."""
        p = self.particles
        return np.where(p.held[:, None], 0.0, p.inertia[:, None] * p.gravity + p.force)

    def _drive(self, dt):
        """What moves the particles besides contacts, in every sub-step of the step; it travels with them."""
        p = self.particles
        self.fades = int(largest_of(p.comm, p.relaxation_rate.max(initial=0.0))[0] > 0)
        rows = self._external(), np.zeros((len(p), 4 * self.fades))
        if self.fades:
            rows = motion.forces_in_step(p.position, p.force, p.mean_contact_force, p.inertia, p.gravity, p.relaxation_rate,
                                         p.held, dt, self.steps_last)
        p.properties["_external"], p.properties["_fading"] = rows

    def _rebuild(self, h):
        tick = time.perf_counter()
        self.lists.rebuild(h, self.step, self.layout)
        self.layout = self.particles.layout
        self.seconds["neighbours"] += time.perf_counter() - tick

    def _run(self, h, most):
        """Sub-steps until the neighbour list is out of date (``stale``), at most ``most``; returns how many."""
        p, n, lists = self.particles, len(self.particles), self.lists
        external, fading = p.properties["_external"], p.properties["_fading"][:n * self.fades]
        x, state, force = lists.pack(external + fading[:, :3] if self.fades else external)
        drift = external, np.where(p.held, 0.0, 10.0 / (p.mass * p.diameter ** 2)), lists.x0, fading
        steps = self._steps(h, most, drift) if isinstance(self.law, ArrayLaw) else self._compiled_steps(h, most, drift)
        self._check_behind()
        self._check_finite(x[:n], force)
        motion.kick(state, force, lists.inverse_mass, drift[1], 0.5 * h, n)
        p.position, p.velocity, p.angular_velocity = x[:n].copy(), state[:n, 1:4].copy(), state[:n, 4:7].copy()
        p.contact_force, p.contact_torque = force[:n, :3] - external, force[:n, 4:7].copy()
        if self.fades:
            p.contact_force -= fading[:, :3]
        return steps

    def _steps(self, h, most, drift):
        """Sub-steps with any law."""
        lists, part, steps = self.lists, 0.5, 0
        x, state, force = lists.x, lists.state, lists.force
        x0 = drift[2]
        self.stale = False
        while steps < most and not self.stale:
            moved, _, _ = motion.drift_on(x, state, force, lists.inverse_mass, drift, part, h, 0, len(x0))
            part, steps = 1.0, steps + 1
            lists.ghosts.forward_state(x, state)
            force[len(x0):] = 0.0
            if lists.has_shapes:
                move_walls(lists.kind, lists.shape, lists.motion, h)
            moved = largest(self.ranks, moved)
            self._forces(h, moved)
            lists.age += 1
            self.stale = not moved <= 1 or lists.wall_rate * h * lists.age > 1
        return steps

    def _compiled_steps(self, h, most, drift):
        """The same in one call, with a built-in law."""
        lists, rows = self.lists, self._rows()
        steps, self.stale, self.touching, behind, self.largest_overlap, lists.near = self._sub_steps(
            most, h, lists.age, lists.wall_rate, rows[0], drift, lists.ghosts.rows(), self.ranks, lists.waves,
            *rows[1:], self.step, self.block, self._numbers(), self.largest_overlap)
        self.step, lists.age = self.step + steps, lists.age + steps
        self.behind = behind if behind >= 0 else self.behind
        return steps

    def _first_forces(self):
        """Contact forces of particles that came from outside: the first half kick needs them."""
        p, n = self.particles, len(self.particles)
        p.contact_force, p.contact_torque = np.zeros((n, 3)), np.zeros((n, 3))
        x, _, force = self.lists.pack(p.contact_force)
        self._forces(0.0, 0.0)
        self._check_behind()
        self._check_finite(x[:n], force)
        p.contact_force, p.contact_torque = force[:n, :3].copy(), force[:n, 4:7].copy()

    def _check_finite(self, x, force):
        """Stop before a position or force that is not a number spreads."""
        i, p, message = motion.first_not_finite(x, force), self.particles, None
        if i >= 0:
            message = (f"The contact force on particle {p.id[i]} near {p.position[i].tolist()} is {force[i, :3].tolist()} "
                       f"(step "
                       f"{p.step}, rank {p.comm.rank}). Either two particles lie on one point, or the step is too large for "
                       f"the "
                       "law: insert without overlap, or use more steps_per_contact.")
        raise_everywhere(p.comm, FloatingPointError, message)

    def _numbers(self):
        return self.law.numbers, getattr(self.wall_law, "numbers", self.law.numbers)  # without walls it may be an ArrayLaw

    def _rows(self):
        """What the kernels need of particles, pairs (twice), what is near, facets, planes and cylinders, and of all
        walls."""
        lists = self.lists
        facets = (lists.wall_particle, lists.wall_facet, lists.springs[1], lists.stamps[1], *lists.facet_rows, lists.scratch)
        shapes = (lists.shape_particle, lists.shape_wall, lists.springs[2], lists.stamps[2], lists.kind, lists.shape)
        return ((lists.x, lists.state, lists.force, lists.radius, lists.inverse_mass, lists.material),
                (lists.first, lists.second, lists.springs[0], lists.stamps[0]),
                (lists.gap, lists.wall_gap, lists.listed, lists.wall_listed), lists.near, facets, shapes,
                (lists.motion, lists.wall_material, self.wall_impulse, np.array([self.largest_overlap])))

    def _forces(self, h, moved):
        """Wall and pair forces at one instant, when particles have moved by up to ``sqrt(moved)`` of their room."""
        lists, rows = self.lists, self._rows()
        self.step += 1
        if isinstance(self.law, ArrayLaw):
            return self._array_forces(h, moved, rows)
        self.touching, behind, self.largest_overlap, lists.near = self._all_forces(
            *rows, moved, self.step, self.block, self._numbers(), h, self.largest_overlap)
        self.behind = behind if behind >= 0 else self.behind
        return None

    def _array_forces(self, h, moved, rows):
        """The same for an array law."""
        (x, state, force, radius, inverse_mass, _), pairs, found, near, facets, shapes, walls = rows
        lists, touching_walls = self.lists, 0
        if self.walls:
            lists.near = update_near(moved, *found, *near)
            touching_walls, behind = wall_forces(rows[0], lists.wall_listed[:lists.near[2]], facets, shapes, walls,
                                                 self.step,
                                                 self.block[1], self.wall_law.numbers, h)
            self.behind = behind if behind >= 0 else self.behind
        touching, overlap = array_forces(self.law, x, state, force, radius, inverse_mass, *pairs, self.step, h)
        self.touching = touching + touching_walls
        self.largest_overlap = max(self.largest_overlap, overlap, walls[3][0])

    def _check_behind(self):
        """Stop if a particle's centre came onto or behind a wall in the last sub-steps."""
        p, message = self.particles, None
        if self.behind is not None:
            i = self.behind
            message = (f"The centre of particle {p.id[i]} went onto or behind a wall near {p.position[i].tolist()} "
                       f"(step {p.step}, rank {p.comm.rank}): the overlap reached its radius. Use a stiffer contact "
                       "law, or a smaller step.")
        raise_everywhere(p.comm, LostParticle, message)
