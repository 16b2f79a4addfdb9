"""The particles: a structure of arrays on the cells of a mesh, each particle owned by the rank of its cell."""
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from fe_el.checks import finite_vector, numbers, positive_number, require_mesh, require_positive, require_tags, seed_number
from fe_el.parallel.failures import end_all_ranks_on_errors
from fe_el.particles import insertion, motion, rows
from fe_el.particles.array_checks import check_arrays, check_velocities
from fe_el.particles.arrays import FIELDS
from fe_el.particles.balance import Balanced
from fe_el.particles.held import Held
from fe_el.particles.open_boundaries import OpenBoundaries, Rebounds
from fe_el.particles.saved_particles import SavedParticles

if TYPE_CHECKING:
    from fe_el.particles.contacts.contacts import Contacts
    from fe_el.particles.multiphase_pic import MultiphasePIC


class Particles(SavedParticles, Held, Balanced):
    """Spheres with position [m], velocity [m/s], angular velocity [1/s], diameter [m] and density [kg/m^3].

    A parcel stands for ``number`` particles of ``primary_diameter``, whole or not, each parcel for its own: ``diameter`` is
    that of the sphere of their volume, with which it collides and is mapped; it has their mass, the drag of each of them,
    and contacts that last as long as theirs.

    Every array has one row per particle of this rank, in an order that may change when they are advanced; ``id`` is unique
    over all ranks and never changes. ``force`` [N] is added during :meth:`advance` (the coupling writes it).
    ``relaxation_rate`` [1/s] is that of the drag in it: velocity and position follow the relaxation at this rate that gives
    the impulse of ``force``; zero: a constant force. ``properties`` holds user arrays that travel along;
    ``properties["added_mass"]`` [kg], where the coupling sets it, is the inertia of fluid that moves with a particle, and
    ``force`` then that on both, less the weight of the added mass.

    Args:
        mesh: dolfinx mesh of triangles or tetrahedra.
        density (float): default density of inserted particles [kg/m^3].
        gravity: acceleration (three numbers) [m/s^2].
        thickness (float): depth of a two-dimensional mesh [m].

    Note:
        Collective.
    """

    def __init__(self, mesh: Any, density: float, gravity: ArrayLike = (0.0, 0.0, 0.0), thickness: float = 1.0) -> None:
        require_mesh(mesh)
        density, thickness = positive_number("density", density), positive_number("thickness", thickness)
        end_all_ranks_on_errors(mesh.comm)
        self.mesh, self.comm, self.default_density = mesh, mesh.comm, density
        self.gravity = finite_vector("gravity", gravity)
        self.thickness, self.halo_width, self.step = thickness, -1.0, 0
        self.left, self.left_mass, self._open, self._rebounds, self._place = 0, 0.0, None, None, None
        for name, shape in FIELDS.items():
            setattr(self, name, np.zeros((0, *shape)))
        self.cell, self.id, self.material = np.zeros(0, np.int32), np.zeros(0, np.int64), np.zeros(0, np.int32)
        self.held = np.zeros(0, bool)
        self.period = getattr(mesh, "period", None)
        self.properties, self.next_id, self.layout = {}, 0, 0
        self._room: dict[str, np.ndarray] = {}  # memory of the arrays, longer than they are
        self.reach_halo(0.0)

    # -- insertion -------------------------------------------------------------------------------------------------

    def insert_at(self, position: ArrayLike, diameter: ArrayLike, density: ArrayLike | None = None,
                  velocity: ArrayLike = 0.0, material: ArrayLike = 0, coarse_graining: ArrayLike = 1.0,
                  displacement: float = 0.0, seed: int = 0, number: ArrayLike | None = None) -> None:
        """Insert particles at positions (particles, 2 or 3) [m], given alike on every rank.

        Each is displaced at random by at most ``displacement`` [m] along each axis: equal beads on a lattice would fall as
        columns and stand as a cubic stack; a thousandth of the diameter is enough.

        ``diameter`` is that of the sphere that collides; with ``coarse_graining`` above 1 it is a parcel's, which stands
        for ``number`` particles; absent: ``coarse_graining``^3. Either is one, or one per particle.
        ``material`` is the index (one, or one per particle) into the table of the contact law.

        Raises:
            ValueError: for a position outside the mesh, not finite, or a diameter or density that is not positive; nothing
                is inserted then.

        Note:
            Collective.
        """
        given = insertion.check(self, position, diameter, density, velocity, material, coarse_graining, number)
        x = given.position
        x[:, :self.mesh.topology.dim] += insertion.displacements(len(x), self.mesh.topology.dim, displacement, seed)
        self.reach_halo(3.0 * given.diameter.max())
        cell = insertion.claim(self, x)
        mine = np.flatnonzero(cell >= 0)
        new: dict[str, np.ndarray] = {name: np.zeros((len(mine), *shape)) for name, shape in FIELDS.items()}
        for name in ("position", "velocity", "diameter", "density", "number", "material"):
            new[name] = getattr(given, name)[mine]
        new |= {"cell": cell[mine], "id": self.next_id + mine, "held": np.zeros(len(mine), bool)}
        for name, a in new.items():
            own, self._room[name] = rows.appended(getattr(self, name), a, self._room.get(name))
            setattr(self, name, own)
        for name, a in self.properties.items():
            nothing = np.zeros((len(mine), *a.shape[1:]), a.dtype)
            self.properties[name], self._room["property " + name] = rows.appended(
                a, nothing, self._room.get("property " + name))
        self.next_id += len(x)
        self.layout += 1

    def insert_in_box(self, lower: ArrayLike, upper: ArrayLike, count: int, diameter: ArrayLike,
                      density: ArrayLike | None = None, velocity: ArrayLike = 0.0, seed: int = 0,
                      without_overlap: bool = False, walls: Sequence[Any] = (), **kind: Any) -> None:
        """Insert ``count`` particles at random in a box; ``diameter`` is a number or one per particle [m].

        ``without_overlap``: they overlap neither each other nor particles that are there already, and lie wholly inside the
        boundary of the mesh and off the ``walls``, for instance those of :class:`Contacts`.

        ``kind``: ``material``, ``coarse_graining`` and ``number`` as in :meth:`insert_at`.

        Raises:
            ValueError: if the box is not inside the mesh, or too small for particles without overlap.

        Note:
            Collective.
        """
        lower, upper = insertion.check_box(self, lower, upper)
        require_positive("diameter", diameter)
        insertion.check_walls(walls)
        there = near = None
        if without_overlap:
            radius = 0.5 * numbers("diameter", diameter).max()
            there = insertion.spheres_near(self, lower, upper, radius)
            near = insertion.boundary_near(self, lower, upper, radius)
            for wall in walls:
                if hasattr(wall, "corners"):
                    near = np.concatenate([near.reshape(-1, 3, 3), wall.corners()])
        x = insertion.random_positions(lower, upper, count, diameter, seed, without_overlap, self.period, there, near,
                                       insertion.shapes_of(walls))
        self.insert_at(x, diameter, density, velocity, **kind)

    def insert_on_lattice(self, lower: ArrayLike, upper: ArrayLike, diameter: ArrayLike, density: ArrayLike | None = None,
                          velocity: ArrayLike = 0.0, seed: int = 0, **kind: Any) -> None:
        """Fill a box from below with particles of the given diameters (particles,), shuffled, that do not touch.

        Raises:
            ValueError: if the box is too small.

        Note:
            Collective.
        """
        lower, upper = insertion.check_box(self, lower, upper)
        require_positive("diameter", diameter)
        seed = seed_number(seed)
        diameter = np.random.default_rng(seed).permutation(np.atleast_1d(np.asarray(diameter, float)))
        self.insert_at(insertion.lattice_positions(lower, upper, diameter, seed), diameter, density, velocity, **kind)

    def remove_at(self, facet_tags: Any, groups: int | str | Sequence[int | str]) -> None:
        """Let particles leave through boundary groups: they are removed, and counted in ``left`` and ``left_mass`` [kg].

        Raises:
            ValueError: if a group has no facet.

        Note:
            Collective.
        """
        require_tags("facet tags of an outlet", facet_tags, self.mesh)
        self._open = OpenBoundaries(self.mesh, facet_tags, groups)

    def rebound_at(self, facet_tags: Any, groups: int | str | Sequence[int | str], restitution: float = 1.0) -> None:
        """Let particles rebound where their centres meet boundary groups, without contacts: for dilute flow.

        The normal velocity is turned around and multiplied by ``restitution``; there is no friction.

        Raises:
            ValueError: if a group has no facet, or for a restitution that is not from 0 to 1.

        Note:
            Collective.
        """
        require_tags("facet tags of a wall", facet_tags, self.mesh)
        if numbers("restitution", restitution).ndim or not 0 <= restitution <= 1:
            raise ValueError(f"The restitution of a rebound is {restitution}; give a number from 0 to 1.")
        self._rebounds = Rebounds(self, facet_tags, groups, float(restitution))

    # -- order and ranks -------------------------------------------------------------------------------------------

    def _in_place_of(self, out, stay, name, a, new, in_order):
        """Array without the rows ``out`` and with new ones."""
        if in_order:
            return np.concatenate([a[stay], new])
        a, self._room[name] = rows.replaced(a, out, new, self._room.get(name))
        return a

    # -- motion ----------------------------------------------------------------------------------------------------

    def advance(self, dt: float, contacts: "Contacts | MultiphasePIC | None" = None) -> None:
        """Advance by ``dt`` [s] under gravity, ``force`` and, if given, contacts in sub-steps; held particles stay.

        Raises:
            LostParticle: if a particle leaves the mesh.
            FloatingPointError: if a velocity is no longer finite.

        Note:
            Collective.
        """
        positive_number("time step", dt)
        if contacts is not None and getattr(contacts, "particles", None) is not self:
            raise ValueError(f"The contacts are {contacts!r}, not those of these particles; pass Contacts(particles, ...).")
        self.gravity = finite_vector("gravity", self.gravity)
        check_arrays(self)
        self.step += 1
        self.say_balance()
        if contacts is None:
            late = self.properties.pop("_late", np.zeros(0))
            if self.all_held():
                return
            motion.free_flight(self.position, self.velocity, self.force, self.inertia, self.gravity, self.relaxation_rate,
                               self.held, late, dt)
        else:
            self._advance_with(contacts, dt)
        check_velocities(self)
        if contacts is None:
            self.locate(in_order=False)
            self.put_in_order()

    def _advance_with(self, contacts, dt):
        """A step with contacts; those who came in late are put back along the way of a whole step, and fell for less."""
        came = "_late" in self.properties
        if came:
            self.properties["_came_at"] = self.position.copy()
        contacts.advance(dt)
        if came:
            late, way = self.properties.pop("_late"), self.position - self.properties.pop("_came_at")
            if self.period is not None:
                period = np.where(self.period > 0, self.period, np.inf)
                way -= np.where(self.period > 0, np.round(way / period) * self.period, 0.0)
            self.position -= late[:, None] * way
            self.velocity -= late[:, None] * dt * np.where(self.held[:, None], 0.0, self.gravity)
            self.locate()

    def momentum(self) -> np.ndarray:
        """Total momentum of all particles (3,) [kg m/s]."""
        return self.comm.allreduce((self.mass[:, None] * self.velocity).sum(0))

    def kinetic_energy(self) -> float:
        """Kinetic energy of all particles, translation and rotation [J]."""
        inertia = 0.1 * self.mass * self.diameter ** 2
        return self.comm.allreduce(0.5 * float((self.mass * (self.velocity ** 2).sum(1)).sum()
                                               + (inertia * (self.angular_velocity ** 2).sum(1)).sum()))
