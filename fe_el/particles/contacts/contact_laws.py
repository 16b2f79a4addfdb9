"""Contact laws: their parameters per pair of materials, and what follows from them."""
import functools
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fe_el.checks import numbers, require_not_negative, require_positive


class LawNumbers(NamedTuple):
    """What the kernels need of a law, a table row per pair of materials (:mod:`fe_el.particles.contacts.law_kernels`)."""

    kind: int  #: 0 linear, 1 Hertz
    rolls: int  #: 0 no rolling friction, 1 constant torque, 2 elastic-plastic, 3 and 4 the same with torsion
    cohesive: bool
    needs_radius: bool
    table: np.ndarray  #: (materials, materials, 8), the last one not used


class RollingFriction:
    """Rolling friction: a torque of at most ``coefficient`` R* F_n against the relative rotation.

    Args:
        coefficient: mu_r, a number or (materials, materials).
        elastic_plastic (bool): a rolling spring that holds slopes at rest (Ai et al. 2011); absent: constant torque.
        torsion (bool): also against rotation about the contact normal, which nothing else stops: a pile that is to come to
            rest entirely needs it.

    Raises:
        ValueError: for a negative coefficient.
    """

    def __init__(self, coefficient: ArrayLike, elastic_plastic: bool = False, torsion: bool = False) -> None:
        require_not_negative("rolling friction", coefficient)
        if not np.size(coefficient):
            raise ValueError("The rolling friction is empty; give a number, or a symmetric table (materials, materials).")
        self.torsion = bool(torsion)
        self.coefficient, self.elastic_plastic = np.asarray(coefficient, float), bool(elastic_plastic)


def pair_table(name, value, materials):
    """Symmetric (materials, materials) array of a number or a table.

    Raises:
        ValueError: for another shape or an asymmetric table.
    """
    value = np.asarray(value, float)
    if value.ndim == 0:
        return np.full((materials, materials), float(value))
    if value.shape != (materials, materials) or not np.array_equal(value, value.T):
        raise ValueError(f"The {name} has shape {value.shape} for {materials} materials; give one number or a symmetric "
                         f"table "
                         f"({materials}, {materials}).")
    return value


class _Law:
    """What both laws share: restitution, friction, rolling friction and cohesion of each pair of materials."""

    kind: int  #: as in :class:`LawNumbers`

    def __setattr__(self, name, value):
        """Refuse changes of a finished law, which its tables would not follow."""
        if "stiffness" in self.__dict__:
            raise AttributeError(f"The {name} of a contact law cannot be set any more; make a new law and give it to the "
                                 "contacts: contacts.law = ...")
        super().__setattr__(name, value)

    def _common(self, restitution, friction, rolling, attraction, materials):
        e = restitution
        if not ((e > 0).all() and (e <= 1).all()):
            raise ValueError(f"The restitution is {e.tolist()}; it must be greater than 0 and at most 1.")
        require_not_negative("friction", friction)
        require_not_negative(*attraction)
        self.materials = materials
        self.table = np.zeros((materials, materials, 8))
        log = np.abs(np.log(pair_table("restitution", e, materials)))
        self.damping = 2 * log / np.hypot(np.pi, log)
        self.table[:, :, 2] = pair_table("friction", friction, materials)
        self.rolls = 0
        if rolling is not None:
            self.table[:, :, 5] = pair_table("rolling friction", rolling.coefficient, materials)
            self.rolls = (2 if rolling.elastic_plastic else 1) + (2 if rolling.torsion else 0)
        self.table[:, :, 6] = pair_table(*attraction, materials)

    @functools.cached_property
    def numbers(self) -> LawNumbers:
        """What the kernels need."""
        cohesive = bool(self.table[:, :, 6].any())
        return LawNumbers(self.kind, self.rolls, cohesive, bool(self.kind == 1 or cohesive or self.rolls), self.table)


def rolling_coefficient(rolling):
    """Its coefficient, zero without; raises ``ValueError`` for anything but a :class:`RollingFriction`."""
    if rolling is not None and not isinstance(rolling, RollingFriction):
        raise ValueError(f"rolling is {rolling!r}; pass RollingFriction(coefficient), or leave it out.")
    return 0.0 if rolling is None else rolling.coefficient


def materials_of(*values):
    """Number of materials that the shapes of the given numbers speak of."""
    return max([1] + [np.asarray(v).shape[0] for v in values if np.asarray(v).ndim])


