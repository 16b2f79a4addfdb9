"""Boundaries that particles may leave through, rebound from, or come in through at a mass rate."""
import json
import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from fe_el.checks import (
    finite_vector,
    numbers,
    of_kind,
    positive_number,
    require_positive,
    require_tags,
    seed_number,
    whole_number,
)
from fe_el.compiled.cache import njit
from fe_el.mesh import cell_mesh as _mesh
from fe_el.particles.contacts.walls import facet_balls, facet_frames, nearest_point
from fe_el.particles.sources import inward_facets

if TYPE_CHECKING:
    from fe_el.particles.particles import Particles

NEAR = 24  # facets with the nearest middles, among which is the one that a particle went through


class OpenBoundaries:
    """Tells whether a particle outside the mesh left through one of the named boundary groups.

    Note:
        Collective.
    """

    def __init__(self, mesh, facet_tags, groups):
        groups = _mesh.require_groups(mesh, facet_tags, groups)
        self.corner, is_open = _mesh.exterior_facets(mesh, facet_tags, groups)
        self.open = is_open
        self.tree, self.frames = cKDTree(self.corner.mean(1)), facet_frames(self.corner)

    def left_through(self, position, velocity):
        """(points,) whether each position outside the mesh was reached through an open facet.

        That is so if the nearest facet of the boundary is open, or the first one on the way back along the velocity.
        """
        return _left(_near(self.tree, position), self.corner, self.frames, self.open, position, velocity)


class Rebounds:
    """Turns particles back whose centres went through boundary groups.

    Args:
        particles (Particles): the particles.
        facet_tags, groups: boundary facets.
        restitution (float): normal velocity after over that before, from 0 to 1.

    Note:
        Collective.
    """

    def __init__(self, particles, facet_tags, groups, restitution):
        groups = _mesh.require_groups(particles.mesh, facet_tags, groups)
        self.corner, self.solid = _mesh.exterior_facets(particles.mesh, facet_tags, groups)
        self.tree, self.frames, self.restitution = cKDTree(self.corner.mean(1)), facet_frames(self.corner), restitution
        size = 1e-3 * np.linalg.norm(self.corner[:, 1] - self.corner[:, 0], axis=1)
        ahead = particles.search(self.corner.mean(1) + size[:, None] * self.frames[:, 9:]) >= 0
        self.frames[np.any(particles.comm.allgather(ahead), axis=0), 9:] *= -1  # outwards

    def turn_back(self, position, velocity, rows):
        """Mirror places and velocities of some rows at the facet that each went through; returns how many were."""
        if not len(rows):
            return 0
        return _turn_back(_near(self.tree, position[rows]), self.corner, self.frames, self.solid, self.restitution, position,
                          velocity, rows)


def _near(tree, position):
    """Facets with the nearest middles (points, facets)."""
    return tree.query(position, k=min(NEAR, tree.n))[1].reshape(len(position), -1)


@njit
def _nearest(facets, corner, x):
    """The facet that a point is nearest to."""
    best, least = -1, np.inf
    for f in facets:
        qx, qy, qz, _, _, _ = nearest_point(corner[f], x[0], x[1], x[2])
        distance = (qx - x[0]) ** 2 + (qy - x[1]) ** 2 + (qz - x[2]) ** 2
        if distance < least:
            best, least = f, distance
    return best


@njit
def _left(near, corner, frame, is_open, position, velocity):
    """See :meth:`OpenBoundaries.left_through`."""
    out = np.zeros(len(position), np.bool_)
    for i in range(len(position)):
        out[i] = is_open[_nearest(near[i], corner, position[i])]
        if not out[i]:
            back = _first_crossed(frame, position[i], -velocity[i])
            out[i] = back >= 0 and is_open[back]
    return out


@njit
def _turn_back(near, corner, frame, solid, restitution, position, velocity, rows):
    """See :meth:`Rebounds.turn_back`; the facet is the first on the way back, or else the nearest."""
    turned = 0
    for n in range(len(rows)):
        x, v = position[rows[n]], velocity[rows[n]]
        back = _first_crossed(frame[near[n]], x, -v)
        f = near[n, back] if back >= 0 else _nearest(near[n], corner, x)
        beyond = speed = 0.0
        for k in range(3):
            beyond += frame[f, 9 + k] * (x[k] - frame[f, k])
            speed += frame[f, 9 + k] * v[k]
        if not solid[f] or beyond <= 0:
            continue
        turned += 1
        for k in range(3):
            x[k] -= (1 + restitution) * beyond * frame[f, 9 + k]
            v[k] -= (1 + restitution) * max(speed, 0.0) * frame[f, 9 + k]
    return turned


