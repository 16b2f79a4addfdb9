"""Velocities of turbulent inlets: mean profiles over walls, and synthetic eddies on them, for ``set_velocity``."""
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from fe_el.checks import finite_vector, numbers, positive_number, whole_number
from fe_el.compiled.cache import njit
from fe_el.compiled.random_numbers import uniform
from fe_el.fluid.boundary_values import velocity_at

if TYPE_CHECKING:
    from fe_el.fluid.volume_averaged_navier_stokes import VolumeAveragedNavierStokes


def _planes(walls):
    """Points and unit normals, into the fluid, of a list of walls."""
    out = []
    if not isinstance(walls, (list, tuple)) or any(not isinstance(w, (list, tuple)) or len(w) != 2 for w in walls):
        raise ValueError(f"The walls of a profile are {walls!r}; give a list of them, walls=[(point, normal)].")
    for point, normal in walls:
        point, normal = finite_vector("point of a wall", point), finite_vector("normal of a wall", normal)
        if not np.linalg.norm(normal) > 0:
            raise ValueError("The normal of a wall is zero; give the direction from the wall into the fluid.")
        out.append((point, normal / np.linalg.norm(normal)))
    if not out:
        raise ValueError("A profile needs a wall; give walls=[(point, normal)].")
    return out


class _Profile:
    """A velocity along one direction that is a function of the distance from the nearest of some walls."""

    def __init__(self, velocity, walls):
        self.velocity, self.walls = numbers("velocity", velocity), _planes(walls)
        if self.velocity.ndim != 1 or not np.linalg.norm(self.velocity) > 0:
            raise ValueError(f"The velocity is {self.velocity.tolist()}; give d numbers, not all zero.")

    def distance(self, position: np.ndarray) -> np.ndarray:
        """(points,) distance from the nearest wall [m]."""
        return np.maximum(np.min([(position - point) @ normal for point, normal in self.walls], axis=0), 0.0)

    def share(self, distance: np.ndarray) -> np.ndarray:
        """Part of the velocity at distances from the wall."""
        raise NotImplementedError

    def __call__(self, time: float, position: np.ndarray) -> np.ndarray:
        """Velocity (points, d) [m/s]."""
        return self.share(self.distance(position))[:, None] * self.velocity


class PowerLaw(_Profile):
    """u = U (y / thickness)^exponent up to the thickness of the layer, and U beyond (Prandtl: 1/7).

    Args:
        velocity: U, d numbers [m/s].
        thickness (float): [m].
        walls: list of (point, normal into the fluid).
        exponent (float): one over about 7 at Reynolds numbers of 1e5.

    Raises:
        ValueError: for numbers that are not positive, or no walls.
    """

    def __init__(self, velocity: ArrayLike, thickness: float, walls: Sequence[tuple[ArrayLike, ArrayLike]],
                 exponent: float = 1 / 7) -> None:
        super().__init__(velocity, walls)
        self.thickness, self.exponent = positive_number("thickness", thickness), positive_number("exponent", exponent)

    def share(self, distance: np.ndarray) -> np.ndarray:
        """Part of U at distances from the wall."""
        return np.minimum(distance / self.thickness, 1.0) ** self.exponent


