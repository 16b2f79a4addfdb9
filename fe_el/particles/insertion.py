"""Checks and positions of inserted particles."""
from typing import NamedTuple

import numpy as np

from fe_el import checks
from fe_el.checks import require_positive
from fe_el.compiled.cache import njit
from fe_el.particles.contacts.wall_shapes import surface_point
from fe_el.particles.contacts.walls import facet_balls, nearest_point


class Obstacles(NamedTuple):
    """What particles must not overlap: facets with their balls, planes and cylinders."""

    corner: np.ndarray  #: (facets, d, 3) [m]
    ball: np.ndarray  #: (facets, 7)
    kind: np.ndarray  #: (shapes,)
    shape: np.ndarray  #: (shapes, 4)
    origin: np.ndarray  #: (shapes, 3 or more) [m]


class New(NamedTuple):
    """Particles that are to be inserted, with full arrays of n rows."""

    position: np.ndarray  #: (n, 3) [m]
    diameter: np.ndarray  #: (n,) [m]
    density: np.ndarray  #: (n,) [kg/m^3]
    velocity: np.ndarray  #: (n, 3) [m/s]
    material: np.ndarray  #: (n,)
    number: np.ndarray  #: (n,) particles in each


def check(particles, position, diameter, density, velocity, material, coarse_graining, number) -> New:
    """The arguments of an insertion as full arrays, after checking them."""
    if checks.numbers("positions", position).size == 0:
        raise ValueError("The particle set is empty; give at least one position.")
    x = checks.points("positions", position)
    n, v = len(x), checks.numbers("velocity", velocity)
    if v.ndim and v.shape not in ((2,), (3,), (n, 2), (n, 3)) or not np.isfinite(v).all() or v.ndim == 0 and v != 0:
        raise ValueError(f"The velocity has shape {v.shape} for {n} particles"
                         f"{'' if np.isfinite(v).all() else ' and is not finite'}; give two or three finite numbers, or a "
                         "row of these for each [m/s].")
    full = np.zeros((n, 3))
    full[:, :v.shape[-1] if v.ndim else 3] = v
    if particles.mesh.topology.dim == 2 and (full[:, 2].any() or x[:, 2].any()):
        raise ValueError("Positions or velocities have a third component on a mesh of two dimensions; it must be zero.")
    kinds = checks.numbers("material", material)
    if kinds.shape not in ((), (n,)) or not np.isfinite(kinds).all() or (kinds < 0).any() or (kinds % 1).any():
        raise ValueError(f"The material is {material}; give the index of a material, 0 or more, or one for each particle.")
    density = particles.default_density if density is None else density
    number = checks.per_particle("coarse graining", coarse_graining, n) ** 3 if number is None else number
    return New(x, checks.per_particle("diameter", diameter, n), checks.per_particle("density", density, n), full,
               np.broadcast_to(kinds.astype(np.int32), n), checks.per_particle("number of particles in a parcel", number, n))


def check_box(particles, lower, upper) -> list[np.ndarray]:
    """Two corners of as many numbers as the mesh has dimensions."""
    d = particles.mesh.topology.dim
    corners = [checks.numbers(name, value) for name, value in (("lower corner", lower), ("upper corner", upper))]
    for name, corner in zip(("lower", "upper"), corners):
        if corner.shape not in ((d,), (3,)) or not np.isfinite(corner).all():
            raise ValueError(f"The {name} corner of the box is {corner.tolist()}; give {d} finite numbers.")
    return corners


def claim(particles, x):
    """Owned cell of each position on this rank, -1 where another rank has it; each has exactly one rank."""
    cell = particles.search(x)
    rank = np.where(cell >= 0, particles.comm.rank, particles.comm.size).astype(np.int64)
    first = np.empty_like(rank)
    from mpi4py import MPI
    particles.comm.Allreduce(rank, first, op=MPI.MIN)
    outside = np.flatnonzero(first == particles.comm.size)
    if len(outside):
        raise ValueError(f"Position {x[outside[0]].tolist()} of particle {outside[0]} is outside the mesh "
                         f"({len(outside)} of {len(x)} are); insert particles inside it.")
    return np.where(first == particles.comm.rank, cell, -1).astype(np.int32)


