"""Velocities that users give on boundaries: checked, evaluated, integrated, ramped."""
import numpy as np

from fe_el.checks import require_positive


def volume_flux(facets, value, time, dimension):
    """Volume per time that leaves through each facet with a velocity value [m^3/s]."""
    mean = sum(velocity_at(value, time, at, dimension) for at in facets.points) / dimension
    return (mean * facets.area_normal).sum(1)


def velocity_at(value, time, position, dimension):
    """Velocity (points, d) from a constant or a function ``value(time, position (points, 3))``.

    Raises:
        ValueError: if it has the wrong shape or is not finite.
    """
    v = np.asarray(value(time, position) if callable(value) else value, float)
    try:
        v = np.broadcast_to(v, (len(position), dimension))
    except ValueError:
        raise ValueError(f"The velocity has shape {v.shape}; give {dimension} numbers, or a function (time, position) "
                         f"that returns an array (points, {dimension}).") from None
    if not np.isfinite(v).all():
        raise ValueError(f"The boundary velocity at time {time:g} is not finite; give finite numbers [m/s].")
    return v


def ramp(value, duration):
    """Velocity of an inlet that rises smoothly from zero to ``value`` within ``duration`` [s].

    Args:
        value: d numbers, or a function (time, position).

    Raises:
        ValueError: for a duration that is not positive.
    """
    require_positive("duration of the ramp", duration)

    def rising(time, position):
        s = min(max(time / duration, 0.0), 1.0)
        return s * s * (3 - 2 * s) * np.asarray(value(time, position) if callable(value) else value, float)
    return rising
