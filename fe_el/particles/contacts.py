"""Contacts between particles and with walls: neighbour lists, ghosts and the sub-steps."""
import time

import numpy as np
from mpi4py import MPI

from fe_el import mesh as _mesh
from fe_el.exchange import Halo, move
from fe_el.particles import motion, neighbours, walls as _walls
from fe_el.particles.insertion import require_positive


class Contacts:
    """Contacts of particles under a contact law, in sub-steps of a fraction of the contact time.

    Args:
        particles (Particles): the particles.
        law (LinearSpringDashpot): law of particle-particle contacts.
        walls: ``(facet_tags, groups)``: boundary facets that are walls; absent: none.
        wall_law (LinearSpringDashpot): law of wall contacts; absent: ``law``.
        steps_per_contact (int): sub-steps in the shortest contact.
        skin (float): reach of the neighbour lists beyond contact [m]; absent: 0.2 of the mean radius.

    Raises:
        ValueError: for a boundary group without facets, or fewer than 10 steps per contact.

    Note:
        Collective.
    """

    def __init__(self, particles, law, walls=None, wall_law=None, steps_per_contact=50, skin=None):
        if not steps_per_contact >= 10:
            raise ValueError(f"steps_per_contact is {steps_per_contact}; at least 10 are needed to resolve a contact.")
        if skin is not None:
            require_positive("skin", skin)
        self.particles, self.law, self.wall_law = particles, law, wall_law or law
        self.steps_per_contact, self._skin = steps_per_contact, skin
        self.facets = _mesh.boundary_facets(particles.mesh, *walls) if walls is not None else None
        self.layout, self.springs, self.wall_springs = None, None, None
        self.seconds = {"neighbours": 0.0, "contacts": 0.0}
        self.touching, self.largest_overlap, self.rebuilds, self.steps_last = 0, 0.0, 0, 0

    def step_limit(self):
        """Largest sub-step [s]: the shortest contact time in the run over ``steps_per_contact``."""
        p = self.particles
        lightest = p.comm.allreduce(p.mass.min() if len(p) else np.inf, op=MPI.MIN)
        if not np.isfinite(lightest):
            raise ValueError("There are no particles; insert some before advancing contacts.")
        pair = self.law.contact_time(lightest / 2)
        wall = self.wall_law.contact_time(lightest) if self.facets is not None else np.inf
        return min(pair, wall) / self.steps_per_contact

    def advance(self, dt):
        """Advance the particles by ``dt`` [s] in velocity Verlet sub-steps."""
        p = self.particles
        self.steps_last = int(np.ceil(dt / self.step_limit() - 1e-9))
        h, done = dt / self.steps_last, 0
        if self.layout != p.layout:
            self._rebuild(h)
            self._first_forces()
        p.properties["_start_velocity"] = p.velocity.copy()
        while done < self.steps_last:
            tick = time.perf_counter()
            done += self._run(h, self.steps_last - done)
            self.seconds["contacts"] += time.perf_counter() - tick
            if done < self.steps_last:
                self._rebuild(h)
        external = p.mass[:, None] * p.gravity + p.force
        p.mean_contact_force = motion.mean_force(p.velocity, p.properties.pop("_start_velocity"), p.mass, external, dt)

    def _pack(self):
        """State of owned and ghost particles."""
        p, g = self.particles, self.ghosts
        grown = lambda a: self.halo.forward(np.concatenate([a, np.zeros((g, *a.shape[1:]))])) if g else a.copy()
        return grown(p.position), grown(p.velocity), grown(p.angular_velocity)

    def _run(self, h, most):
        """Sub-steps until the neighbour list is out of date; returns how many."""
        p, n = self.particles, len(self.particles)
        x, v, w = self._pack()
        mass = p.mass
        external = mass[:, None] * p.gravity + p.force
        force, torque = np.zeros_like(x), np.zeros_like(x)
        force[:n], torque[:n] = external + p.contact_force, p.contact_torque
        inverse_inertia = 10.0 / (mass * p.diameter ** 2)
        limit, part, steps = (0.5 * self.skin) ** 2, 0.5, 0
        while steps < most:
            moved = motion.kick_and_drift(x, v, w, force, torque, external, self.inverse_mass, inverse_inertia, self.x0,
                                          part, h, n)
            part, steps = 1.0, steps + 1
            if self.ghosts:
                for a in (x, v, w):
                    self.halo.forward(a)
                force[n:] = torque[n:] = 0.0
            self._forces(x, v, w, force, torque, h)
            if p.comm.size > 1:
                moved = p.comm.allreduce(moved, op=MPI.MAX)
            if not moved <= limit:
                break
        motion.kick(v, w, force, torque, self.inverse_mass, inverse_inertia, 0.5 * h, n)
        p.position, p.velocity, p.angular_velocity = x[:n].copy(), v[:n].copy(), w[:n].copy()
        p.contact_force, p.contact_torque = force[:n] - external, torque[:n].copy()
        return steps

    def _first_forces(self):
        """Contact forces of particles that came from outside: the first half kick needs them."""
        p, n = self.particles, len(self.particles)
        x, v, w = self._pack()
        force, torque = np.zeros_like(x), np.zeros_like(x)
        self._forces(x, v, w, force, torque, 0.0)
        p.contact_force, p.contact_torque = force[:n].copy(), torque[:n].copy()

    def _forces(self, x, v, w, force, torque, h):
        """Pair and wall forces at one instant, added to ``force`` and ``torque``."""
        self.touching, overlap = motion.pair_forces(x, v, w, force, torque, self.radius, self.inverse_mass, self.start,
                                                    self.neighbour, self.springs, self.law.numbers, h)
        self.largest_overlap = max(self.largest_overlap, overlap)
        if self.facets is not None:
            self.touching += _walls.wall_forces(
                x, v, w, force, torque, self.radius, self.inverse_mass, self.wall_particle, self.wall_start,
                self.wall_facet, self.wall_springs, self.facets[0], self.facets[1], self.wall_law.numbers, h)

    # -- lists -----------------------------------------------------------------------------------------------------

    def _rebuild(self, h):
        """Locate, migrate, sort, exchange ghosts and make the neighbour lists, keeping the tangential springs."""
        tick = time.perf_counter()
        p, comm = self.particles, self.particles.comm
        kept = self._collect()
        largest, total, number = comm.allreduce(p.diameter.max() if len(p) else 0.0, op=MPI.MAX), \
            comm.allreduce(p.diameter.sum()), comm.allreduce(len(p))
        self.skin = self._skin or 0.1 * total / number
        p.reach_halo(2 * (largest + self.skin))
        if self.facets is not None and getattr(self, "_reach", -1) < largest / 2 + self.skin or \
                self.facets is not None and self._cells is not p.cells:
            self._reach, self._cells = largest / 2 + self.skin, p.cells
            self._candidates = _walls.wall_candidates(p.cells, self.facets[0], self._reach)
        destination = p.locate()
        if destination is not None:
            kept = self._move_springs(kept, destination)
        order = self._sorted_order(largest + self.skin)
        place = np.empty_like(order)
        place[order] = np.arange(len(order))
        p.select(order)
        kept = [(place[particle], partner, spring) for particle, partner, spring in kept]
        self._ghosts(largest + self.skin)
        self._lists(kept)
        self.layout, self.x0 = p.layout, p.position.copy()
        self.rebuilds += 1
        self.seconds["neighbours"] += time.perf_counter() - tick

    def _collect(self):
        """Stretched springs of the present lists, of pairs and of walls."""
        none = (np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 3)))
        if self.springs is None or self.layout != self.particles.layout:
            return [none, none]
        n = len(self.particles)
        every = np.arange(n)
        pairs = neighbours.collect_springs(self.start, self.neighbour, self.ids, self.springs, n, every, True)
        if self.facets is None:
            return [pairs, none]
        facet_ids = np.arange(len(self.facets[2]))
        return [pairs, neighbours.collect_springs(self.wall_start, self.wall_facet, facet_ids, self.wall_springs, n,
                                                  self.wall_particle, False)]

    def _move_springs(self, kept, destination):
        """Send the springs of particles that changed rank after them."""
        comm, leaving, out = self.particles.comm, destination != self.particles.comm.rank, []
        place = np.cumsum(~leaving) - 1
        arrived_ids = {int(g): k for k, g in enumerate(self.particles.id)}
        for particle, partner, spring in kept:
            go = leaving[particle]
            who = self.ids[particle[go]] if len(particle) else particle
            ids, other, stretch = move(comm, destination[particle[go]], [who, partner[go], spring[go]])
            index = np.array([arrived_ids[int(g)] for g in ids], np.int64)
            out.append((np.concatenate([place[particle[~go]], index]), np.concatenate([partner[~go], other]),
                        np.concatenate([spring[~go], stretch])))
        return out

    def _sorted_order(self, size):
        """Order of the particles by boxes of two reaches, for cache locality."""
        x = self.particles.position
        if not len(x):
            return np.zeros(0, np.int64)
        box = ((x - x.min(0)) / (2 * size)).astype(np.int64)
        return np.lexsort((self.particles.id, box[:, 2], box[:, 1], box[:, 0]))

    def _ghosts(self, reach):
        """Find the particles other ranks need as ghosts: those within reach of a box around their particles."""
        p, comm = self.particles, self.particles.comm
        n = len(p)
        if comm.size == 1:
            send = receive = [[]]
        else:
            box = (p.position.min(0) - reach, p.position.max(0) + reach) if n else (np.full(3, np.inf), np.full(3, -np.inf))
            boxes = comm.allgather(box)
            send = [np.flatnonzero(((p.position >= lo) & (p.position <= hi)).all(1)) if r != comm.rank else []
                    for r, (lo, hi) in enumerate(boxes)]
            counts = comm.alltoall([len(s) for s in send])
            ends = n + np.cumsum(counts)
            receive = [np.arange(e - c, e) for c, e in zip(counts, ends)]
        self.halo = Halo(comm, send, receive)
        self.ghosts = sum(len(r) for r in receive)
        grown = lambda a: self.halo.forward(np.concatenate([a, np.zeros((self.ghosts, *a.shape[1:]), a.dtype)]))
        self.radius, self.inverse_mass, self.ids = grown(p.diameter / 2), grown(1 / p.mass), grown(p.id)

    def _lists(self, kept):
        """Neighbour and wall lists with the kept springs."""
        p = self.particles
        x, n = self._pack()[0], len(p)
        self.start, self.neighbour = neighbours.neighbour_list(x, self.radius, n, self.skin)
        self.springs = neighbours.restore_springs(self.start, self.neighbour, self.ids, np.arange(n), n, *kept[0])
        if self.facets is not None:
            self.wall_particle, self.wall_start, self.wall_facet = _walls.wall_list(
                x, self.radius, p.cell, self.skin, *self._candidates, self.facets[0])
            facet_ids = np.arange(len(self.facets[2]))
            self.wall_springs = neighbours.restore_springs(self.wall_start, self.wall_facet, facet_ids,
                                                           self.wall_particle, n, *kept[1])
