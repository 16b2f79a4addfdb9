"""Particles and parcels that come in at a rate, each at its time within the step."""
import json
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from fe_el.checks import (
    finite_vector,
    number_or_function,
    numbers,
    of_kind,
    positive_number,
    require_positive,
    seed_number,
)
from fe_el.particles.size_distribution import SizeDistribution
from fe_el.particles.sources import DiscSource, FacetSource, PointSource

if TYPE_CHECKING:
    from fe_el.particles.particles import Particles

PARTS = 8  # of a step, in each of which a rate counts as constant
BLOCK = 256  # sizes drawn at once: what comes in does not depend on the step
MOST = 10_000_000  # parcels in one step


class Injector:
    """Lets particles or parcels in at a rate, whether or not others are in the way.

    Call :meth:`advance` at the start of a step, before the coupling's. What comes in during the step moves, and feels the
    fluid, from its own time on: a jet has no pulses of the step's length. What a step leaves of a particle is carried over.

    Args:
        particles (Particles): the particles.
        source: :class:`FacetSource`, :class:`DiscSource` or :class:`PointSource`.
        velocity: of what comes in [m/s]: d numbers, or a function ``(time, position (n, 3)) -> (n, d)`` of the middle of the
            step; then more comes in where it is larger, so that the concentration over the source is uniform.
        diameter: of the single particles [m]: a number, an array to draw from, or a :class:`SizeDistribution`.
        mass_rate: [kg/s], a number or a function of time [s]; or instead
        number_rate: of single particles [1/s], a number or a function of time; or instead
        loading: mass of particles over mass of fluid that comes through the source, a number or a function of time, with
        fluid: density [kg/m^3] and velocity [m/s] (as ``velocity``) of that fluid.
        seed (int): of places and sizes.
        kind: ``number`` of single particles in a parcel, a number or a function of the diameters, or instead
            ``coarse_graining`` (the cube root of it); ``density`` [kg/m^3], ``material``, as for ``Particles.insert_at``.

    Attributes:
        parcels (int), number (float), mass (float): parcels, single particles and mass let in so far [kg].
        waiting (float): what is to come but less than the next parcel; particles for a ``number_rate``, else mass [kg].
        time (float): of the next step's start [s]; set it if a run does not start at zero.

    Raises:
        ValueError: for arguments out of range, or not exactly one rate.

    Note:
        Collective. The same comes in on any number of ranks, and after a checkpoint.
    """

    def __init__(self, particles: "Particles", source: FacetSource | DiscSource | PointSource,
                 velocity: ArrayLike | Callable[[float, np.ndarray], ArrayLike], diameter: ArrayLike | SizeDistribution,
                 mass_rate: float | Callable[[float], float] | None = None,
                 number_rate: float | Callable[[float], float] | None = None,
                 loading: float | Callable[[float], float] | None = None, fluid: tuple[float, Any] | None = None,
                 seed: int = 0, **kind: Any) -> None:
        from fe_el.particles.particles import Particles  # which imports the sources
        self.particles = of_kind("particles", particles, Particles)
        self.source = of_kind("source", source, FacetSource, DiscSource, PointSource)
        source.prepare(particles)
        function = callable(velocity) and not isinstance(velocity, type)
        self.velocity = velocity if function else finite_vector("velocity", velocity)
        self.sizes = diameter if isinstance(diameter, SizeDistribution) else SizeDistribution.listed(diameter)
        given = [rate for rate in (mass_rate, number_rate, loading) if rate is not None]
        if len(given) != 1:
            raise ValueError(f"An injector has {len(given)} rates; give one of mass_rate=, number_rate= and loading=.")
        if (loading is None) != (fluid is None):
            raise ValueError("A loading= needs fluid=(density, velocity), and nothing else does.")
        self.rate, self.by_number = number_or_function("rate of an injector", given[0]), number_rate is not None
        self.fluid = None if fluid is None else (positive_number("density of the fluid", fluid[0]), fluid[1])
        self._take_kind(**kind)
        self.drawn_from = self.sizes.of_parcels(self._numbers)
        self.generators = [np.random.default_rng((seed_number(seed), k)) for k in range(2)]  # of sizes, of places
        self.time, self.waiting, self.parcels, self.number, self.mass = 0.0, 0.0, 0, 0.0, 0.0
        self.ahead = np.zeros((0, 2))  # diameters and numbers drawn for the next parcels
        self.over = None if isinstance(source, PointSource) else source.quadrature()
        if self.fluid is not None and self.over is None:
            raise ValueError("The loading of an injector needs the flux of the fluid through an area, which points do not "
                             "have; give mass_rate= or number_rate=, or a DiscSource.")
        self._rate_at(0.0)
        self._normal_speed(0.0)

    def _take_kind(self, number=None, coarse_graining=None, density=None, material=0):
        """What parcels are."""
        if number is not None and coarse_graining is not None:
            raise ValueError("An injector has both number= and coarse_graining=; give one of them.")
        if coarse_graining is not None:
            number = positive_number("coarse graining", coarse_graining) ** 3
        if not callable(number):
            number = 1.0 if number is None else positive_number("number of particles in a parcel", number)
        self.in_parcel, self.material = number, material
        self.density = positive_number("density", self.particles.default_density if density is None else density)

    def _numbers(self, diameter):
        """Single particles (n,) in parcels of these."""
        number = numbers("number of particles in a parcel",
                         self.in_parcel(diameter) if callable(self.in_parcel) else self.in_parcel)
        require_positive("number of particles in a parcel", number)
        return np.broadcast_to(number, diameter.shape)

    # -- rates ---------------------------------------------------------------------------------------------------------

    def _rate_at(self, time):
        """Particles or mass per second, checked."""
        rate = self.rate(time) if callable(self.rate) else self.rate
        rate = float(numbers("rate of an injector", rate))
        if not 0 <= rate < np.inf:
            raise ValueError(f"The rate of an injector at time {time:g} s is {rate}; it must be finite and not negative.")
        if self.fluid is None:
            return rate
        density, velocity = self.fluid
        x, normal, area = self.over
        flux = float(((_velocity_at(velocity, time, x) * normal).sum(1) * area).sum())
        if not flux >= 0:
            raise ValueError(f"The fluid of the loading flows out through the source at time {time:g} s; give the velocity "
                             "with which it comes in.")
        return rate * density * flux

    def _asked(self, dt):
        """What has come since the start of the step at its beginning and after each of its parts (PARTS + 1,)."""
        middle = self.time + (np.arange(PARTS) + 0.5) / PARTS * dt
        steady = not callable(self.rate) and (self.fluid is None or not callable(self.fluid[1]))
        rates = np.full(PARTS, self._rate_at(middle[0])) if steady else np.array([self._rate_at(t) for t in middle])
        return np.concatenate([[0.0], np.cumsum(rates * dt / PARTS)])

    # -- what comes in -------------------------------------------------------------------------------------------------

    def advance(self, dt: float) -> int:
        """Let in what comes during the step of ``dt`` [s] that follows; returns the number of new parcels.

        Raises:
            ValueError: for more than ten million parcels, or a velocity that leads out through the source.

        Note:
            Collective.
        """
        asked = self._asked(positive_number("time step", dt))
        late, diameter, number = self._released(asked)
        if len(late):
            position, velocity = self._places(len(late), self.time + 0.5 * dt)
            self._insert(position, velocity, diameter, number, late)
        self.time += dt
        return len(late)

    def _amounts(self, rows):
        """What rows of diameters and numbers take of the rate."""
        return rows[:, 1] if self.by_number else self.density * np.pi / 6 * rows[:, 1] * rows[:, 0] ** 3

    def _released(self, asked):
        """Shares of the step after which parcels come in, their particles' diameters, and numbers of these."""
        blocks, budget = [self.ahead], self.waiting + asked[-1]
        drawn = self._amounts(self.ahead).sum()
        while drawn <= budget:
            d = self.drawn_from.draw(self.generators[0], BLOCK)
            blocks.append(np.column_stack([d, self._numbers(d)]))
            amount = self._amounts(blocks[-1]).sum()
            drawn += amount
            if (budget - drawn) / amount * BLOCK > MOST:
                raise ValueError(f"An injector is to let in {budget / amount * BLOCK:.3g} parcels in one step; let parcels "
                                 "stand for more particles (number=), or use smaller steps.")
        rows = np.concatenate(blocks)
        total = np.cumsum(self._amounts(rows))
        count = int(np.searchsorted(total, budget, side="right"))
        late = np.interp(total[:count] - self.waiting, asked, np.arange(PARTS + 1) / PARTS)
        self.ahead = rows[count:]
        self.waiting = budget - (total[count - 1] if count else 0.0)
        return np.minimum(late, 1 - 1e-12), rows[:count, 0], rows[:count, 1]

    def _normal_speed(self, time):
        """Largest speed into the mesh at the source [m/s], checked; ``None`` for points."""
        if self.over is None:
            return None
        x, normal, _ = self.over
        speed = float((_velocity_at(self.velocity, time, x) * normal).sum(1).max())
        if not speed > 0:
            raise ValueError(f"The velocity of an injector leads out through its source, or along it (at most {speed:g} m/s "
                             "inwards); turn it, or the normal of the disc.")
        return speed

    def _places(self, count, time):
        """Positions and velocities (count, 3) of new parcels."""
        if not callable(self.velocity) or self.over is None:
            x = self.source.places(self.generators[1], count, self.parcels)[0]
            return x, _velocity_at(self.velocity, time, x)
        most, kept, found = 1.1 * self._normal_speed(time), [], 0
        while found < count:
            x, normal = self.source.places(self.generators[1], BLOCK, self.parcels)
            v = _velocity_at(self.velocity, time, x)
            speed = (v * normal).sum(1)
            if speed.max() > most:  # what was drawn so far came too often
                most, kept, found = 1.1 * speed.max(), [], 0
            keep = self.generators[1].random(BLOCK) * most < speed
            kept.append(np.hstack([x[keep], v[keep]]))
            found += len(kept[-1])
        rows = np.concatenate(kept)[:count]
        return rows[:, :3], rows[:, 3:]

    def _insert(self, position, velocity, diameter, number, late):
        """Insert parcels, and note when they start to move."""
        p, first = self.particles, self.particles.next_id
        p.insert_at(position, np.cbrt(number) * diameter, self.density, velocity, self.material, number=number)
        new = np.flatnonzero(p.id >= first)
        p.properties.setdefault("_late", np.zeros(len(p)))[new] = late[p.id[new] - first]
        self.parcels += len(number)
        self.number += number.sum()
        self.mass += (self.density * np.pi / 6 * number * diameter ** 3).sum()

    # -- state ---------------------------------------------------------------------------------------------------------

    def saved(self) -> dict[str, tuple]:
        """Counters, what waits, and the state of the random numbers, for a checkpoint."""
        counters = {name: getattr(self, name) for name in ("time", "waiting", "parcels", "number", "mass", "ahead")}
        return {"same": (None, {**counters, "generators": json.dumps([g.bit_generator.state for g in self.generators])})}

    def restore(self, state: dict[str, dict]) -> None:
        """Take them back."""
        same = state["same"]
        for name in ("time", "waiting", "number", "mass"):
            setattr(self, name, float(same[name]))
        self.parcels, self.ahead = int(same["parcels"]), np.asarray(same["ahead"], float).reshape(-1, 2)
        for generator, kept in zip(self.generators, json.loads(same["generators"])):
            generator.bit_generator.state = kept


def _velocity_at(value, time, position):
    """Velocities (n, 3) of numbers or a function of time and place.

    Raises:
        ValueError: for another shape, or numbers that are not finite.
    """
    v = numbers("velocity of an injector", value(time, position) if callable(value) else value)
    if v.shape not in ((2,), (3,), (len(position), 2), (len(position), 3)) or not np.isfinite(v).all():
        raise ValueError(f"The velocity of an injector has shape {v.shape} at {len(position)} places"
                         f"{'' if np.isfinite(v).all() else ' and is not finite'}; give two or three finite numbers, or a "
                         "function (time, position) that returns a row of these for each place [m/s].")
    full = np.zeros((len(position), 3))
    full[:, :v.shape[-1]] = v
    return full