class LinearSpringDashpot(_Law):
    """Linear spring and dashpot with a tangential spring and Coulomb friction.

    F_n = k_n overlap - eta_n v_n,  eta_n = 2 sqrt(m* k_n) |ln e| / sqrt(pi^2 + ln^2 e)  (Tsuji et al. 1993).
    Every number may be a symmetric table (materials, materials); particles and walls carry the index of their material.

    Args:
        stiffness: normal stiffness k_n [N/m].
        restitution: coefficient of restitution e, in (0, 1].
        friction: Coulomb coefficient, not negative.
        tangential_stiffness_ratio: k_t / k_n, in (0, 1].
        tangential_damping_ratio: eta_t / eta_n, in [0, 1].
        rolling (RollingFriction): absent: none.
        surface_energy: W of an attraction 2 pi R* W while surfaces touch (Derjaguin, Mueller & Toporov 1975) [J/m^2].
        cohesion: refused, see :class:`HertzMindlin`.

    Raises:
        ValueError: for a number out of its range or a table of the wrong shape.
    """

    kind = 0

    def __init__(self, stiffness: ArrayLike, restitution: ArrayLike, friction: ArrayLike,
                 tangential_stiffness_ratio: ArrayLike = 2 / 7, tangential_damping_ratio: ArrayLike = 0.5,
                 rolling: RollingFriction | None = None, surface_energy: ArrayLike = 0.0, cohesion: ArrayLike = 0.0) -> None:
        require_positive("stiffness", stiffness)
        restitution, friction = numbers("restitution", restitution), numbers("friction", friction)
        surface_energy = numbers("surface energy", surface_energy)
        if numbers("cohesion", cohesion).any() or not np.size(cohesion):
            raise ValueError(f"The linear law has cohesion {cohesion!r} J/m^3; an attraction by the contact area only takes "
                             "from a linear stiffness and nothing sticks. Give surface_energy= [J/m^2], or use a "
                             "HertzMindlin law.")
        kt = numbers("tangential stiffness ratio", tangential_stiffness_ratio)
        et = numbers("tangential damping ratio", tangential_damping_ratio)
        if not ((kt > 0).all() and (kt <= 1).all()):
            raise ValueError(f"The tangential stiffness ratio is {kt.tolist()}; it must be in (0, 1].")
        if not ((et >= 0).all() and (et <= 1).all()):
            raise ValueError(f"The tangential damping ratio is {et.tolist()}; it must be in [0, 1].")
        n = materials_of(stiffness, restitution, friction, kt, et, rolling_coefficient(rolling), surface_energy)
        self._common(restitution, friction, rolling, ("surface energy", surface_energy), n)
        self.table[:, :, 0] = pair_table("stiffness", stiffness, n)
        self.table[:, :, 1] = self.damping
        self.table[:, :, 3] = pair_table("tangential stiffness ratio", kt, n)
        self.table[:, :, 4] = pair_table("tangential damping ratio", et, n)
        self.stiffness = self.table[:, :, 0].max()

    def contact_time(self, reduced_mass: float | np.ndarray, reduced_radius: float | np.ndarray | None = None,
                     speed: float | np.ndarray | None = None) -> float:
        """Duration of the shortest collision [s]: pi / sqrt(k/m* - eta^2/(4 m*^2)), over all pairs of materials.

        Masses and radii are numbers, or (materials, materials).
        """
        period = np.pi * np.sqrt(reduced_mass / self.table[:, :, 0]) / np.sqrt(1 - self.damping ** 2 / 4)
        return float(period.min())


class HertzMindlin(_Law):
    """Hertz's normal force and Mindlin's tangential spring, with the damping of constant restitution.

    F_n = 4/3 E* sqrt(R* overlap) overlap,  k_t = 8 G* sqrt(R* overlap)  (Tsuji et al. 1992; Antypov & Elliott 2011).

    Args:
        youngs_modulus: E of each material, a number or (materials,) [Pa].
        poisson_ratio: a number or (materials,), in (-1, 0.5].
        restitution, friction, rolling: as in :class:`LinearSpringDashpot`.
        cohesion: energy density c of an attraction c pi overlap 2 R* [J/m^3].

    Raises:
        ValueError: for a number out of its range or a table of the wrong shape.
    """

    kind = 1

    def __init__(self, youngs_modulus: ArrayLike, poisson_ratio: ArrayLike, restitution: ArrayLike, friction: ArrayLike,
                 rolling: RollingFriction | None = None, cohesion: ArrayLike = 0.0) -> None:
        require_positive("Young's modulus", youngs_modulus)
        restitution, friction = numbers("restitution", restitution), numbers("friction", friction)
        cohesion = numbers("cohesion energy density", cohesion)
        nu = numbers("Poisson ratio", poisson_ratio)
        if not ((nu > -1).all() and (nu <= 0.5).all()):
            raise ValueError(f"The Poisson ratio is {nu.tolist()}; it must be in (-1, 0.5].")
        n = materials_of(youngs_modulus, nu, restitution, friction, rolling_coefficient(rolling), cohesion)
        try:
            e, nu = np.broadcast_to(np.asarray(youngs_modulus, float), n), np.broadcast_to(nu, n)
        except ValueError:
            raise ValueError(f"Young's modulus and Poisson ratio are given for another number of materials than {n}; give "
                             f"one "
                             f"number each or {n}.") from None
        self._common(restitution, friction, rolling, ("cohesion energy density", cohesion), n)
        soft, shear = (1 - nu ** 2) / e, 2 * (2 - nu) * (1 + nu) / e
        self.table[:, :, 0] = 1 / (soft[:, None] + soft)
        self.table[:, :, 1] = np.sqrt(5 / 6) * self.damping
        self.table[:, :, 3] = 1 / (shear[:, None] + shear) / self.table[:, :, 0]
        self.table[:, :, 4] = 1.0
        self.stiffness = self.table[:, :, 0].max()

    def contact_time(self, reduced_mass: float | np.ndarray, reduced_radius: float | np.ndarray,
                     speed: float | np.ndarray) -> float:
        """Duration of a collision at the relative speed [s]: 2.94328 (15 m* v^2/(16 E* sqrt R*))^0.4 / v."""
        deepest = (15 * reduced_mass * speed ** 2 / (16 * self.table[:, :, 0] * np.sqrt(reduced_radius))) ** 0.4
        return float((2.94328 * deepest / speed).min())
