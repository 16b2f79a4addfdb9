"""Forces of the fluid on particles, composed as a list; what an object of the list is: see
:mod:`fe_el.coupling.fluid_at_particles`."""
import inspect
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from fe_el.checks import numbers
from fe_el.compiled.cache import njit
from fe_el.coupling import drag_laws

if TYPE_CHECKING:
    from fe_el.coupling.fluid_at_particles import FluidAtParticles


@njit
def _reynolds(solid, slip, diameter, density, viscosity):
    return density / viscosity * (1 - solid) * slip * diameter


@njit
def _coefficient(drag, solid, diameter, viscosity):
    return 18 * viscosity * (1 - solid) * drag / (diameter * diameter)


PART = 8192  # particles whose drag by a built-in law is computed at once: what lies between stays in the caches


class Drag:
    """Drag by a law ``law(solid_fraction, reynolds) -> F`` (see :mod:`fe_el.drag_laws`), or the name of a built-in one.

    Args:
        law: function or name.
        polydisperse (bool): evaluate F at the local Sauter diameter d32 and multiply it by y + 0.064 y^3, y = d / d32
            (Beetstra et al. 2007).
        relaxing (bool): let a law that is not linear follow the slip as it falls over a step that is not small against the
            particles' relaxation time, for the ``conservative`` scheme; up to 128 evaluations of the law.

    Raises:
        ValueError: for an unknown name, or something that is not such a function.
    """

    def __init__(self, law: str | Callable[[np.ndarray, np.ndarray], np.ndarray], polydisperse: bool = False,
                 relaxing: bool = False) -> None:
        if isinstance(law, str):
            if law not in drag_laws.LAWS:
                raise ValueError(f"There is no drag law {law!r}; use one of {sorted(drag_laws.LAWS)} or pass a function.")
            law = drag_laws.LAWS[law]
        if not callable(law) or isinstance(law, type) or len(inspect.signature(law).parameters) < 2:
            raise ValueError(f"The drag law is {law!r}; pass a function law(solid_fraction, reynolds) that returns F.")
        self.law, self.polydisperse, self.relaxing = law, bool(polydisperse), bool(relaxing)

    def coefficient(self, solid_fraction: np.ndarray, slip: np.ndarray, diameter: np.ndarray, density: float,
                    viscosity: float, sauter: np.ndarray | None = None) -> np.ndarray:
        """beta = 18 mu phi F / d^2 per particle volume (particles,) [kg/(m^3 s)]; ``sauter`` is the local d32 [m]."""
        size = diameter if sauter is None else sauter
        reynolds = _reynolds(solid_fraction, slip, size, density, viscosity)
        if self.law in drag_laws.LAWS.values() and len(slip) > PART:
            drag = np.empty(len(slip))
            for first in range(0, len(slip), PART):
                part = slice(first, first + PART)
                drag[part] = self.law(solid_fraction[part], reynolds[part])
        else:
            drag = self.law(solid_fraction, reynolds)
        if sauter is not None:
            y = diameter / sauter
            drag = drag * (y + 0.064 * y ** 3)
        return _coefficient(drag, solid_fraction, diameter, viscosity)


class PressureGradient:
    """The force -V grad p on each particle; the fluid carries the share phi grad p of the gradient (model A).

    Args:
        mean: a constant part of -grad p that acts beside the solved pressure (three numbers) [Pa/m]: in a periodic box the
            one that carries the weight; give the fluid the same as ``mean_pressure_gradient``.
        at_end (bool): whether the pressure is that of the end of the step, for fluids that take a share of the pressure
            gradient as a fourth field, or that of the step before. Absent: of the end where ``Coupling.of`` knows such a
            fluid, and the particles that are there by then, or the density given to :class:`Particles`, are less than a
            thousand times as dense as it: there the pressure of the step before lets dense suspensions gain energy.
    """

    def __init__(self, mean: ArrayLike = (0.0, 0.0, 0.0), at_end: bool | None = None) -> None:
        if at_end not in (None, True, False):
            raise ValueError(f"at_end is {at_end!r}; give True or False, or leave it out.")
        self.mean, self.at_end = np.zeros(3), at_end
        mean = numbers("mean pressure gradient", mean).ravel()
        if mean.size not in (2, 3) or not np.isfinite(mean).all():
            raise ValueError(f"The mean pressure gradient is {mean.tolist()}; give two or three finite numbers [Pa/m].")
        self.mean[:mean.size] = mean


class ViscousStress:
    """The force V div tau on each particle; the fluid receives the opposite through its momentum source.

    The fluid should then carry the whole div tau: ``VolumeAveragedNavierStokes(..., stress_of_mixture=True)``.
    """

    needs = ("stress_divergence",)

    def force(self, fluid: "FluidAtParticles") -> np.ndarray:
        """V div tau (particles, d) [N]."""
        return fluid.volume[:, None] * fluid.stress_divergence


class Buoyancy:
    """The force -rho_f V g, for fluids whose pressure leaves the hydrostatic part out (no gravity in the fluid)."""