class LogLaw(_Profile):
    """u = u_tau (ln(y u_tau / nu) / kappa + B) up to the thickness of the layer, u_tau y u_tau / nu below the crossing of
    the two, and what it is at the thickness beyond.

    Args:
        velocity: velocity outside the layer, d numbers [m/s]: from it and the thickness follows the friction velocity.
        thickness (float): [m].
        kinematic_viscosity (float): nu [m^2/s].
        walls: list of (point, normal into the fluid).
        kappa, constant (float): of the law.

    Attributes:
        friction_velocity (float): u_tau [m/s].

    Raises:
        ValueError: for numbers that are not positive, or no walls.
    """

    def __init__(self, velocity: ArrayLike, thickness: float, kinematic_viscosity: float,
                 walls: Sequence[tuple[ArrayLike, ArrayLike]], kappa: float = 0.41, constant: float = 5.2) -> None:
        super().__init__(velocity, walls)
        self.thickness = positive_number("thickness", thickness)
        self.viscosity = positive_number("kinematic viscosity", kinematic_viscosity)
        self.kappa, self.constant = positive_number("kappa", kappa), positive_number("constant", constant)
        speed = float(np.linalg.norm(self.velocity))
        low, high = 0.0, speed * 1e3
        for _ in range(200):
            self.friction_velocity = 0.5 * (low + high)
            over = self.friction_velocity * self._law(np.array([self.thickness]))[0] > speed
            low, high = (low, self.friction_velocity) if over else (self.friction_velocity, high)
        self.speed = speed

    def _law(self, distance):
        """u / u_tau."""
        y = distance * self.friction_velocity / self.viscosity
        return np.minimum(y, np.where(y > 5.0, np.log(np.maximum(y, 1.0)) / self.kappa + self.constant, np.inf))

    def share(self, distance: np.ndarray) -> np.ndarray:
        """Part of the outer velocity at distances from the wall."""
        return self.friction_velocity * self._law(np.minimum(distance, self.thickness)) / self.speed


@njit
def _eddies(number, seed, phase, width, depth):
    """Places (eddies, 3) and signs (eddies, 3) of the eddies; each is drawn anew when it has passed the inlet."""
    place, sign = np.empty((number, 3)), np.empty((number, 3))
    for k in range(number):
        now = uniform(seed, k, 0, 0) + phase
        turn = int(np.floor(now))
        place[k, 0] = (2 * (now - turn) - 1) * depth
        for j in range(2):
            place[k, 1 + j] = width[j, 0] + uniform(seed, k, turn, 1 + j) * (width[j, 1] - width[j, 0])
        for j in range(3):
            sign[k, j] = 1.0 if uniform(seed, k, turn, 3 + j) < 0.5 else -1.0
    return place, sign


@njit
def _add_up(at, place, sign, length, scale, out):
    """Sum of the eddies' velocities of variance one at points (points, 2) of the inlet; each is a product of tents."""
    axes = at.shape[1]
    for i in range(len(at)):
        for k in range(len(place)):
            shape = scale * (1 - abs(place[k, 0]) / length)
            for j in range(axes):
                away = abs(at[i, j] - place[k, 1 + j]) / length
                shape = shape * (1 - away) if away < 1 else 0.0
            if shape > 0.0:
                for j in range(out.shape[1]):
                    out[i, j] += shape * sign[k, j]


