"""The lists that contacts run on: ghosts, neighbour pairs, particles near walls, and the springs of each."""
import numpy as np

from fe_el.mesh import cell_mesh as _mesh
from fe_el.parallel.exchange import largest_of
from fe_el.particles.contacts import neighbours, springs, step_ends, wall_lists, waves
from fe_el.particles.contacts import walls as _walls
from fe_el.particles.contacts.blocks import aligned
from fe_el.particles.contacts.in_tiles import InTiles
from fe_el.particles.contacts.records import Candidates, FacetRows, Facets, Near, Pairs, Rows, ShapeRows, WallRows
from fe_el.particles.contacts.room import Room
from fe_el.particles.contacts.saved_contacts import SavedLists
from fe_el.particles.contacts.sub_steps import FIRST, prune
from fe_el.particles.contacts.wall_patches import smooth_patches
from fe_el.particles.contacts.wall_shapes import FACETS, SURFACE, move_walls, shape_list
from fe_el.particles.contacts.wall_surfaces import rotation
from fe_el.particles.ghosts import Ghosts
from fe_el.particles.motion import primary_diameters


class ContactLists(SavedLists, Room, InTiles):
    """Neighbour pairs, facet contacts and contacts with planes and cylinders, as records for the compiled loops.

    Every particle has room to move in before the lists are out of date: half the skin, and more if it is fast. A pair is
    listed if its surfaces are closer than the room of both, a facet or wall if it is closer than the room of the particle,
    with the room of the walls themselves if these move.

    Args:
        particles (Particles): the particles.
        walls: list of walls.
        skin (float): reach beyond contact, alike for all pairs [m]; absent: such that a list lasts some hundred sub-steps.
        width (int): numbers kept per contact: tangential spring and normal velocity, and the rolling spring if any.
    """

    def __init__(self, particles, walls, skin, width):
        self.particles, self.walls, self._skin, self.width = particles, walls, skin, width
        self.skin, self.age, self.rebuilds, self._reach, self._cells = skin, 0, 0, -1.0, None
        self._ahead, self._most, self.wall_room, self.wall_rate = 0.0, np.inf, 0.0, 0.0
        self.meeting, self.facets = self._facets()
        self.kind, self.wall_top = np.array([w.kind for w in walls] or [FACETS], np.int64), 0.0
        self.motion, self.shape, self.wall_material = self._wall_rows()
        self.load = np.zeros((len(self.motion), 8))
        self.carried, self.turn = np.zeros(0, np.int64), np.tile(np.eye(3), (len(self.motion), 1, 1))
        self.tile_starts, self.strips, self.tile_layout, self.tiles = None, 1, None, waves.NONE
        self.ghosts, self.pairs, self.restored, self._springs = None, None, None, None
        self.has_shapes = bool((self.kind != FACETS).any())
        self.pose_surfaces()

    def _facets(self):
        """How many smooth pieces of wall meet in a point at most, and all facets of walls."""
        parts = [(_mesh.boundary_facets(self.particles.mesh, w.facet_tags, w.groups), k) for k, w in enumerate(self.walls)
                 if w.kind == FACETS]
        first = sum(len(f[2]) for f, _ in parts)
        self.surfaces, self.posed = {}, {}  # facets of each surface, and where it is posed
        for k, w in enumerate(self.walls):
            if w.kind == SURFACE:
                above = max((int(f[1].max()) for f, _ in parts), default=-1) + 1
                parts.append(((w.corners(), w.vertex + above, np.zeros(len(w.vertex))), k))
                self.surfaces[k] = slice(first, first + len(w.vertex))
                first += len(w.vertex)
        if not parts:
            return 1, Facets(np.zeros((0, 3, 3)), np.zeros((0, 3), np.uint32), np.zeros(0, np.uint32), np.zeros((0, 12)),
                             np.zeros((0, 2), np.int64))
        corner, vertex = (np.concatenate([f[i] for f, _ in parts]) for i in range(2))
        wall = np.concatenate([np.full(len(f[2]), k, np.uint32) for f, k in parts])
        self.balls, (patch, meeting) = _walls.facet_balls(corner), smooth_patches(corner, vertex)
        return meeting, Facets(corner, vertex.astype(np.uint32), wall, _walls.facet_frames(corner), patch)

    def _wall_rows(self):
        """Motion, shape and material of all walls."""
        return (np.array([w.motion() for w in self.walls] or [np.zeros(9)]),
                np.array([getattr(w, "shape", np.zeros(4)) for w in self.walls] or [np.zeros(4)]),
                np.array([w.material for w in self.walls] or [0], np.int64))

    def take_up(self):
        """Take up walls as the user has set them; whether these, or particles changed since, put the lists out of date."""
        before, shapes = (self.motion, self.shape), self.kind != FACETS
        self.motion, self.shape, self.wall_material = self._wall_rows()
        self._take_up_loads()
        self.pose_surfaces()
        jumped = (self.motion[:, :3] != before[0][:, :3]).any(1) | (self.shape != before[1]).any(1)
        faster = (self.motion[:, 3:] != before[0][:, 3:]).any() and self._wall_speed() > self.wall_top
        return bool((jumped & shapes).any()) or faster or self._particles_changed()

    def _take_up_loads(self):
        """Loads as the user has set them; the forces of the last sub-step stay."""
        for k, wall in enumerate(self.walls):
            self.load[k, :5] = wall.load_row()

    def pose_surfaces(self):
        """Put the facets of surfaces where these are now, and note which of them move."""
        moving = [self.carried[:0]]
        for k, rows in self.surfaces.items():
            wall = self.walls[k]
            if self.motion[k, 3:].any() or wall.load is not None:
                moving.append(np.arange(rows.start, rows.stop))
            if k not in self.posed or not np.array_equal(self.posed[k], (*wall.point, *wall.turned.flat)):
                self.facets.corner[rows] = wall.corners()
                self.facets.frame[rows] = _walls.facet_frames(self.facets.corner[rows])
                self.posed[k] = np.array((*wall.point, *wall.turned.flat))
                self._reach = -1.0  # cells have other facets near them
        self.carried = np.concatenate(moving)

    def prepare_turns(self, h):
        """Rotations of the surfaces in a sub-step of h [s]."""
        for k in self.surfaces:
            self.turn[k] = rotation(h * self.motion[k, 6:])

    def move_alone(self, dt):
        """Move the walls by ``dt`` [s] where there are no particles."""
        self.motion, self.shape, self.wall_material = self._wall_rows()
        self._take_up_loads()
        self.motion[:, 3:6] += dt * (self.load[:, 3] * self.load[:, 4])[:, None] * self.load[:, :3]
        move_walls(self.kind, self.shape, self.motion, dt)
        self.move_walls()

    def move_walls(self):
        """Tell planes and cylinders where they are now."""
        for k, wall in enumerate(self.walls):
            if wall.kind != FACETS:
                wall.moved(self.motion[k, :3], self.shape[k])
            if wall.kind == SURFACE:
                self.shape[k] = 0.0
            if wall.load is not None:
                wall.velocity = self.motion[k, 3:6].copy()

    def with_walls(self, walls, step, layout):
        """New lists for other walls, with the springs of all contacts that stay."""
        new, kept = ContactLists(self.particles, walls, self._skin, self.width), self.collect(step, layout)
        new.skin, new.rebuilds, new.restored = self.skin, self.rebuilds, ([kept[0]], self.particles.id.copy())
        for (particle, partner, spring), old, now in zip(kept[1:], *(x.of_walls() for x in (self, new))):
            to = np.full(len(old) + 1, -1)
            for k, wall in enumerate(self.walls):
                if wall in walls:
                    to[:-1][old == k] = np.flatnonzero(now == walls.index(wall))
            stays = to[partner] >= 0
            new.restored[0].append(springs.Kept(particle[stays], to[partner[stays]], spring[stays]))
        if self.ghosts is not None:
            self.ghosts.free()
        return new

    def of_walls(self):
        """Number of the wall of each partner in the lists of facets and of shapes."""
        return self.facets.wall, np.arange(len(self.walls))

    def pack(self, external, fading):
        """Fill the rows of owned and ghost particles from these, and return them; the same memory until renewed."""
        p, rows = self.particles, self.rows
        step_ends.pack(p.position, p.velocity, p.angular_velocity, external, fading, p.contact_force, p.contact_torque,
                       (rows.x, rows.state, rows.force))
        self.ghosts.forward_state(rows.x, rows.state)
        return rows

    def wall_rows(self, force, deepest):
        """All walls, with arrays for the forces on them and for the largest overlap."""
        return WallRows(self.motion, self.wall_material, force, deepest, self.load, self.carried, self.turn)

    def shape_entries(self):
        """Planes and cylinders near particles, and these as the user has set them."""
        return self.shapes._replace(kind=self.kind, shape=self.shape)

    # -- renewal -------------------------------------------------------------------------------------------------------

    def rebuild(self, h, step, layout):
        """Locate, migrate, sort, exchange ghosts and make the lists, keeping the springs of live contacts."""
        p, comm = self.particles, self.particles.comm
        kept = self.collect(step, layout, comm.size > 1 or p.period is not None)
        largest, speed, inverse, few = largest_of(comm, *((p.diameter.max(), p.speed(), 1 / p.diameter.min()) if len(p) else
                                                          np.zeros(3)), float(len(p) < waves.FROM))
        self._choose_skin(1 / max(inverse, 1e-300), largest, speed, h)
        self._choose_wall_room(largest, h)
        widest = self._room(speed)
        self._check_period(largest, widest)
        p.reach_halo(2 * (largest + self.skin))
        reach = largest / 2 + widest + (self.wall_room if len(self.carried) else 0.0)
        if len(self.facets.corner) and (self._reach < reach or self._cells is not p.cells or len(self.carried)):
            self._reach, self._cells, self.balls = 1.2 * reach, p.cells, _walls.facet_balls(self.facets.corner)
            self._in_cells = wall_lists.wall_candidates(p.cells, self.facets.corner, self.balls, self._reach)
        before, destination = p.id, p.locate()
        if destination is not None:
            kept = springs.moved(comm, kept, destination, before, p.id)
        if self._in_disorder(layout, not few):
            kept = self._sort(kept, largest + self.skin, not few)
        if self.ghosts is not None:
            self.ghosts.free()
        self.ghosts = Ghosts(comm, p.position, largest + 2 * widest, p.period)
        speeds = np.sqrt(np.einsum("ij,ij->i", p.velocity, p.velocity))
        room = self._room(speeds)
        x, pairs = self._pairs(room)
        radius, self.ids = self.ghosts.grow(p.diameter / 2), self.ghosts.grow(p.id)
        self.number = self.ghosts.grow(p.number)
        parcels = len(radius) if (self.number != 1).any() else 0
        self.rows = Rows(np.empty((len(radius), 3)), aligned(len(radius), 8), aligned(len(radius), 8), radius,
                         np.empty(len(radius)), self.ghosts.grow(p.material).view(np.uint32), np.empty((parcels, 2)))
        self.rows.state[:, 0] = radius
        self.weigh()
        self.x0, self.age = np.empty((len(p), 4)), 0
        left = room - h * speeds  # out of date a sub-step early
        self.x0[:, :3], self.x0[:, 3] = p.position, 1 / (left * left)
        self._lists(x, pairs, self.ghosts.grow(room), kept, step)
        self.load[:, 6] = 0.0
        self.rebuilds += 1

    def weigh(self):
        """Take the particles' inertia as it is now. Collective."""
        p = self.particles
        self.inverse_inertia = step_ends.inverse_inertia(p.held, p.mass, p.diameter)
        self.rows.inverse_mass[:] = self.ghosts.grow(np.where(p.held, 0.0, 1 / p.inertia))
        self.rows.state[:, 7] = self.rows.inverse_mass / self.rows.radius
        if len(self.rows.parcel):
            self.rows.parcel[:, 0] = self.number * self.rows.inverse_mass
            self.rows.parcel[:, 1] = primary_diameters(self.rows.radius, self.number)

    def _pairs(self, room):
        """Positions and pairs with the ghosts that have a partner here; the others are given up."""
        p, n = self.particles, len(self.particles)
        x = self.ghosts.grow(p.position)
        x[n:] += self.ghosts.shift
        before = 0 if self.pairs is None else len(self.pairs.first)
        first, second = neighbours.neighbour_pairs(x, self.ghosts.grow(p.diameter / 2 + room), n, before + before // 4)
        held = self.ghosts.grow(p.held)
        if held.any():  # two that are held have no reduced mass
            free = ~(held[first] & held[second])
            first, second = first[free], second[free]
        if self.particles.comm.size == 1 and not self.ghosts.number:
            return x, (first, second)
        used = np.zeros(len(x), bool)
        used[:n] = True
        used[second] = True
        self.ghosts.keep(used[n:])
        return x[used], (first, (np.cumsum(used) - 1).astype(np.uint32)[second])

    def _free(self, near):
        """The entries of particles that are not held; ``near`` has their particles first."""
        held = self.particles.held
        return [a[~held[near[0]]] for a in near] if held.any() else near

    def _lists(self, x, pairs, room, kept, step):
        """Pairs, facets and shapes near each particle, with the kept springs."""
        p, n, radius = self.particles, len(self.particles), self.rows.radius
        in_tiles = self.tile_layout == p.layout
        if in_tiles:
            *pairs, tiles = self._tiles(x, pairs)
        none, reach = (np.zeros(0, np.uint32),) * 2, radius + room
        facets, shapes, wall_gaps = none, none, np.zeros(0)
        if len(self.facets.corner):
            wider = reach + self.wall_room if len(self.carried) else reach
            near = wall_lists.wall_list(x, wider, p.cell, self._in_cells, self.facets.corner, self.balls)
            *facets, distance = self._free(near)
            wall_gaps = wall_lists.wall_gaps(facets[0], distance, radius, room)
            facets = [a.view(np.uint32) for a in facets]
        if self.has_shapes:
            near = shape_list(x, reach + self.wall_room, n, self.kind, self.shape, self.motion)
            shapes = [a.view(np.uint32) for a in self._free(near)]
        if len(self.carried):  # facets that move are always listed
            wall_gaps[np.isin(facets[1], self.carried)] = -np.inf
        gaps = neighbours.gaps(x, radius, room, *pairs), wall_gaps
        self.candidates = Candidates(*gaps, *(np.empty(len(a) + 1, np.uint32) for a in gaps))
        likely = [listed[:prune(gap, FIRST, listed)] for gap, listed in zip(gaps, self.candidates[2:])]
        self.near, self.tiles = Near(FIRST, *map(len, likely)), waves.NONE
        if in_tiles:
            facet_starts, shape_starts = (np.searchsorted(a, tiles.starts) for a in (facets[0], shapes[0]))
            self.tiles = tiles._replace(facets=facet_starts, shapes=shape_starts)
        memory = self._memory_of_pairs(len(pairs[0])), *(np.zeros((len(a[0]), self.width)) for a in (facets, shapes))
        empty = [(a, np.empty(len(a), np.int32)) for a in memory]
        self.pairs = Pairs(*pairs, *empty[0])
        self.near_facets = FacetRows(*facets, *empty[1], self.facets, _walls.scratch(facets[0]))
        self.shapes = ShapeRows(*shapes, *empty[2], self.kind, self.shape)
        likely.append(np.arange(len(shapes[0]), dtype=np.uint32))
        for where, some, old, (spring, stamp) in zip(self._partners(), likely, kept, empty):
            contacts = springs.by_particle(n, old.particle, old.partner)
            springs.restore_springs(*where, some, contacts, old.spring, where[2] is self.ids, step, spring, stamp)
        self.restored = None
