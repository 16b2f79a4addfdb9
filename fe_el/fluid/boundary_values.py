"""Velocities that users give on boundaries: checked, evaluated, integrated, ramped."""
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from fe_el.checks import numbers, positive_number


def volume_flux(facets, value, time, dimension):
    """Volume per time that leaves through each facet with a velocity value [m^3/s]."""
    mean = sum(velocity_at(value, time, at, dimension) for at in facets.points) / dimension
    return (mean * facets.area_normal).sum(1)


def velocity_at(value, time, position, dimension):
    """Velocity (points, d) from a constant or a function ``value(time, position (points, 3))``.

    Raises:
        ValueError: if it has the wrong shape or is not finite.
    """
    if isinstance(value, type):
        raise ValueError(f"The velocity is {value!r}; give {dimension} numbers, or a function (time, position).")
    v = numbers("velocity", value(time, position) if callable(value) else value)
    if v.shape not in ((dimension,), (len(position), dimension)):
        raise ValueError(f"The velocity has shape {v.shape}; give {dimension} numbers, or a function (time, position) "
                         f"that returns an array (points, {dimension}).")
    v = np.broadcast_to(v, (len(position), dimension))
    if not np.isfinite(v).all():
        raise ValueError(f"The boundary velocity at time {time:g} is not finite; give finite numbers [m/s].")
    return v


def check_fields(fields, cells, dimension):
    """Raise ``ValueError`` unless these are the fields that a step takes: DG0 Functions for this rank's cells."""
    sizes = [len(f.x.array) / width if hasattr(f, "x") else 0
             for f, width in zip(fields, (1, 1, dimension, 1, 1, 1))] if isinstance(fields, (tuple, list)) else []
    if len(sizes) not in (3, 4, 6) or len(fields) > 6 or min(sizes) < cells or max(sizes) != min(sizes):
        raise ValueError("The fields of a step are not void fraction, drag coefficient (DG0) and momentum source (DG0 "
                         f"vector) of this mesh, but {str(fields)[:60]}; pass Coupling.fields, or Functions of such kind.")


def ramp(value: ArrayLike | Callable[[float, np.ndarray], ArrayLike],
         duration: float) -> Callable[[float, np.ndarray], np.ndarray]:
    """Velocity of an inlet that rises smoothly from zero to ``value`` within ``duration`` [s].

    Args:
        value: d numbers, or a function (time, position).

    Raises:
        ValueError: for a duration that is not positive.
    """
    duration = positive_number("duration of the ramp", duration)
    if not callable(value) or isinstance(value, type):
        speed = numbers("velocity to ramp up to", value)
        if not speed.size or not np.isfinite(speed).all():
            raise ValueError(f"The velocity to ramp up to is {value!r}; give finite numbers [m/s].")

    def rising(time, position):
        s = min(max(time / duration, 0.0), 1.0)
        return s * s * (3 - 2 * s) * np.asarray(value(time, position) if callable(value) else value, float)
    return rising
