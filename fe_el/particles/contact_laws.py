"""Contact laws: their parameters, and what follows from them."""
from typing import NamedTuple

import numpy as np

from fe_el.particles.insertion import require_positive


class LawNumbers(NamedTuple):
    """What the pair kernel needs of a linear law."""

    stiffness: float
    tangential_stiffness: float
    damping: float  #: normal damping over sqrt(m* k)
    tangential_damping: float  #: tangential over normal damping
    friction: float


class LinearSpringDashpot:
    """Linear spring and dashpot with a tangential spring and Coulomb friction.

    F_n = k_n overlap - eta_n v_n,  eta_n = 2 sqrt(m* k_n) |ln e| / sqrt(pi^2 + ln^2 e)  (Tsuji et al. 1993).

    Args:
        stiffness (float): normal stiffness k_n [N/m].
        restitution (float): coefficient of restitution e, in (0, 1].
        friction (float): Coulomb coefficient, not negative.
        tangential_stiffness_ratio (float): k_t / k_n.
        tangential_damping_ratio (float): eta_t / eta_n.

    Raises:
        ValueError: for a number out of its range.
    """

    def __init__(self, stiffness, restitution, friction, tangential_stiffness_ratio=2 / 7, tangential_damping_ratio=0.5):
        require_positive("stiffness", stiffness)
        if not 0 < restitution <= 1:
            raise ValueError(f"The restitution is {restitution}; it must be greater than 0 and at most 1.")
        if not (friction >= 0 and np.isfinite(friction)):
            raise ValueError(f"The friction is {friction}; it must be finite and not negative.")
        if not 0 < tangential_stiffness_ratio <= 1:
            raise ValueError(f"The tangential stiffness ratio is {tangential_stiffness_ratio}; it must be in (0, 1].")
        if not 0 <= tangential_damping_ratio <= 1:
            raise ValueError(f"The tangential damping ratio is {tangential_damping_ratio}; it must be in [0, 1].")
        self.stiffness, self.restitution, self.friction = float(stiffness), float(restitution), float(friction)
        log = abs(np.log(restitution))
        self.numbers = LawNumbers(self.stiffness, self.stiffness * tangential_stiffness_ratio,
                                  2 * log / np.hypot(np.pi, log), float(tangential_damping_ratio), self.friction)

    def contact_time(self, reduced_mass):
        """Duration of a collision [s]: pi / sqrt(k/m* - eta^2/(4 m*^2))."""
        return np.pi * np.sqrt(reduced_mass / self.stiffness) / np.sqrt(1 - self.numbers.damping ** 2 / 4)