class SyntheticEddies:
    """A turbulent inlet: a mean velocity, and eddies that pass through it (Jarrin et al., Int. J. Heat Fluid Flow 27, 2006,
    585).

    The fluctuations of each component have the variance (intensity |U|)^2 with the local mean velocity U, and reach over
    ``length``; their flux through the inlet is taken off at every instant, so the balance of mass stays that of the mean.
    They are a function of time, place and seed alone: the same on any number of ranks, and after a restart.

    Args:
        fluid (VolumeAveragedNavierStokes): with the inlet among its facet tags.
        group: the inlet, one plane.
        mean: d numbers or a function (time, position), for instance :class:`PowerLaw`.
        intensity: rms of the fluctuations over the mean speed, one number or d along the axes.
        length (float): [m], at least the size of the cells at the inlet.
        seed (int): of the eddies.

    Raises:
        ValueError: for numbers out of range, a group that is not plane, or a mean that does not flow in.

    Note:
        Collective, and so is each evaluation.
    """

    def __init__(self, fluid: "VolumeAveragedNavierStokes", group: int | str,
                 mean: ArrayLike | Callable[[float, np.ndarray], ArrayLike], intensity: ArrayLike = 0.05,
                 length: float | None = None, seed: int = 0) -> None:
        if not hasattr(fluid, "boundary") or isinstance(fluid, type):
            raise ValueError(f"The fluid of the eddies is {fluid!r}; pass an object of VolumeAveragedNavierStokes.")
        self.fluid, self.mean, self.seed, d = fluid, mean, whole_number("seed", seed, 0), fluid.dimension
        self.length, self.intensity = positive_number("length of the eddies", length), numbers("intensity", intensity)
        if self.intensity.shape not in ((), (d,)) or not (self.intensity >= 0).all():
            raise ValueError(f"The intensity is {self.intensity.tolist()}; give one number or {d}, none negative.")
        self.facets, self._last = fluid.boundary(group), (None, None)
        comm, total = fluid.comm, self.facets.area_normal.sum(0)
        total = comm.allreduce(total)
        area = comm.allreduce(float(np.linalg.norm(self.facets.area_normal, axis=1).sum()))
        if not np.linalg.norm(total) > (1 - 1e-6) * area:
            raise ValueError(f"The facets of the inlet {group} do not lie in one plane; give each plane its own group.")
        self.inwards = -total / np.linalg.norm(total)
        self._axes()
        at = np.concatenate(comm.allgather(self._in_plane(np.concatenate(self.facets.points))))
        self.width = np.zeros((2, 2))
        self.width[:d - 1] = np.column_stack([at.min(0) - self.length, at.max(0) + self.length])
        sides = [b - a for a, b in self.width[:d - 1]]
        self.number = int(np.ceil(4 * np.prod(sides) / self.length ** (d - 1)))
        # of the box over that of an eddy, so that the variance is one
        self.scale = np.sqrt(1.5 ** d * 2 * np.prod(sides) / self.length ** (d - 1) / self.number)
        speed = self._mean_speed()
        if not speed > 0:
            raise ValueError(f"The mean velocity lets {speed:g} m/s in through the inlet {group}; give one that flows in.")
        self.speed = speed

    def _axes(self):
        """Unit vectors in the plane of the inlet."""
        normal, d = np.append(self.inwards, 0.0)[:3], self.fluid.dimension
        first = np.cross([0.0, 0.0, 1.0] if d == 2 or abs(normal[2]) < 0.9 else [0.0, 1.0, 0.0], normal)
        first /= np.linalg.norm(first)
        self.axes = np.array([first, np.cross(normal, first)])[:d - 1]

    def _in_plane(self, position):
        return np.ascontiguousarray(position @ self.axes.T)

    def _mean_speed(self):
        """Mean velocity through the inlet at the start [m/s]; the eddies pass with it."""
        facets, d = self.facets, self.fluid.dimension
        mean = sum(velocity_at(self.mean, self.fluid.time, at, d) for at in facets.points) / d
        flux, area = (mean * facets.area_normal).sum(), np.linalg.norm(facets.area_normal, axis=1).sum()
        flux, area = self.fluid.comm.allreduce(np.array([flux, area]))
        return -flux / area

    def _raw(self, time, position):
        """Mean velocity, size of the fluctuations, and these with their flux, each (points, d)."""
        d = self.fluid.dimension
        mean, out = velocity_at(self.mean, time, position, d), np.zeros((len(position), d))
        place, sign = _eddies(self.number, self.seed, self.speed * time / (2 * self.length), self.width, self.length)
        _add_up(self._in_plane(position), place, sign, self.length, self.scale, out)
        size = self.intensity * np.linalg.norm(mean, axis=1)[:, None] * np.ones(d)
        return mean, size, size * out

    def _excess(self, time):
        """Flux of the fluctuations over that of their size along the normal. Collective."""
        if self._last[0] != time:
            facets, sums = self.facets, np.zeros(2)
            for at in facets.points:
                _, size, out = self._raw(time, at)
                sums += (out * facets.area_normal).sum(), (np.linalg.norm(size, axis=1)
                                                           * (facets.area_normal @ self.inwards)).sum()
            sums = self.fluid.comm.allreduce(sums)
            self._last = time, sums[0] / sums[1] if sums[1] else 0.0
        return self._last[1]

    def __call__(self, time: float, position: np.ndarray) -> np.ndarray:
        """Velocity (points, d) [m/s]."""
        excess = self._excess(time)
        mean, size, out = self._raw(time, position)
        return mean + out - excess * np.linalg.norm(size, axis=1)[:, None] * self.inwards
