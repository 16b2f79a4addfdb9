"""Contact laws that are plain array functions of the user's."""
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from fe_el.checks import positive_number
from fe_el.compiled.direct_calls import Direct
from fe_el.particles.contacts.pair_forces import scatter_arrays, touching_pairs

_touching_pairs = Direct(touching_pairs)


class ArrayLaw:
    """A contact law between particles from a plain array function.

    Args:
        function: ``(overlap, normal_velocity, tangential_velocity, spring, reduced_mass, reduced_radius, dt) ->
            (normal_force, tangential_force, spring)`` with arrays (contacts,) and (contacts, 3): overlap [m], velocities of
            the first particle relative to the second [m/s] (normal: positive when they part), the tangential spring [m], and
            forces on the first particle [N] (normal: positive when it repels). A dashpot eta gives its restitution in a
            few sub-steps too if it is made less by 0.48 dt^2 k / m*, as in the built-in laws.
        contact_time (float): shortest duration of a contact [s]; sets the sub-steps.

    Raises:
        ValueError: for something that cannot be called, or a contact time that is not positive.
    """

    def __init__(self, function: Callable[..., tuple], contact_time: float) -> None:
        if not callable(function):
            raise ValueError(  # noqa: TRY004
                f"The contact law is {function!r}; pass a function of arrays.")
        self.function, self._contact_time = function, positive_number("contact time", contact_time)

    def contact_time(self, reduced_mass: ArrayLike, reduced_radius: ArrayLike | None = None,
                     speed: ArrayLike | None = None) -> float:
        """Duration of the shortest collision [s]."""
        return self._contact_time


def array_forces(law, rows, pairs, step, h):
    """Add the pair forces of an :class:`ArrayLaw`; returns the number of contacts and the largest overlap over diameter."""
    x, state, radius, inverse_mass = rows.x, rows.state, rows.radius, rows.inverse_mass
    spring, stamp = pairs.spring, pairs.stamp
    at = _touching_pairs(rows, pairs)
    i, j = pairs.first[at], pairs.second[at]
    d = x[i] - x[j]
    r = np.linalg.norm(d, axis=1)
    normal, reach = d / r[:, None], radius[i] + radius[j]
    arms = (radius[i] * r / reach, radius[j] * r / reach)
    v, w = state[:, 1:4], state[:, 4:7]
    u = v[i] - v[j] - np.cross(arms[0][:, None] * w[i] + arms[1][:, None] * w[j], normal)
    un = (u * normal).sum(1)
    old = np.where((stamp[at] == step - 1)[:, None], spring[at, :3], 0.0)
    old -= (old * normal).sum(1)[:, None] * normal
    before = np.where(stamp[at] == step - 1, spring[at, 3], un)
    spring[at, 3] = un
    fn, ft, new = law.function(reach - r, 1.5 * un - 0.5 * before, u - un[:, None] * normal, old,
                               1 / (inverse_mass[i] + inverse_mass[j]),
                               radius[i] * radius[j] / reach, h)
    spring[at, :3], stamp[at] = new, step
    scatter_arrays(i, j, np.ascontiguousarray(np.asarray(fn)[:, None] * normal + ft), *arms, normal, rows.force)
    return len(at), 0.5 * ((reach - r) / np.minimum(radius[i], radius[j])).max(initial=0.0)
