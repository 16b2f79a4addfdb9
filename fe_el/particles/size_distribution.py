"""Distributions of particle diameters, for inlets and injectors."""
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from fe_el.checks import numbers, positive_number, require_not_negative, require_positive

CLASSES = 1000  # of a curve
PART = 1.01  # largest ratio of the bounds of a class in which all parcels count as holding the same number of particles


class SizeDistribution:
    """Diameters in classes, each with a share of the number or of the mass of all particles; within a class all diameters
    are equally frequent.

    It is also a function ``(generator, count) -> diameters``, of single particles, as :class:`Inlet` takes.

    Args:
        lower, upper: (classes,) bounds of the classes, equal for single sizes [m].
        shares: (classes,) not negative, of any sum.
        by (str): what the shares are of: ``number`` or ``mass``.

    Attributes:
        smallest, largest (float): diameters that occur [m].

    Raises:
        ValueError: for bounds that are not positive or in the wrong order, shares that are negative or all zero.
    """

    def __init__(self, lower: ArrayLike, upper: ArrayLike, shares: ArrayLike, by: str = "number") -> None:
        require_positive("diameter", lower)
        require_positive("diameter", upper)
        require_not_negative("shares of the sizes", shares)
        self.lower, self.upper, part = (np.atleast_1d(np.asarray(a, float)) for a in (lower, upper, shares))
        if by not in ("number", "mass"):
            raise ValueError(f"The shares of the sizes are by {by!r}; use 'number' or 'mass'.")
        if not self.lower.shape == self.upper.shape == part.shape or part.ndim != 1:
            raise ValueError(f"The sizes have bounds of shapes {self.lower.shape} and {self.upper.shape}, their shares have "
                             f"shape {part.shape}; give one of each for each class.")
        if not (self.upper >= self.lower).all() or not part.sum() > 0:
            raise ValueError("The upper bounds of the sizes must not be below the lower ones, nor all shares zero.")
        cube = (self.lower + self.upper) * (self.lower ** 2 + self.upper ** 2) / 4  # mean of the cube over a class
        self.by_number = part / cube if by == "mass" else part.copy()
        self.by_number /= self.by_number.sum()
        self.smallest, self.largest = self.lower[part > 0].min(), self.upper[part > 0].max()

    @classmethod
    def listed(cls, diameters: ArrayLike, shares: ArrayLike | None = None, by: str = "number") -> "SizeDistribution":
        """Single sizes (sizes,) [m] with shares of the number or the mass of all; absent: equal shares."""
        sizes = np.atleast_1d(numbers("diameters", diameters))
        return cls(sizes, sizes, np.ones(len(sizes)) if shares is None else numbers("shares", shares), by)

    @classmethod
    def sieves(cls, openings: ArrayLike, passing: ArrayLike) -> "SizeDistribution":
        """A sieve table: the share of the mass ``passing`` (sieves,) through the ``openings`` (sieves,) [m], both
        rising; below the first opening there is nothing, above the last one neither.

        Raises:
            ValueError: for a table that does not rise, or of fewer than two sieves.
        """
        openings, passing = numbers("openings", openings), numbers("passing shares", passing)
        if openings.shape != passing.shape or openings.size < 2 or (np.diff(openings) <= 0).any() \
                or (np.diff(passing) < 0).any():
            raise ValueError(f"The sieve table has openings {openings.tolist()} and passing shares {passing.tolist()}; give "
                             "two or more of each, rising.")
        edges = np.union1d(np.linspace(openings[0], openings[-1], CLASSES + 1), openings)
        return cls._of_curve(edges, np.interp(edges, openings, passing), "mass")

    @classmethod
    def normal(cls, mean: float, deviation: float, smallest: float | None = None,
               largest: float | None = None) -> "SizeDistribution":
        """Normal by number, with mean and standard deviation [m] before it is cut at ``smallest`` and ``largest`` [m];
        absent: at three deviations, but not below a hundredth of the mean."""
        mean, deviation = positive_number("mean diameter", mean), positive_number("deviation of the diameter", deviation)
        edges = _edges(_or(smallest, max(mean - 3 * deviation, 0.01 * mean)), _or(largest, mean + 3 * deviation))
        return cls._of_curve(edges, _normal((edges - mean) / deviation), "number")

    @classmethod
    def lognormal(cls, median: float, spread: float, smallest: float | None = None, largest: float | None = None,
                  by: str = "number") -> "SizeDistribution":
        """Lognormal by number or mass, with median [m] and geometric standard deviation ``spread``, above 1; cut as
        :meth:`normal`, absent: at spread^4 from the median."""
        median, spread = positive_number("median diameter", median), positive_number("spread of the diameter", spread)
        if not spread > 1:
            raise ValueError(f"The geometric standard deviation of the diameter is {spread}; it must be greater than 1.")
        edges = _edges(_or(smallest, median / spread ** 4), _or(largest, median * spread ** 4), True)
        return cls._of_curve(edges, _normal(np.log(edges / median) / math.log(spread)), by)

    @classmethod
    def rosin_rammler(cls, size: float, exponent: float, smallest: float | None = None,
                      largest: float | None = None) -> "SizeDistribution":
        """Share 1 - exp(-(d / size)^exponent) of the mass finer than d (Rosin & Rammler 1933), ``size`` in m; cut as
        :meth:`normal`, absent: where 0.1 % of the mass are finer or coarser."""
        size, exponent = positive_number("size", size), positive_number("exponent", exponent)
        ends = size * (-np.log([0.999, 0.001])) ** (1 / exponent)
        edges = _edges(_or(smallest, ends[0]), _or(largest, ends[1]), True)
        return cls._of_curve(edges, -np.expm1(-(edges / size) ** exponent), "mass")

    @classmethod
    def _of_curve(cls, edges, finer, by):
        return cls(edges[:-1], edges[1:], np.diff(finer), by)

    def mean_cube(self) -> float:
        """Mean of the cube of the diameter by number [m^3]: times pi/6 and the density the mean mass of a particle."""
        return float(self.by_number @ ((self.lower + self.upper) * (self.lower ** 2 + self.upper ** 2) / 4))

    def of_parcels(self, number: Callable[[np.ndarray], ArrayLike]) -> "SizeDistribution":
        """The distribution, by number of parcels, of parcels that stand for ``number(diameters)`` particles each, such that
        the particles are distributed as said: wide classes are cut to parts of one per cent of their diameters."""
        parts = np.maximum(np.ceil(np.log(self.upper / self.lower) / np.log(PART)), 1).astype(int)
        of = np.repeat(np.arange(len(parts)), parts)
        part = np.arange(len(of)) - np.repeat(np.cumsum(parts) - parts, parts)
        ratio = (self.upper / self.lower) ** (1 / parts)
        lower = self.lower[of] * ratio[of] ** part
        upper = np.where(part + 1 < parts[of], self.lower[of] * ratio[of] ** (part + 1), self.upper[of])
        width = (self.upper - self.lower)[of]
        share = np.where(width > 0, (upper - lower) / np.where(width > 0, width, 1.0), 1.0)
        middle = 0.5 * (lower + upper)
        return SizeDistribution(lower, upper, self.by_number[of] * share / np.broadcast_to(number(middle), middle.shape))

    def draw(self, generator: np.random.Generator, count: int,
             number: Callable[[np.ndarray], ArrayLike] | None = None) -> np.ndarray:
        """Diameters (count,) of parcels that stand for ``number(diameters)`` particles each, such that the particles are
        distributed as said (:meth:`of_parcels`); absent: of single particles."""
        if number is not None:
            return self.of_parcels(number).draw(generator, count)
        below = np.cumsum(self.by_number)
        random = generator.random((count, 2))
        k = np.minimum(np.searchsorted(below, random[:, 0] * below[-1], side="right"), len(below) - 1)
        return self.lower[k] + random[:, 1] * (self.upper[k] - self.lower[k])

    def __call__(self, generator: np.random.Generator, count: int) -> np.ndarray:
        return self.draw(generator, count)


def _or(given, absent):
    return absent if given is None else given


def _edges(smallest, largest, by_ratio=False):
    smallest, largest = positive_number("smallest diameter", smallest), positive_number("largest diameter", largest)
    if not largest > smallest:
        raise ValueError(f"The smallest diameter is {smallest:g} m and the largest {largest:g} m; the largest must be above "
                         "the smallest.")
    return (np.geomspace if by_ratio else np.linspace)(smallest, largest, CLASSES + 1)


def _normal(x):
    """Share of a standard normal distribution below x."""
    return np.array([0.5 * (1 + math.erf(v / math.sqrt(2))) for v in np.ravel(x)])
