"""Walls: tagged boundary facets of the mesh, and planes and cylinders that may move."""
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fe_el.checks import finite_vector, positive_number, whole_number
from fe_el.compiled.cache import njit
from fe_el.compiled.parts import part
from fe_el.parallel.messages import total
from fe_el.particles.contacts.blocks import BLOCK
from fe_el.particles.contacts.law_kernels import FAST
from fe_el.particles.contacts.wall_blocks import add_contact, finish_block

PLANE, CYLINDER, FACETS, SURFACE = 0, 1, 2, 3


def _direction(name, value, wanted):
    v = finite_vector(f"{name} of a wall", value)
    length = np.linalg.norm(v)
    if not length > 0:
        raise ValueError(f"The {name} of a wall is zero; give {wanted}.")
    return v if abs(length - 1) < 1e-12 else v / length  # one that is of length 1 already stays to the last digit


class Wall:
    """A wall with a material and a rigid motion: ``velocity`` [m/s] and ``angular_velocity`` [1/s] about ``point`` [m].

    What is set anew between two steps counts from the next step on; ``point`` and direction of planes, cylinders and
    surfaces move. A function of time, set as ``drive``, gives velocity and angular velocity in the middle of each step: with
    ``wall.drive = lambda time: ((0, 0, 0.1 * np.sin(300 * time)), (0, 0, 0))`` it shakes. ``time`` is that which its
    contacts have been advanced by [s]. With ``wall.load = (0, 0, -2.0), 0.05`` a plane, cylinder or surface is a body of
    0.05 kg that may move up and down, under a force of 2 N (its weight included) and that of the particles.
    """

    kind: int  #: PLANE, CYLINDER, FACETS or SURFACE
    #: (force (3,) [N], mass [kg]): the wall moves along this force, driven by it and by the particles; absent: not
    load: tuple[ArrayLike, float] | None = None
    #: function time -> (velocity (3,), angular velocity (3,)); absent: they stay as they are
    drive: Callable[[float], tuple[ArrayLike, ArrayLike]] | None = None

    def __init__(self, point, material, velocity, angular_velocity):
        self.material, self.point, self.velocity, self.angular_velocity = material, point, velocity, angular_velocity
        self.force = np.zeros(3)  #: mean force of the particles on the wall over the last advance [N]
        self.torque = np.zeros(3)  #: its mean torque about ``point`` [N m]
        self.motion()

    def follow(self, time: float) -> None:
        """Take the motion that ``drive`` gives at a time."""
        if self.drive is not None:
            try:
                self.velocity, self.angular_velocity = self.drive(time)
            except (TypeError, ValueError):
                raise ValueError(f"The drive of a wall gives {str(self.drive(time))[:60]} at time {time:g} s; it must give "
                                 "two vectors, velocity [m/s] and angular velocity [1/s].") from None

    def load_row(self) -> np.ndarray:
        """Direction of the load, its size [N], and one over the mass [1/kg], zero where there is none; checked."""
        if self.load is None:
            return np.zeros(5)
        if self.kind == FACETS or self.drive is not None or not isinstance(self.load, (tuple, list)) or len(self.load) != 2:
            raise ValueError(f"The load of a wall is {self.load!r}; give (force (3,) [N], mass [kg]) to a plane, cylinder "
                             "or surface without a drive.")
        force, mass = finite_vector("load of a wall", self.load[0]), positive_number("mass of a wall", self.load[1])
        return np.array([*_direction("load", force, "a force"), np.linalg.norm(force), 1 / mass])

    def motion(self) -> np.ndarray:
        """Origin, velocity and rotation in one row, after checking them and the material."""
        self.material = whole_number("material of a wall", self.material, 0)
        self.point = finite_vector("point of a wall", self.point)
        self.velocity = finite_vector("velocity of a wall", self.velocity)
        self.angular_velocity = finite_vector("angular velocity of a wall", self.angular_velocity)
        return np.concatenate([self.point, self.velocity, self.angular_velocity])

    turned = np.eye(3)  # planes and cylinders turn by their normal or axis

    def restore(self, motion: np.ndarray, turned: np.ndarray) -> None:
        """Take back origin, velocity and rotation (9,), and how the wall is turned (3, 3)."""
        self.point, self.velocity, self.angular_velocity = motion[:3].copy(), motion[3:6].copy(), motion[6:].copy()


