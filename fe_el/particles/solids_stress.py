"""The stress of crowded particles, as a function of their solid fraction."""
import numpy as np
from numpy.typing import ArrayLike

from fe_el.checks import positive_number
from fe_el.compiled.cache import njit


@njit
def stress_over_fraction(s, numbers):
    """tau / s at a solid fraction from 0 to below 1, and its derivative [Pa]."""
    strength, exponent, packing, epsilon = numbers
    room, rate = packing - s, 1.0
    if room < epsilon * (1.0 - s):
        room, rate = epsilon * (1.0 - s), epsilon
    power = strength * s ** (exponent - 2.0) / room
    return power * s, power * (exponent - 1.0 + s * rate / room)


@njit
def implicit_fraction(total, step, guess, numbers):
    """The solid fraction s in [0, 1) with s + step tau(s) / s = total, by Newton's method between two bounds."""
    if total <= 0.0:
        return 0.0
    low, high = 0.0, min(total, 1.0 - 1e-12)
    s = min(high, guess if guess > 0.0 else numbers[2])
    for _ in range(100):
        stress, slope = stress_over_fraction(s, numbers)
        excess = s + step * stress - total
        if excess > 0.0:
            high = s
        else:
            low = s
        new = s - excess / (1.0 + step * slope)
        if not low < new < high:
            new = 0.5 * (low + high)
        if abs(new - s) < 1e-14:
            break
        s = new
    return s


class SolidsStress:
    """tau = P s^b / max(s_cp - s, epsilon (1 - s)) at the solid fraction s (Harris & Crighton 1994; Snider 2001).

    Nothing where particles are few, and without bound (but for epsilon) towards close packing.

    Args:
        strength (float): P [Pa].
        exponent (float): b, 2 to 5.
        close_packing (float): s_cp.
        epsilon (float): keeps the stress finite beyond close packing.

    Raises:
        ValueError: for numbers out of range.
    """

    def __init__(self, strength: float = 10.0, exponent: float = 3.0, close_packing: float = 0.63,
                 epsilon: float = 1e-7) -> None:
        self.strength = positive_number("strength of the solids stress", strength)
        self.exponent = positive_number("exponent of the solids stress", exponent)
        self.close_packing = positive_number("close packing", close_packing)
        self.epsilon = positive_number("epsilon of the solids stress", epsilon)
        if not self.exponent >= 2:
            raise ValueError(f"The exponent of the solids stress is {exponent}; give 2 or more: with less few particles "
                             "would drive each other apart.")
        if not self.close_packing < 1:
            raise ValueError(f"The close packing is {close_packing}; it must be below 1.")

    @property
    def numbers(self) -> tuple[float, float, float, float]:
        """Strength, exponent, close packing and epsilon."""
        return self.strength, self.exponent, self.close_packing, self.epsilon

    def __call__(self, solid_fraction: ArrayLike) -> float | np.ndarray:
        """tau [Pa] at solid fractions from 0 to below 1, of any shape."""
        s = np.asarray(solid_fraction, float)
        return self.strength * s ** self.exponent / np.maximum(self.close_packing - s, self.epsilon * (1 - s))
