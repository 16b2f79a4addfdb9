"""Contacts between particles and with walls, in sub-steps of a fraction of the contact time."""
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fe_el.checks import of_kind, positive_number
from fe_el.compiled.direct_calls import Direct
from fe_el.parallel.exchange import largest_of, total_of
from fe_el.parallel.messages import largest, ranks_of
from fe_el.particles import motion
from fe_el.particles.contacts import ahead, contact_lists, velocity_verlet
from fe_el.particles.contacts.array_law import ArrayLaw, array_forces
from fe_el.particles.contacts.blocks import new_block
from fe_el.particles.contacts.contact_checks import ContactChecks
from fe_el.particles.contacts.law_kernels import constant_rows
from fe_el.particles.contacts.network import network_of
from fe_el.particles.contacts.records import Assembly, Drift, Near
from fe_el.particles.contacts.saved_contacts import SavedContacts
from fe_el.particles.contacts.step_ends import external_force, mean_contact_force, unpack
from fe_el.particles.contacts.step_limit import step_limit
from fe_el.particles.contacts.sub_steps import forces_of_walls, near_numbers
from fe_el.particles.contacts.wall_shapes import FacetWalls, move_walls, note_forces, push_walls
from fe_el.particles.contacts.wall_surfaces import carry_facets
from fe_el.particles.particles import Particles

if TYPE_CHECKING:
    from fe_el.particles.contacts.contact_laws import HertzMindlin, LinearSpringDashpot
    from fe_el.particles.contacts.wall_shapes import Wall

_drift_on = Direct(velocity_verlet.drift_on)
_near_numbers, _forces_of_walls = Direct(near_numbers), Direct(forces_of_walls)


