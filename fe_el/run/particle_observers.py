"""What one wants to know of a jet or a bed: averages of mapped particle fields, profiles, and mass through planes."""
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from dolfinx import fem
from numpy.typing import ArrayLike

from fe_el.checks import (
    finite_vector,
    function_or_class_of,
    numbers,
    positive_number,
    require_particles,
    whole_number,
)
from fe_el.coupling.mapping import mapping_of
from fe_el.dolfinx_api import scalar_space, vector_space
from fe_el.parallel.exchange import sums_of

if TYPE_CHECKING:
    from fe_el.particles.particles import Particles


class ParticleFieldAverage:
    """Time means and variances of the particles' fields on the cells; takes no more room the longer it runs.

    Args:
        particles (Particles): the particles.
        mapping, smoothing: as of :class:`Coupling`, with which the particles go to the cells; the mapping must be its own.

    Attributes:
        duration (float): time averaged over [s].

    Note:
        Collective.
    """

    def __init__(self, particles: "Particles", mapping: str | Any = "overlap_volume",
                 smoothing: Callable[[np.ndarray], np.ndarray] | None = None) -> None:
        require_particles(particles)
        if smoothing is not None:
            function_or_class_of("smoothing", smoothing, "for instance HelmholtzSmoothing(mesh, length), or leave it out")
        self.particles, self.mapping, self.smoothing = particles, mapping_of(mapping), smoothing
        self.duration, self.mesh, d = 0.0, particles.mesh, particles.mesh.topology.dim
        # of solid fraction, concentration, flux, and mass times squared velocity per volume
        self._mean = np.zeros((particles.cells.owned, 2 + 2 * d))
        self._sum = np.zeros((particles.cells.owned, 1 + d))

    def add(self, dt: float) -> None:
        """Add the particles of now with weight ``dt`` [s]."""
        p, d = self.particles, self.mesh.topology.dim
        n, weight = p.cells.owned, positive_number("weight of an average", dt)
        self.mapping.prepare(p.cells, *p.located(), 0.5 * p.diameter)
        v, out = p.velocity[:, :d], np.zeros((len(p.cells.volume), 2 + 2 * d))
        mass = p.mass[:, None]
        self.mapping.deposit(np.hstack([p.volume[:, None], mass, mass * v, mass * v ** 2]), out)
        now = p.halo.reverse_add(out)[:n] / p.cells.volume[:n, None]
        if self.smoothing is not None:
            now = self.smoothing(np.ascontiguousarray(now))
        self.duration += weight
        change = now - self._mean
        self._mean += change * weight / self.duration
        some = [0, *range(2, 2 + d)]
        self._sum += weight * change[:, some] * (now - self._mean)[:, some]

    @property
    def solid_fraction(self) -> np.ndarray:
        """(owned cells,) mean solid fraction."""
        return self._mean[:, 0]

    @property
    def concentration(self) -> np.ndarray:
        """(owned cells,) mean mass of particles per volume [kg/m^3]."""
        return self._mean[:, 1]

    @property
    def flux(self) -> np.ndarray:
        """(owned cells, d) mean mass flux of the particles [kg/(m^2 s)]."""
        return self._mean[:, 2:2 + self.mesh.topology.dim]

    @property
    def velocity(self) -> np.ndarray:
        """(owned cells, d) mean velocity of the particles, by mass; zero where none came [m/s]."""
        return self.flux / np.maximum(self._mean[:, 1:2], 1e-300)

    @property
    def velocity_variance(self) -> np.ndarray:
        """(owned cells, d) variance of the velocities of the particles, by mass, over time and cell [m^2/s^2]."""
        square = self._mean[:, 2 + self.mesh.topology.dim:] / np.maximum(self._mean[:, 1:2], 1e-300)
        return np.maximum(square - self.velocity ** 2, 0.0)

    @property
    def solid_fraction_variance(self) -> np.ndarray:
        """(owned cells,) variance over time."""
        return self._sum[:, 0] / max(self.duration, 1e-300)

    @property
    def flux_variance(self) -> np.ndarray:
        """(owned cells, d) variance over time [kg^2/(m^4 s^2)]."""
        return self._sum[:, 1:] / max(self.duration, 1e-300)

    def functions(self) -> tuple[fem.Function, fem.Function]:
        """DG0 Functions of mean solid fraction and mean velocity, for output.

        Note:
            Collective.
        """
        scalar, vector = scalar_space(self.mesh, "DG", 0), vector_space(self.mesh, "DG", 0)
        out = fem.Function(scalar, name="mean_solid_fraction"), fem.Function(vector, name="mean_particle_velocity")
        for function, values in zip(out, (self.solid_fraction, self.velocity)):
            function.x.array[:values.size] = values.ravel()
            function.x.scatter_forward()
        return out

    def saved(self) -> dict[str, tuple]:
        """Means and sums of squares of the cells, for a checkpoint."""
        cells = self.particles.cells
        return {"cells": (cells.corner[:cells.owned].mean(1), {"mean": self._mean, "sum": self._sum}),
                "same": (None, {"duration": self.duration})}

    def restore(self, state: dict[str, dict]) -> None:
        """Take them back."""
        self._mean, self._sum = (np.array(state["cells"][name]) for name in ("mean", "sum"))
        self.duration = float(state["same"]["duration"])


