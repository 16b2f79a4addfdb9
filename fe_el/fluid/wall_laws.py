"""Wall laws: the friction of turbulent layers that are thinner than a cell, from the velocity that the cell beside the wall
has."""
import numpy as np

from fe_el.checks import positive_number
from fe_el.compiled.cache import njit


@njit
def _spalding(speed, distance, kinematic, kappa, constant, out):
    """Friction velocity squared over the speed [m/s], by Newton's method on the law for u+ = speed over friction
    velocity."""
    scale = np.exp(-kappa * constant)
    for i in range(len(speed)):
        reynolds = speed[i] * distance[i] / kinematic  # u+ y+
        u = min(np.sqrt(reynolds), np.log(reynolds + 1.0) / kappa + constant) + 1e-12  # beyond the solution
        for _ in range(60):
            k = kappa * u
            tail = scale * (np.expm1(k) - k - k * k / 2 - k * k * k / 6)
            slope = scale * kappa * (np.expm1(k) - k - k * k / 2)
            change = (u * (u + tail) - reynolds) / (2 * u + tail + u * slope)
            u = max(u - change, 0.5 * u)
            if abs(change) < 1e-12 * u:
                break
        out[i] = kinematic / distance[i] if reynolds < 1e-12 else speed[i] / (u * u)


class Spalding:
    """The law of the wall in one formula from the viscous layer to the logarithmic one (Spalding, J. Appl. Mech. 28, 1961,
    455).

    y+ = u+ + exp(-kappa B) (exp(kappa u+) - 1 - kappa u+ - (kappa u+)^2 / 2 - (kappa u+)^3 / 6). Give it to ``set_no_slip``
    for
    smooth walls whose layer the mesh does not resolve; in laminar flow it leaves the friction as it is without.

    Args:
        kappa (float): von Karman's constant.
        constant (float): B.

    Raises:
        ValueError: for numbers that are not positive.
    """

    def __init__(self, kappa: float = 0.4, constant: float = 5.5) -> None:
        self.kappa = positive_number("von Karman's constant (kappa)", kappa)
        self.constant = positive_number("constant of the wall law", constant)

    def __call__(self, speed: np.ndarray, distance: np.ndarray, density: float, viscosity: float) -> np.ndarray:
        """Wall stress over speed (facets,) [Pa s/m] at speeds (facets,) [m/s] along the wall and distances (facets,) [m]
        from it."""
        out = np.empty(len(speed))
        _spalding(speed, distance, viscosity / density, self.kappa, self.constant, out)
        return density * out