class Contacts(SavedContacts, ContactChecks):
    """Contacts of particles under a contact law, by velocity Verlet sub-steps.

    ``law``, ``wall_law``, the list ``walls``, motion and place of each wall, and diameter, density, material and position of
    particles may be changed between two steps: the next one takes them up.

    Built-in laws are those of single particles: contacts of parcels get the stiffness with which they last as long as those
    of the particles in them (Patankar & Joseph 2001), so that the sub-steps do not depend on the parcels. An
    :class:`ArrayLaw` sees the parcels themselves.

    Args:
        particles (Particles): the particles.
        law: :class:`LinearSpringDashpot`, :class:`HertzMindlin` or :class:`ArrayLaw` of particle-particle contacts.
        walls: one or a list of :class:`FacetWalls`, :class:`PlaneWall`, :class:`CylinderWall`, :class:`SurfaceWall`;
            ``(facet_tags, groups)`` is short for ``FacetWalls(facet_tags, groups)``; absent: none. Each has the mean
            ``force`` and ``torque`` of the particles on it in the last step; give each boundary group a wall of its own to
            know those of each.
        wall_law: law of wall contacts; absent: ``law``.
        steps_per_contact (int): sub-steps in the shortest contact. The mean restitution, over pairs that touch at any
            moment of a sub-step, is within 0.005 of the law's at 12, 0.002 at 20 and 0.001 at 50.
        skin (float): reach of the neighbour lists beyond contact [m]; absent: adapted to the motion of each particle.

    Attributes:
        time (float): that they have been advanced by, for walls that move by a function of time [s].
        steps_last (int): sub-steps of the last advance.
        largest_overlap (float): largest overlap over the smaller diameter so far.

    Raises:
        ValueError: for a boundary group without facets, fewer than 10 steps per contact, or an unknown wall.

    Note:
        Collective.
    """

    def __init__(self, particles: Particles, law: "LinearSpringDashpot | HertzMindlin | ArrayLaw",
                 walls: "Wall | Sequence[Any] | None" = None,
                 wall_law: "LinearSpringDashpot | HertzMindlin | ArrayLaw | None" = None, steps_per_contact: int = 50,
                 skin: float | None = None) -> None:
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
        ahead.sub_steps.begin(particles.comm.size == 1 and not isinstance(law, ArrayLaw))
        self.lists = contact_lists.ContactLists(particles, list(self.walls), skin, self._spring_width())
        self.pair_block, self.wall_block, self.ranks = new_block(), new_block(), ranks_of(particles.comm)
        self.step, self.layout, self.stale, self.time = 1, None, False, 0.0
        self.seconds = {"neighbours": 0.0, "contacts": 0.0}
        self.touching, self.touching_walls, self.largest_overlap, self.steps_last, self.behind = 0, 0, 0.0, 0, None

    @property
    def wall_law(self) -> "LinearSpringDashpot | HertzMindlin | ArrayLaw":
        """Law of wall contacts: ``law`` unless another was given."""
        return self.law if self._wall_law is None else self._wall_law

    @wall_law.setter
    def wall_law(self, law: "LinearSpringDashpot | HertzMindlin | ArrayLaw") -> None:
        self._wall_law = law

    def _spring_width(self):
        rolls = max(getattr(law, "rolls", 0) for law in (self.law, self.wall_law))
        return 7 if rolls else 4

    def _take_up(self):
        """What was changed since the last step: laws, walls, and sizes, masses and places of particles. Collective."""
        p, lists = self.particles, self.lists
        if self._spring_width() > lists.width:
            raise ValueError("The contact law now has rolling friction, for which the contacts keep no springs; make new "
                             "Contacts with this law.")
        if self.walls != lists.walls:
            self.lists = lists.with_walls(list(self.walls), self.step, self.layout)
            self.layout, self.stale = p.layout if self.layout is not None else None, True
        elif largest_of(p.comm, float(self.lists.take_up() and self.layout == p.layout))[0]:
            self.stale = True
        for block, law in ((self.pair_block, self.law), (self.wall_block, self.wall_law)):
            if not isinstance(law, ArrayLaw):
                constant_rows(block.rows, law.numbers)

    def network(self) -> dict[str, np.ndarray]:
        """Contacts between particles now, each once over all ranks, by the rank of their first particle.

        Returns:
            dict: ``position`` (contacts, 2, 3) of both centres [m], ``id`` (contacts, 2), ``overlap`` (contacts,) [m],
            ``normal_force`` (contacts,) and ``tangential_force`` (contacts, 3) on the first particle [N], those of the
            springs without damping. Of an :class:`ArrayLaw` forces are not known.

        Note:
            Not collective.
        """
        return network_of(self)

    @property
    def rebuilds(self) -> int:
        """How often the neighbour lists were made."""
        return self.lists.rebuilds

    def step_limit(self) -> float:
        """Largest sub-step [s]: the shortest contact time in the run over ``steps_per_contact``.

        Where more than three pieces of wall meet in one point their stiffnesses add up.
        """
        return step_limit(self.particles, self.law, self.wall_law if self.walls else None,
                          self.lists.meeting) / self.steps_per_contact

    def advance(self, dt: float) -> None:
        """Advance the particles by ``dt`` [s] in velocity Verlet sub-steps."""
        p, tick, dt = self.particles, time.perf_counter(), positive_number("time step", dt)
        self._check_parts()
        for wall in self.walls:
            wall.follow(self.time + 0.5 * dt)
        self.time, renewing = self.time + dt, self.seconds["neighbours"]
        if not p.total_number:
            self.steps_last = 0
            self.lists.move_alone(dt)
            return  # none have come yet, or all have left
        self._take_up()
        if p.all_held() and not self.lists.has_moving_shapes():
            self.steps_last = 0
            return  # nothing can move
        self.steps_last = max(int(np.ceil(dt / self.step_limit() - 1e-9)), 1)
        h, done = dt / self.steps_last, 0
        self.lists.prepare_turns(h)
        self.wall_impulse = np.zeros((max(len(self.walls), 1), 6))
        self.lists.load[:, 7] = 0.0
        if self.layout != p.layout:
            self._rebuild(h)
            self._first_forces()
            self.wall_impulse[:] = self.lists.load[:, 7] = 0.0  # they belong to no sub-step
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
        p.mean_contact_force = mean_contact_force(p.velocity, start, p.held, p.inertia, p.gravity, p.force, dt)
        for wall, impulse in zip(self.walls, total_of(p.comm, self.wall_impulse)):
            wall.force, wall.torque = impulse[:3] * h / dt, impulse[3:] * h / dt
        self.lists.move_walls()
        self.seconds["contacts"] += time.perf_counter() - tick - (self.seconds["neighbours"] - renewing)

    def _drive(self, dt):
        """What moves the particles besides contacts, in every sub-step of the step; it travels with them."""
        p = self.particles
        self.fades = int(largest_of(p.comm, p.relaxation_rate.max(initial=0.0))[0] > 0)
        if self.fades:
            rows = motion.forces_in_step(p.position, p.force, p.mean_contact_force, p.inertia, p.gravity, p.relaxation_rate,
                                         p.held, dt, self.steps_last)
        else:
            rows = external_force(p.held, p.inertia, p.gravity, p.force), np.zeros((len(p), 0))
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
        rows, drift = lists.pack(external, fading), Drift(external, lists.inverse_inertia, lists.x0, fading)
        steps = (self._steps if isinstance(self.law, ArrayLaw) else self._compiled_steps)(h, most, drift)
        self._check_behind()
        self._check_finite()
        p.position, p.velocity, p.angular_velocity, p.contact_force, p.contact_torque = (np.empty((n, 3)) for _ in range(5))
        unpack(rows, drift, 0.5 * h, p.position, p.velocity, p.angular_velocity, p.contact_force, p.contact_torque)
        return steps

    def _steps(self, h, most, drift):
        """Sub-steps with any law."""
        lists, rows, part, steps = self.lists, self.lists.rows, 0.5, 0
        self.stale = False
        while steps < most and not self.stale:
            moved, _, _ = _drift_on(rows, drift, part, h, 0, len(self.particles))
            part, steps = 1.0, steps + 1
            lists.ghosts.forward_state(rows.x, rows.state)
            rows.force[len(self.particles):] = 0.0
            if lists.has_shapes:
                push_walls(lists.load, lists.motion, self.ranks, h)
                move_walls(lists.kind, lists.shape, lists.motion, h)
                carry_facets(lists.facets, lists.carried, lists.motion, lists.turn, h)
            moved = largest(self.ranks, moved)
            self._forces(h, moved)
            lists.age += 1
            self.stale = not moved <= 1 or lists.wall_rate * h * lists.age > 1 or bool(
                lists.load[:, 6].max() > lists.wall_room)
        return steps

    def _compiled_steps(self, h, most, drift):
        """The same in one call, with a built-in law."""
        lists = self.lists
        steps, self.stale, self.touching, behind, self.largest_overlap, *near = ahead.sub_steps(
            most, h, lists.age, (lists.wall_rate, lists.wall_room), self._assembly(drift), lists.ghosts.rows(), lists.tiles,
            lists.near, self.step, self.largest_overlap)
        self.step, lists.age, lists.near = self.step + steps, lists.age + steps, Near(*near)
        self.behind = behind if behind >= 0 else self.behind
        return steps

    def _first_forces(self):
        """Contact forces of particles that came from outside: the first half kick needs them."""
        p, n = self.particles, len(self.particles)
        p.contact_force, p.contact_torque = np.zeros((n, 3)), np.zeros((n, 3))
        rows = self.lists.pack(p.contact_force, np.zeros((0, 0)))
        self._forces(0.0, 0.0)
        self._check_behind()
        self._check_finite()
        p.contact_force, p.contact_torque = rows.force[:n, :3].copy(), rows.force[:n, 4:7].copy()

    def _assembly(self, drift):
        """All that compiled sub-steps with built-in laws act on and with."""
        lists, law = self.lists, self.law.numbers
        walls = lists.wall_rows(self.wall_impulse, np.array([self.largest_overlap]))
        return Assembly(lists.rows, drift, lists.pairs, lists.candidates, lists.near_facets, lists.shape_entries(), walls,
                        self.pair_block, self.wall_block, law, getattr(self.wall_law, "numbers", law))  # or an ArrayLaw

    def _forces(self, h, moved):
        """Wall and pair forces at one instant, when particles have moved by up to ``sqrt(moved)`` of their room."""
        self.step += 1
        if isinstance(self.law, ArrayLaw):
            return self._array_forces(h, moved)
        lists, none = self.lists, np.zeros((0, 4))
        near = Near(*_near_numbers(moved, lists.candidates, lists.near)) if moved else lists.near
        _, _, self.touching, behind, self.largest_overlap, *near = ahead.sub_steps(
            0, h, lists.age, (lists.wall_rate, lists.wall_room), self._assembly(Drift(none, none[:, 0], none, none)),
            lists.ghosts.rows(), lists.tiles, near, self.step, self.largest_overlap)
        lists.near = Near(*near)
        self.behind = behind if behind >= 0 else self.behind
        note_forces(lists.load, self.wall_impulse)
        return None

    def _array_forces(self, h, moved):
        """The same for an array law."""
        lists, touching_walls = self.lists, 0
        walls = lists.wall_rows(self.wall_impulse, np.array([self.largest_overlap]))
        if self.walls:
            lists.near = Near(*_near_numbers(moved, lists.candidates, lists.near))
            listed = lists.candidates.wall_listed[:lists.near.facets]
            touching_walls, behind = _forces_of_walls(lists.rows, listed, lists.near_facets, lists.shape_entries(), walls,
                                                      self.wall_block, self.wall_law.numbers, self.step, h)
            self.behind = behind if behind >= 0 else self.behind
        touching, overlap = array_forces(self.law, lists.rows, lists.pairs, self.step, h)
        note_forces(lists.load, self.wall_impulse)
        self.touching = touching + touching_walls
        self.largest_overlap = max(self.largest_overlap, overlap, walls.deepest[0])