class FacetWalls(Wall):
    """Tagged boundary facets of the mesh.

    The facets stay where they are; ``velocity`` and ``angular_velocity`` are those of their surface (a conveyor, a drum).

    Args:
        facet_tags: dolfinx MeshTags of facets.
        groups: tags of the facets that are walls.
        material (int): index into the law's material table.
        velocity, angular_velocity, point: motion of the surface; angular about ``point``.
    """

    kind = FACETS

    def __init__(self, facet_tags: Any, groups: int | str | Sequence[int | str], material: int = 0,
                 velocity: ArrayLike = (0, 0, 0), angular_velocity: ArrayLike = (0, 0, 0),
                 point: ArrayLike = (0, 0, 0)) -> None:
        super().__init__(point, material, velocity, angular_velocity)
        self.facet_tags, self.groups = facet_tags, groups


class PlaneWall(Wall):
    """A plane through ``point`` whose ``normal`` points to the particles; it travels with ``velocity``.

    Raises:
        ValueError: for a normal of length zero.
    """

    kind = PLANE

    def __init__(self, point: ArrayLike, normal: ArrayLike, material: int = 0, velocity: ArrayLike = (0, 0, 0),
                 angular_velocity: ArrayLike = (0, 0, 0)) -> None:
        super().__init__(point, material, velocity, angular_velocity)
        self.normal = normal
        self.normal = self.shape[:3]

    @property
    def shape(self) -> np.ndarray:
        """The unit normal, and a zero."""
        return np.array([*_direction("normal", self.normal, "the direction from the wall to the particles"), 0.0])

    def moved(self, point: np.ndarray, shape: np.ndarray) -> None:
        """Take up where the wall is now."""
        self.point, self.normal = point.copy(), shape[:3].copy()


class CylinderWall(Wall):
    """An infinite cylinder around ``axis`` through ``point``; particles are inside it, or outside of it if asked.

    Raises:
        ValueError: for an axis of length zero or a radius that is not positive.
    """

    kind = CYLINDER

    def __init__(self, point: ArrayLike, axis: ArrayLike, radius: float, outside: bool = False, material: int = 0,
                 velocity: ArrayLike = (0, 0, 0), angular_velocity: ArrayLike = (0, 0, 0)) -> None:
        super().__init__(point, material, velocity, angular_velocity)
        self.axis, self.radius, self.outside = axis, radius, bool(outside)
        self.axis = self.shape[:3]

    @property
    def shape(self) -> np.ndarray:
        """The unit axis, and the radius, negative if particles are outside."""
        self.radius = positive_number("radius of a cylinder wall", self.radius)
        return np.array([*_direction("axis", self.axis, "its direction"), -self.radius if self.outside else self.radius])

    def moved(self, point: np.ndarray, shape: np.ndarray) -> None:
        """Take up where the wall is now."""
        self.point, self.axis = point.copy(), shape[:3].copy()


@part(fastmath=FAST, forceinline=True)
def surface_point(kind, shape, origin, x, y, z):
    """Nearest point of a plane or cylinder, and the distance (negative behind the wall)."""
    dx, dy, dz = x - origin[0], y - origin[1], z - origin[2]
    along = dx * shape[0] + dy * shape[1] + dz * shape[2]
    if kind == PLANE:
        return x - along * shape[0], y - along * shape[1], z - along * shape[2], along
    ax, ay, az = origin[0] + along * shape[0], origin[1] + along * shape[1], origin[2] + along * shape[2]
    rx, ry, rz = x - ax, y - ay, z - az
    r, radius = np.sqrt(rx * rx + ry * ry + rz * rz) + 1e-300, abs(shape[3])
    q = radius / r
    return ax + q * rx, ay + q * ry, az + q * rz, radius - r if shape[3] > 0 else r - radius


