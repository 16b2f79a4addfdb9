"""Forces of the fluid on particles, composed as a list."""
import inspect

import numpy as np

from fe_el.coupling import drag_laws


class Drag:
    """Drag by a law ``law(solid_fraction, reynolds) -> F`` (see :mod:`fe_el.drag_laws`), or the name of a built-in one.

    Raises:
        ValueError: for an unknown name, or something that is not such a function.
    """

    def __init__(self, law):
        if isinstance(law, str):
            if law not in drag_laws.LAWS:
                raise ValueError(f"There is no drag law {law!r}; use one of {sorted(drag_laws.LAWS)} or pass a function.")
            law = drag_laws.LAWS[law]
        if not callable(law) or len(inspect.signature(law).parameters) < 2:
            raise ValueError(f"The drag law is {law!r}; pass a function law(solid_fraction, reynolds) that returns F.")
        self.law = law

    def coefficient(self, solid_fraction, slip, diameter, density, viscosity):
        """beta = 18 mu phi F / d^2 per particle volume (particles,) [kg/(m^3 s)]."""
        phi = 1 - solid_fraction
        reynolds = density * phi * slip * diameter / viscosity
        return 18 * viscosity * phi * self.law(solid_fraction, reynolds) / diameter ** 2


class PressureGradient:
    """The force -V grad p on each particle; the fluid carries the share phi grad p of the gradient (model A)."""


def momentum_rates(beta, density, dt):
    """beta' = rho_p (1 - exp(-dt beta / rho_p)) / dt (particles,): the drag that an exact relaxation over dt exchanges."""
    return -density * np.expm1(-dt * beta / density) / dt