class ParticleProfile:
    """Mean and scatter of a quantity of the particles over slabs along an axis, by mass and over time: for instance the
    mean height of a jet against the way downstream.

    Args:
        particles (Particles): the particles.
        edges: (slabs + 1,) limits of the slabs, rising [m].
        quantity: function ``(particles) -> (particles,)``, for instance ``lambda p: p.position[:, 1]``.
        along (int): the axis.

    Attributes:
        middle: (slabs,) middles of the slabs [m].
        duration (float): time averaged over [s].

    Raises:
        ValueError: for edges that do not rise.

    Note:
        Collective.
    """

    def __init__(self, particles: "Particles", edges: ArrayLike, quantity: "Callable[[Particles], ArrayLike]",
                 along: int = 0) -> None:
        require_particles(particles)
        self.particles, self.mesh = particles, particles.mesh
        self.quantity = function_or_class_of("quantity", quantity, "a function, for instance lambda p: p.position[:, 1]")
        self.edges, self.along, self.duration = numbers("edges of the slabs", edges), whole_number("axis", along, 0), 0.0
        if self.edges.ndim != 1 or len(self.edges) < 2 or not (np.diff(self.edges) > 0).all():
            raise ValueError(f"The edges of the slabs are {self.edges.tolist()}; give two or more rising numbers [m].")
        self.middle = 0.5 * (self.edges[1:] + self.edges[:-1])
        self._sums = np.zeros((3, len(self.middle)))

    def add(self, dt: float) -> None:
        """Add the particles of now with weight ``dt`` [s]."""
        p, weight = self.particles, positive_number("weight of an average", dt)
        slab = np.searchsorted(self.edges, p.position[:, self.along], side="right") - 1
        inside = (slab >= 0) & (slab < len(self.middle))
        values, mass = np.asarray(self.quantity(p), float)[inside], weight * p.mass[inside]
        rows = [np.bincount(slab[inside], mass * values ** k, len(self.middle)) for k in range(3)]
        self._sums += sums_of(p.comm, *np.ravel(rows)).reshape(3, -1)
        self.duration += weight

    @property
    def mass(self) -> np.ndarray:
        """(slabs,) mean mass of the particles in each slab [kg]."""
        return self._sums[0] / max(self.duration, 1e-300)

    @property
    def mean(self) -> np.ndarray:
        """(slabs,) mean of the quantity; not a number where no particle came."""
        with np.errstate(invalid="ignore"):
            return self._sums[1] / np.where(self._sums[0] > 0, self._sums[0], np.nan)

    @property
    def deviation(self) -> np.ndarray:
        """(slabs,) standard deviation of the quantity over particles and time."""
        square = self._sums[2] / np.where(self._sums[0] > 0, self._sums[0], np.nan)
        return np.sqrt(np.maximum(square - self.mean ** 2, 0.0))

    def saved(self) -> dict[str, tuple]:
        """The sums over time, for a checkpoint."""
        return {"same": (None, {"sums": self._sums, "duration": self.duration})}

    def restore(self, state: dict[str, dict]) -> None:
        """Take them back."""
        sums = np.array(state["same"]["sums"])
        if sums.shape != self._sums.shape:
            raise ValueError(f"The profile has {len(self.middle)} slabs, that of the checkpoint had {sums.shape[1]}; give "
                             "ParticleProfile the edges that it had when it was saved.")
        self._sums[:], self.duration = sums, float(state["same"]["duration"])


class PlaneFlux:
    """Particles that cross a plane, counted one by one: mass along the normal less mass against it.

    A particle counts in the first :meth:`add` that finds it on the other side than the one before; so call it every step,
    and put planes further from an outlet than particles go in a step.

    Args:
        particles (Particles): the particles.
        point, normal: of the plane [m].

    Attributes:
        mass, number: what crossed so far, signed [kg], parcels.
        duration (float): time counted over [s].

    Raises:
        ValueError: for a normal of length zero, or along a periodic direction.

    Note:
        Collective.
    """

    def __init__(self, particles: "Particles", point: ArrayLike, normal: ArrayLike) -> None:
        require_particles(particles)
        self.particles, self.mesh = particles, particles.mesh
        self.point, self.normal = finite_vector("point of a plane", point), finite_vector("normal of a plane", normal)
        if not np.linalg.norm(self.normal) > 0:
            raise ValueError("The normal of a plane is zero; give the direction in which mass counts.")
        if particles.period is not None and np.any(self.normal[:len(particles.period)] * particles.period):
            raise ValueError("The plane lies across a periodic direction, where particles come back from the other side; "
                             "count them across another.")
        self.normal /= np.linalg.norm(self.normal)
        self.mass, self.number, self.duration = 0.0, 0, 0.0
        self._side = f"_side_of_plane_{self.point.tolist()}_{self.normal.tolist()}"  # travels with the particles

    def add(self, dt: float) -> None:
        """Count what crossed in the last ``dt`` [s]."""
        p = self.particles
        now = np.where((p.position - self.point) @ self.normal > 0, 1.0, -1.0)
        before = p.properties.get(self._side)
        if before is not None:
            crossed = np.where(now * before < 0, now, 0.0)  # zero: new
            mass, number = sums_of(p.comm, crossed @ p.mass, crossed.sum())
            self.mass, self.number = self.mass + mass, self.number + int(round(number))
        p.properties[self._side] = now
        self.duration += positive_number("weight of an average", dt)

    @property
    def mass_rate(self) -> float:
        """Mean mass rate through the plane [kg/s]."""
        return self.mass / max(self.duration, 1e-300)

    def saved(self) -> dict[str, tuple]:
        """The counts, for a checkpoint; the sides are saved with the particles."""
        return {"same": (None, {"mass": self.mass, "number": self.number, "duration": self.duration})}

    def restore(self, state: dict[str, dict]) -> None:
        """Take them back."""
        same = state["same"]
        self.mass, self.number, self.duration = float(same["mass"]), int(same["number"]), float(same["duration"])