@njit
def shape_list(x, reach, owned, kind, shape, motion):
    """Pairs (particle, wall) within reach (particles,) [m] of planes and cylinders."""
    particle, wall = [np.int32(0) for _ in range(0)], [np.int32(0) for _ in range(0)]
    for i in range(owned):
        for n in range(len(kind)):
            if kind[n] < 2 and surface_point(kind[n], shape[n], motion[n], x[i, 0], x[i, 1], x[i, 2])[3] < reach[i]:
                particle.append(np.int32(i))
                wall.append(np.int32(n))
    return np.array(particle, dtype=np.int32), np.array(wall, dtype=np.int32)


@part(fastmath=FAST)
def shape_forces(rows, shapes, walls, block, numbers, step, h):
    """Add the contact forces of planes and cylinders; returns the number of contacts, or -1 - i where i is behind one."""
    x, radius, particle, wall = rows.x, rows.radius, shapes.particle, shapes.wall
    kind, shape, motion = shapes.kind, shapes.shape, walls.motion
    touching, m, bad, total = 0, np.int64(0), 0, len(particle)
    for k in range(total):
        i, n = particle[k], wall[k]
        px, py, pz, distance = surface_point(kind[n], shape[n], motion[n], x[i, 0], x[i, 1], x[i, 2])
        if distance < radius[i]:
            if not distance > 0:
                bad = -1 - np.int64(i)
            add_contact(block, m, i, k, n, x[i, 0] - px, x[i, 1] - py, x[i, 2] - pz, radius[i], 1.0)
            m += 1
        if m == BLOCK or k == total - 1:
            finish_block(block, m, rows, shapes.spring, shapes.stamp, walls, numbers, step, h)
            touching, m = touching + m, 0
    return bad if bad < 0 else touching


@njit
def move_walls(kind, shape, motion, h):
    """Carry walls that may leave their place along with their velocity, and turn their normal or axis with their rotation;
    of surfaces the rotation vector."""
    for n in range(len(kind)):
        if kind[n] != FACETS:
            for k in range(3):
                motion[n, k] += h * motion[n, 3 + k]
        if kind[n] == SURFACE:
            for k in range(3):
                shape[n, k] += h * motion[n, 6 + k]
        elif kind[n] != FACETS:
            ax, ay, az = shape[n, 0], shape[n, 1], shape[n, 2]
            ax += h * (motion[n, 7] * shape[n, 2] - motion[n, 8] * shape[n, 1])
            ay += h * (motion[n, 8] * shape[n, 0] - motion[n, 6] * shape[n, 2])
            az += h * (motion[n, 6] * shape[n, 1] - motion[n, 7] * shape[n, 0])
            length = np.sqrt(ax * ax + ay * ay + az * az)
            shape[n, 0], shape[n, 1], shape[n, 2] = ax / length, ay / length, az / length


@njit
def push_walls(load, motion, ranks, h):
    """Change the velocities of walls under loads by these and the forces of the last sub-step. Collective."""
    for n in range(len(load)):
        if load[n, 4] > 0:
            change = h * (load[n, 3] + total(ranks, load[n, 5])) * load[n, 4]
            way = 0.0
            for k in range(3):
                motion[n, 3 + k] += change * load[n, k]
                way += h * motion[n, 3 + k] * load[n, k]
            load[n, 6] += abs(way)


@njit
def note_forces(load, force):
    """Keep the force along each load in the sub-step that ``force``, the sums so far, ends with."""
    for n in range(len(load)):
        along = load[n, 0] * force[n, 0] + load[n, 1] * force[n, 1] + load[n, 2] * force[n, 2]
        load[n, 5], load[n, 7] = along - load[n, 7], along
