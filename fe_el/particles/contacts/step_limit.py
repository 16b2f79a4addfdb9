"""The shortest contact of a run, which sub-steps resolve."""
import numpy as np

from fe_el.parallel.exchange import largest_of
from fe_el.particles.contacts.step_ends import lightest_and_smallest


def step_limit(particles, law, wall_law, meeting):
    """Shortest contact time in the run [s].

    Args:
        particles (Particles): the particles.
        law, wall_law: contact laws of pairs and of walls; absent: no walls.
        meeting (int): pieces of wall that meet in one point at most.

    Raises:
        ValueError: if there are no particles.

    Note:
        Collective.
    """
    p = particles
    count = max(getattr(one, "materials", None) or 1 for one in (law, wall_law))
    density = p.inertia / p.volume if "added_mass" in p.properties else p.density
    light, small = lightest_and_smallest(p.material, density, p.primary_diameter, count)
    extremes = (p.speed(), p.diameter.max()) if len(p) else np.zeros(2)
    speed, biggest, *rest = largest_of(p.comm, *extremes, *light, *small)
    light, small = np.array(rest).reshape(2, count)
    if not biggest > 0:
        raise ValueError("There are no particles; insert some before advancing contacts.")
    speed = max(2 * speed, np.sqrt(np.linalg.norm(p.gravity) * biggest), 1e-3)
    there = light > 0
    time = _shortest(law, light + light[:, None], small + small[:, None], there & there[:, None], speed)
    if wall_law is not None:
        together = max(meeting / 3, 1.0)  # three at right angles, as in a corner, do not add up
        alone = light[:, None] + 0 * light, small[:, None] + 0 * small, there[:, None] & (light > -1)
        time = min(time, _shortest(wall_law, *alone, speed) / np.sqrt(together))
    return time


def _shortest(law, inverse_mass, inverse_radius, there, speed):
    """Shortest contact time of the pairs of materials that are ``there`` [s]."""
    pairs = getattr(law, "materials", None) or 1
    if pairs < len(there):  # one law for all materials
        inverse_mass, inverse_radius = inverse_mass.max(keepdims=True), inverse_radius.max(keepdims=True)
        there = np.ones((1, 1), bool)
    mass, radius = 1 / np.where(there, inverse_mass, np.inf), 1 / np.where(there, inverse_radius, np.inf)
    mass, radius = np.where(there, mass, np.inf), np.where(there, radius, 1.0)
    return law.contact_time(mass, radius, speed)
