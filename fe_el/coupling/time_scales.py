"""Time scales of gas-particle flow, and what they say about the scheme and the time step (Radl et al., eqs. 9 to 11)."""
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fe_el.coupling.drag_laws import stokes


def drag_coefficient(diameter: ArrayLike, viscosity: float, solid_fraction: ArrayLike,
                     law: Callable[[np.ndarray, np.ndarray], np.ndarray] = stokes,
                     reynolds: ArrayLike = 0.0) -> float | np.ndarray:
    """beta = 18 mu phi F / d^2 per particle volume [kg/(m^3 s)]; ``law`` absent: Stokes."""
    s, re = np.asarray(solid_fraction, float), np.asarray(reynolds, float)
    return 18 * viscosity * (1 - s) * law(s, re) / np.asarray(diameter, float) ** 2


def particle_relaxation_time(diameter: ArrayLike, particle_density: float, viscosity: float, solid_fraction: ArrayLike = 0.0,
                             law: Callable[[np.ndarray, np.ndarray], np.ndarray] = stokes,
                             reynolds: ArrayLike = 0.0) -> float | np.ndarray:
    """tau_p = rho_p / beta [s]: a particle takes the velocity of the fluid within it (Stokes at zero solids: eq. 9)."""
    return particle_density / drag_coefficient(diameter, viscosity, solid_fraction, law, reynolds)


def fluid_relaxation_time(diameter: ArrayLike, fluid_density: float, viscosity: float, solid_fraction: ArrayLike,
                          law: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
                          reynolds: ArrayLike = 0.0) -> float | np.ndarray:
    """tau_f = rho phi / (s beta) [s]: the fluid takes the velocity of the particles within it.

    ``law`` absent: eq. 10, rho d^2 (1 - s) / (18 mu s), in which the drag of a sphere has no factor phi.
    """
    s = np.asarray(solid_fraction, float)
    if law is None:
        return np.asarray(diameter, float) ** 2 * fluid_density * (1 - s) / (18 * viscosity * s)
    return fluid_density * (1 - s) / (s * drag_coefficient(diameter, viscosity, s, law, reynolds))


def courant_time(cell_size: float, speed: float, courant: float = 0.5) -> float:
    """tau_Co = Co dx / U [s] (eq. 11)."""
    return courant * cell_size / speed


def explicit_limit(diameter: ArrayLike, fluid_density: float, viscosity: float, largest_solid_fraction: ArrayLike,
                   law: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = stokes,
                   reynolds: ArrayLike = 0.0) -> float | np.ndarray:
    """Largest step of explicit drag [s]: 2 tau_f at the largest *local* solid fraction, beyond which the slip grows."""
    return 2 * fluid_relaxation_time(diameter, fluid_density, viscosity, largest_solid_fraction, law, reynolds)


def homogeneous_slip(diameter: float, particle_density: float, fluid_density: float, viscosity: float, solid_fraction: float,
                     law: Callable[[np.ndarray, np.ndarray], np.ndarray], gravity: float = 9.81) -> float:
    """Slip velocity of a uniform suspension at rest [m/s]: (rho_p - rho) g d^2 / (18 mu F), F at that slip."""
    s = np.array([float(solid_fraction)])
    slip = (particle_density - fluid_density) * gravity * diameter ** 2 / (18 * viscosity)
    target, low, high = slip, 0.0, slip * 1e3
    for _ in range(200):
        slip = 0.5 * (low + high)
        re = np.array([fluid_density * (1 - solid_fraction) * slip * diameter / viscosity])
        if slip * float(law(s, re)[0]) > target:
            high = slip
        else:
            low = slip
    return slip


class Advice(NamedTuple):
    """Time scales of a scene [s], and the scheme and step they suggest."""

    particle_relaxation: float
    fluid_relaxation: float
    courant: float
    explicit_limit: float
    contact: float
    scheme: str
    time_step: float
    sentence: str


def advice(diameter: float, particle_density: float, fluid_density: float, viscosity: float, solid_fraction: float,
           speed: float, cell_size: float, law: Callable[[np.ndarray, np.ndarray], np.ndarray],
           largest_solid_fraction: float = 0.6, contact_time: float = np.inf) -> Advice:
    """Which scheme and step to take.

    Args:
        diameter, particle_density, fluid_density, viscosity: of particles and fluid [SI].
        solid_fraction, largest_solid_fraction: mean, and the largest one expected in any cell.
        speed: of the fluid relative to the cells [m/s].
        cell_size: [m].
        law: drag law.
        contact_time: duration of a contact [s]; absent: none.

    Raises:
        ValueError: for numbers that are not positive.
    """
    for name, value in (("diameter", diameter), ("particle density", particle_density), ("fluid density", fluid_density),
                        ("viscosity", viscosity), ("solid fraction", solid_fraction), ("speed", speed),
                        ("cell size", cell_size)):
        if not value > 0:
            raise ValueError(f"The {name} is {value}; it must be greater than zero.")
    slip = homogeneous_slip(diameter, particle_density, fluid_density, viscosity, solid_fraction, law)
    re = fluid_density * (1 - solid_fraction) * slip * diameter / viscosity
    tau_p = float(particle_relaxation_time(diameter, particle_density, viscosity, solid_fraction, law, re))
    tau_f = float(fluid_relaxation_time(diameter, fluid_density, viscosity, solid_fraction, law, re))
    tau_c = courant_time(cell_size, speed)
    limit = float(explicit_limit(diameter, fluid_density, viscosity, largest_solid_fraction, law, re))
    accurate = min(tau_c, 0.5 * tau_p)
    if limit > accurate:
        scheme, why = "explicit", "drag is slow against the flow, so any scheme will do"
    else:
        scheme, why = "conservative", f"explicit drag would need steps below {limit:.2g} s"
    sub = "" if contact_time > 50 * accurate else \
        f" Contacts of {contact_time:.2g} s need about {50 * accurate / contact_time:.0f} " \
        "sub-steps."
    return Advice(tau_p, tau_f, tau_c, limit, float(contact_time), scheme, accurate,
                  f"Use scheme='{scheme}' with steps of about {accurate:.2g} s: {why}.{sub}")