def spheres_near(particles, lower, upper, reach):
    """Centres (spheres, 3) and radii of the particles of all ranks that come within ``reach`` of a box.

    Note:
        Collective.
    """
    lo, hi = np.full(3, -np.inf), np.full(3, np.inf)
    lo[:len(lower)], hi[:len(upper)] = lower, upper
    x, radius = particles.position.copy(), 0.5 * particles.diameter
    particles.wrap(x)
    far = (particles.period if particles.period is not None else np.zeros(3)) > 0
    near = np.flatnonzero((((x > lo - (radius + reach)[:, None]) & (x < hi + (radius + reach)[:, None])) | far).all(1))
    parts = particles.comm.allgather((x[near], radius[near], particles.id[near]))
    order = np.argsort(np.concatenate([p[2] for p in parts]))
    return np.concatenate([p[0] for p in parts])[order], np.concatenate([p[1] for p in parts])[order]


def boundary_near(particles, lower, upper, reach):
    """Corners (facets, d, 3) of the boundary facets of all ranks that may come within ``reach`` of a box.

    Note:
        Collective.
    """
    cells, d = particles.cells, particles.mesh.topology.dim
    cell, facet = np.nonzero(cells.neighbour[:cells.owned] < 0)
    keep = np.array([[v for v in range(d + 1) if v != f] for f in range(d + 1)])
    corner = cells.corner[cell[:, None], keep[facet]]
    k = min(len(lower), d)
    near = (corner.min(1)[:, :k] < np.asarray(upper)[:k] + reach) & (corner.max(1)[:, :k] > np.asarray(lower)[:k] - reach)
    return np.concatenate(particles.comm.allgather(corner[near.all(1)]))


def displacements(count, dimension, largest, seed):
    """Random displacements (count, dimension) of at most ``largest`` [m] along each axis."""
    checks.not_negative_number("displacement", largest)
    seed = checks.seed_number(seed)
    return np.random.default_rng(seed).uniform(-1, 1, (count, dimension)) * largest


def check_walls(walls):
    """Raise ``ValueError`` unless this is a list of walls."""
    if not isinstance(walls, (list, tuple)) or any(isinstance(w, type) or not hasattr(w, "motion") for w in walls):
        raise ValueError(f"The walls to stay off are {walls!r}; give a list of walls, for instance contacts.walls.")


def shapes_of(walls):
    """Kind, shape and origin of the planes and cylinders among some walls, as arrays."""
    chosen = [w for w in walls if hasattr(w, "moved") and not hasattr(w, "corners")]
    return (np.array([w.kind for w in chosen], np.int64), np.array([w.shape for w in chosen]).reshape(-1, 4),
            np.array([w.motion()[:3] for w in chosen]).reshape(-1, 3))


def random_positions(lower, upper, count, diameter, seed, without_overlap, period=None, there=None, boundary=None,
                     shapes=None):
    """Uniform random positions (count, 3) in a box, at random or by sequential insertion without overlap.

    ``there``: centres and radii of spheres that are there already, ``boundary``: facets, ``shapes``: planes and cylinders
    as :func:`shapes_of` gives them; absent: none.
    """
    lower, upper = np.asarray(lower, float), np.asarray(upper, float)
    count = checks.whole_number("number of particles", count, 1)
    if not (upper >= lower).all():
        raise ValueError(f"The box from {lower.tolist()} to {upper.tolist()} is empty; give lower <= upper.")
    diameter = checks.per_particle("diameter", diameter, count)
    rng = np.random.default_rng(checks.seed_number(seed))
    if not without_overlap:
        return lower + rng.random((count, len(lower))) * (upper - lower)
    radius = diameter / 2
    lo, hi = np.zeros(3), np.zeros(3)
    lo[:len(lower)], hi[:len(upper)] = lower, upper
    order = np.argsort(-radius, kind="stable")
    there = there or (np.zeros((0, 3)), np.zeros(0))
    boundary = np.zeros((0, 3, 3)) if boundary is None else boundary
    balls = facet_balls(boundary) if len(boundary) else np.zeros((0, 7))
    x, placed = _sequential(lo, hi, radius[order], seed, np.zeros(3) if period is None else period, *there,
                            Obstacles(boundary, balls, *(shapes or shapes_of([]))))
    if placed < count:
        raise ValueError(f"Only {placed} of {count} particles fit without overlap in the box from {lower.tolist()} to "
                         f"{upper.tolist()}; use a larger box, fewer particles, or insert_on_lattice.")
    out = np.empty_like(x)
    out[order] = x
    return out[:, :len(lower)]


