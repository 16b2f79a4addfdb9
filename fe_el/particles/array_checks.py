"""What stops a step of particles: arrays that no step can start from, and velocities that are no longer numbers."""
import numpy as np

from fe_el.compiled.cache import njit
from fe_el.parallel.exchange import raise_everywhere
from fe_el.particles.arrays import FIELDS


@njit
def _are_spheres(position, diameter, density, number):
    """Whether positions are finite, and the others above zero, too."""
    for i in range(len(diameter)):
        good = np.isfinite(position[i, 0] + position[i, 1] + position[i, 2])
        for value in (diameter[i], density[i], number[i]):
            good &= 0.0 < value < np.inf
        if not good:
            return False
    return True


@njit
def first_not_finite(vectors):
    """The first of (particles, 3) vectors that is not finite, or -1."""
    for i in range(len(vectors)):
        if not np.isfinite(vectors[i, 0]) or not np.isfinite(vectors[i, 1]) or not np.isfinite(vectors[i, 2]):
            return i
    return -1


def check_arrays(particles):
    """Raise ``ValueError`` on every rank for arrays of the user's that no step can start from. Collective."""
    p, message, n = particles, None, len(particles)
    for name, shape in FIELDS.items():
        a = getattr(p, name)
        if not isinstance(a, np.ndarray) or a.shape != (n, *shape) or a.dtype != float:
            message = (f"The array {name} of the particles is {type(a).__name__} of shape {np.shape(a)}; it must be a "
                       f"numpy array of float of shape {(n, *shape)}, one row per particle of this rank. To set all "
                       f"alike: particles.{name}[:] = ...")
    if message is None and not _are_spheres(p.position, p.diameter, p.density, p.number):
        for name in ("diameter", "density", "number", "position"):
            a = getattr(p, name)
            good = np.isfinite(a).reshape(n, -1).all(1) & (a > 0 if a.ndim == 1 else True)
            if not good.all():
                message = (f"The {name} of particle {p.id[~good][0]} is {a[~good][0].tolist()}; it must be finite"
                           f"{' and greater than zero' if a.ndim == 1 else ''}.")
    raise_everywhere(p.comm, ValueError, message)


def check_velocities(particles):
    """Raise ``FloatingPointError`` on every rank for a velocity that is not finite. Collective."""
    p, message = particles, None
    i = first_not_finite(p.velocity)
    if i >= 0:
        message = (f"Particle {p.id[i]} has velocity {p.velocity[i].tolist()} at step {p.step} on rank {p.comm.rank}. Use a "
                   "smaller step or a softer contact law.")
    raise_everywhere(p.comm, FloatingPointError, message)