@njit
def _first_crossed(frame, x, direction):
    """First facet that a ray crosses, or -1; of several at an edge the first in the list."""
    first, least = -1, np.inf
    for f in range(len(frame)):
        along = frame[f, 9] * direction[0] + frame[f, 10] * direction[1] + frame[f, 11] * direction[2]
        if along == 0.0:
            continue
        px, py, pz = x[0] - frame[f, 0], x[1] - frame[f, 1], x[2] - frame[f, 2]
        t = -(frame[f, 9] * px + frame[f, 10] * py + frame[f, 11] * pz) / along
        if 0 <= t < least:
            px, py, pz = px + t * direction[0], py + t * direction[1], pz + t * direction[2]
            v = frame[f, 3] * px + frame[f, 4] * py + frame[f, 5] * pz
            w = frame[f, 6] * px + frame[f, 7] * py + frame[f, 8] * pz
            if min(v, w, 1 - v - w) >= -1e-9:
                first, least = f, t
    return first


class Inlet:
    """Lets particles in through tagged boundary facets at a mass rate, at random places, never onto other particles.

    What finds no free place waits for the next call; ``waiting`` counts its mass.

    Args:
        particles (Particles): the particles.
        facet_tags, group: boundary facets.
        mass_rate (float): [kg/s].
        diameter: one number, an array to draw from, or a function ``(generator, count) -> diameters`` [m].
        velocity: of what comes in [m/s].
        density, material, coarse_graining: as in ``Particles.insert_at``.
        seed (int): of the places and sizes.

    Attributes:
        inserted (int), waiting (float): particles let in so far, and the mass that still waits [kg].

    Raises:
        ValueError: for a rate or diameter that is not positive, or a group without facets.

    Note:
        Collective.
    """

    def __init__(self, particles: "Particles", facet_tags: Any, group: int | str, mass_rate: float,
                 diameter: ArrayLike | Callable[[np.random.Generator, int], ArrayLike], velocity: ArrayLike,
                 density: float | None = None, seed: int = 0, tries: int = 100, **kind: Any) -> None:
        from fe_el.particles.particles import Particles  # which imports this module
        of_kind("particles", particles, Particles)
        require_tags("facet tags of an inlet", facet_tags, particles.mesh)
        mass_rate = positive_number("mass rate", mass_rate)
        if not callable(diameter) or isinstance(diameter, type):
            require_positive("diameter", diameter)
            if not numbers("diameter", diameter).size:
                raise ValueError("The diameter of an inlet is empty; give a number, several to draw from, or a function.")
        tries, seed = whole_number("number of tries", tries, 1), seed_number(seed)
        for name in kind:
            if name not in ("material", "coarse_graining"):
                raise ValueError(f"An inlet has no argument {name!r}; its particles may have material and coarse_graining.")
        whole_number("material", kind.get("material", 0), 0)
        positive_number("coarse graining", kind.get("coarse_graining", 1.0))
        self.particles, self.mass_rate, self.diameter = particles, mass_rate, diameter
        self.tries, self.kind = tries, kind
        self.density = positive_number("density", particles.default_density if density is None else density)
        self.velocity = finite_vector("velocity", velocity)
        self.corner, self.area, self.normal = inward_facets(particles, facet_tags, group)
        every, chosen = _mesh.exterior_facets(particles.mesh, facet_tags,
                                              _mesh.require_groups(particles.mesh, facet_tags, group))
        self.others, self.balls = every[~chosen], facet_balls(every[~chosen]) if not chosen.all() else np.zeros((0, 7))
        self.generator = np.random.default_rng(seed)
        self.inserted, self.waiting = 0, 0.0
        self.next: float | None = None  # diameter of the one that waits [m]
        self._said = False

    def _draw_diameter(self) -> float:
        if callable(self.diameter):
            d = float(np.ravel(self.diameter(self.generator, 1))[0])
            require_positive("diameter", d)
            return d
        choices = np.ravel(self.diameter)
        return float(choices[self.generator.integers(len(choices))])

    def advance(self, dt: float) -> int:
        """Let in the mass of ``dt`` [s]; returns the number of new particles."""
        self.waiting += self.mass_rate * positive_number("time step", dt)
        near, radii = self._particles_near()
        new: list[np.ndarray] = []
        sizes: list[float] = []
        while True:
            self.next = size = self.next or self._draw_diameter()
            mass = self.density * np.pi / 6 * size ** 3
            place = self._free_place(near, radii, size / 2, dt) if mass <= self.waiting else None
            if place is None:
                self._say_too_large(size, not len(near) and mass <= self.waiting)
                break
            new.append(place)
            sizes.append(size)
            near, radii = np.vstack([near, place]), np.append(radii, size / 2)
            self.waiting -= mass
            self.next = None
        if new:
            self.particles.insert_at(np.array(new), np.array(sizes), self.density, self.velocity, **self.kind)
            self.inserted += len(new)
        return len(new)

    def _say_too_large(self, size, alone):
        """Warn once of a particle that finds no place although there is none near."""
        if alone and not self._said:
            self._said = True
            warnings.warn(f"A particle of diameter {size:g} m found no place at the inlet in {self.tries} tries, though no "
                          "other is near: it waits, as it may be too large for the opening. Make the particles smaller, the "
                          "boundary group larger, or tries= more.", RuntimeWarning, stacklevel=3)

    def _particles_near(self):
        """Positions and radii of all particles near the inlet, on every rank."""
        p = self.particles
        largest = p.comm.allreduce(p.diameter.max() if len(p) else 0.0, op=MPI.MAX)
        reach = 2 * max(largest, self.next or 0.0, np.max(self.diameter) if not callable(self.diameter) else largest) \
            + np.ptp(self.corner, (0, 1)).max() * 1e-9
        lower, upper = self.corner.min((0, 1)) - 2 * reach, self.corner.max((0, 1)) + 2 * reach
        inside = ((p.position >= lower) & (p.position <= upper)).all(1)
        parts = p.comm.allgather((p.position[inside], p.diameter[inside] / 2))
        return np.concatenate([x for x, _ in parts]), np.concatenate([r for _, r in parts])

    def _free_place(self, near, radii, radius, dt):
        """A random centre one radius inside the facets that touches nothing, or None after some tries."""
        rng, d = self.generator, self.corner.shape[1]
        for _ in range(self.tries):
            f = rng.choice(len(self.area), p=self.area / self.area.sum())
            weight = rng.dirichlet(np.ones(d))
            depth = radius * (1 + 1e-9) + rng.random() * max(self.velocity @ self.normal[f], 0.0) * dt
            x = weight @ self.corner[f] + depth * self.normal[f]
            if len(near) and (((near - x) ** 2).sum(1) < (radii + radius) ** 2).any():
                continue
            if self._touches_boundary(x, radius):
                continue
            if self.particles.comm.allreduce(int((self.particles.search(x[None]) >= 0).any())):
                return x
        return None

    def _touches_boundary(self, x, radius):
        """Whether a sphere at x reaches the boundary beside the inlet."""
        gap = x - self.balls[:, :3]
        close = np.flatnonzero(((gap ** 2).sum(1) < (radius + self.balls[:, 3]) ** 2)
                               & (np.abs((gap * self.balls[:, 4:]).sum(1)) < radius))
        return any(np.sum((np.array(nearest_point(self.others[f], *x)[:3]) - x) ** 2) < radius ** 2 for f in close)

    def saved(self) -> dict[str, tuple]:
        """What waits, and the state of the random numbers."""
        return {"same": (None, {"inserted": self.inserted, "waiting": self.waiting,
                                "next": np.nan if self.next is None else self.next,
                                "generator": json.dumps(self.generator.bit_generator.state)})}

    def restore(self, state: dict[str, dict]) -> None:
        """Take them back."""
        same = state["same"]
        self.inserted, self.waiting = int(same["inserted"]), float(same["waiting"])
        self.next = None if np.isnan(same["next"]) else float(same["next"])
        self.generator.bit_generator.state = json.loads(same["generator"])