@njit
def _touches(x, radius, obstacles):
    """Whether a sphere reaches one of the facets, planes and cylinders."""
    corner, ball = obstacles.corner, obstacles.ball
    kind, shape, origin = obstacles.kind, obstacles.shape, obstacles.origin
    for n in range(len(kind)):
        if surface_point(kind[n], shape[n], origin[n], x[0], x[1], x[2])[3] < radius:
            return True
    for f in range(len(ball)):
        dx, dy, dz, far = x[0] - ball[f, 0], x[1] - ball[f, 1], x[2] - ball[f, 2], radius + ball[f, 3]
        if dx * dx + dy * dy + dz * dz < far * far and abs(dx * ball[f, 4] + dy * ball[f, 5] + dz * ball[f, 6]) < radius:
            qx, qy, qz, _, _, _ = nearest_point(corner[f], x[0], x[1], x[2])
            if (qx - x[0]) ** 2 + (qy - x[1]) ** 2 + (qz - x[2]) ** 2 < radius * radius:
                return True
    return False


@njit
def _sequential(lower, upper, new_radius, seed, period, there, their_radius, obstacles):
    """Random sequential insertion, largest first, with bins of one largest diameter; periodic images count."""
    np.random.seed(seed)
    old, shape, size = len(there), np.ones(3, np.int64), np.empty(3)
    n, radius, x = old + len(new_radius), np.append(their_radius, new_radius), np.zeros((old + len(new_radius), 3))
    for k in range(3):
        shape[k] = max(1, int((upper[k] - lower[k]) / (2 * radius.max())))
        size[k] = max((upper[k] - lower[k]) / shape[k], 1e-300)
    head, following = np.full(shape.prod(), -1, np.int64), np.full(n, -1, np.int64)
    at, trial = np.zeros(3, np.int64), np.zeros(3)
    for i in range(old):  # those outside the box are at most a bin away: they stand in its outermost bins
        x[i] = there[i]
        for k in range(3):
            at[k] = min(max(int(np.floor((x[i, k] - lower[k]) / size[k])), 0), shape[k] - 1)
        box = (at[0] * shape[1] + at[1]) * shape[2] + at[2]
        following[i], head[box] = head[box], i
    for i in range(old, n):
        done = False
        for _ in range(20000):
            for k in range(3):
                trial[k] = lower[k] + np.random.random() * (upper[k] - lower[k])
                at[k] = min(int((trial[k] - lower[k]) / size[k]), shape[k] - 1)
            free = not _touches(trial, radius[i] * (1 - 1e-9), obstacles)
            for a in range(at[0] - 1, at[0] + 2):
                for b in range(at[1] - 1, at[1] + 2):
                    for c in range(at[2] - 1, at[2] + 2):
                        box, outside = 0, False
                        for k, q in enumerate((a, b, c)):
                            outside |= (q < 0 or q >= shape[k]) and not period[k] > 0
                            box = box * shape[k] + q % shape[k]
                        j = -1 if outside else head[box]
                        while j >= 0 and free:
                            distance = 0.0
                            for k in range(3):
                                gap = trial[k] - x[j, k]
                                if period[k] > 0:
                                    gap -= np.round(gap / period[k]) * period[k]
                                distance += gap * gap
                            free = distance > (radius[i] + radius[j]) ** 2
                            j = following[j]
            if free:
                done = True
                break
        if not done:
            return x[old:], i - old
        x[i] = trial
        box = (at[0] * shape[1] + at[1]) * shape[2] + at[2]
        following[i], head[box] = head[box], i
    return x[old:], n - old


def lattice_positions(lower, upper, diameter, seed):
    """A square lattice filled from below (last coordinate), a little disturbed, spheres of any size apart."""
    lower, upper = np.asarray(lower, float), np.asarray(upper, float)
    require_positive("diameter", diameter)
    if not len(diameter):
        raise ValueError("The diameter of particles on a lattice is empty; give one for each particle.")
    largest = diameter.max()
    number = np.maximum(((upper - lower) / largest * (1 + 1e-9)).astype(int), 0)
    if number.prod() < len(diameter):
        raise ValueError(f"Only {number.prod()} spheres of diameter {largest:g} fit on a lattice in the box from "
                         f"{lower.tolist()} to {upper.tolist()}, but {len(diameter)} were asked for; use a higher box.")
    index = np.stack(np.unravel_index(np.arange(len(diameter)), number[::-1]), 1)[:, ::-1]
    pitch = (upper - lower) / number
    pitch[-1] = min(pitch[-1], 1.02 * largest)
    noise = np.random.default_rng(seed).uniform(-0.5, 0.5, index.shape)
    return lower + (index + 0.5) * pitch + noise * np.maximum(pitch - diameter[:, None], 0)
