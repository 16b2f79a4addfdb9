"""Drag laws F(solid_fraction, reynolds) of one sphere in a suspension, for model A.

The drag force of a sphere is f = 3 pi mu d phi F (u - v) with phi = 1 - solid_fraction and Reynolds number
rho phi |u - v| d / mu. Laws published for the total force of the fluid (Tenneti, Koch-Hill) are multiplied by phi here,
because model A adds the pressure gradient separately. Every law takes and returns arrays, is finite at Reynolds number zero
(Stokes), and may be replaced by a function of your own with the same two arguments.
"""
import math

import numpy as np

from fe_el.compiled.cache import njit
from fe_el.compiled.elementary import exponential, logarithm

_SMALL = 1e-12


@njit(fastmath={"contract"}, error_model="numpy")
def _beetstra(solid_fraction, reynolds, out):
    """One loop that becomes vectors: a third of the time of whole arrays, operation by operation."""
    for i in range(len(out)):
        s, phi, re = solid_fraction[i], 1 - solid_fraction[i], _SMALL if reynolds[i] < _SMALL else reynolds[i]
        log, by_phi, square = logarithm(re), 1 / phi, phi * phi
        viscous = 10 * s * by_phi * by_phi + square * (1 + 1.5 * math.sqrt(s))
        inertial = by_phi + 3 * s * phi + 8.4 * exponential(-0.343 * log)
        crowded = 1 + exponential(3 * math.log(10) * s - (0.5 + 2 * s) * log)
        out[i] = viscous + 0.413 / 24 * re * by_phi * by_phi * inertial / crowded


def _one_by_one(loop, solid_fraction, reynolds):
    """A law's loop for numbers or arrays that broadcast."""
    s, re = np.broadcast_arrays(np.asarray(solid_fraction, float), np.asarray(reynolds, float))
    out = np.empty(s.shape)
    loop(np.ascontiguousarray(s).reshape(-1), np.ascontiguousarray(re).reshape(-1), out.reshape(-1))
    return out[()]


def beetstra(solid_fraction: np.ndarray, reynolds: np.ndarray) -> np.ndarray:
    """Beetstra, van der Hoef & Kuipers, AIChE J. 53 (2007) 489; Re to 1000, solid fraction to 0.6."""
    return _one_by_one(_beetstra, solid_fraction, reynolds)


def tang(solid_fraction: np.ndarray, reynolds: np.ndarray) -> np.ndarray:
    """Tang, Peters, Kuipers, Kriebitzsch & van der Hoef, AIChE J. 61 (2015) 688; Re to 1000, solid fraction to 0.6."""
    s, phi, re = solid_fraction, 1 - solid_fraction, np.maximum(reynolds, 0.0)
    viscous = 10 * s / phi ** 2 + phi ** 2 * (1 + 1.5 * np.sqrt(s))
    return viscous + (0.11 * s * (1 + s) - 0.00456 / phi ** 4) * re + (0.169 * phi + 0.0644 / phi ** 4) * re ** 0.657


def tenneti(solid_fraction: np.ndarray, reynolds: np.ndarray) -> np.ndarray:
    """Tenneti, Garg & Subramaniam, Int. J. Multiphase Flow 37 (2011) 1072; Re to 300, solid fraction to 0.5."""
    s, phi, re = solid_fraction, 1 - solid_fraction, np.maximum(reynolds, 0.0)
    single = (1 + 0.15 * re ** 0.687) / phi ** 3
    crowd = 5.81 * s / phi ** 3 + 0.48 * np.cbrt(s) / phi ** 4
    return phi * (single + crowd + s ** 3 * re * (0.95 + 0.61 * s ** 3 / phi ** 2))


def koch_hill(solid_fraction: np.ndarray, reynolds: np.ndarray) -> np.ndarray:
    """Koch & Hill, Annu. Rev. Fluid Mech. 33 (2001) 619, and Hill, Koch & Ladd, J. Fluid Mech. 448 (2001) 243."""
    s, phi = solid_fraction, 1 - solid_fraction
    safe = np.maximum(s, 1e-300)
    dilute = (1 + 3 * np.sqrt(s / 2) + 135 / 64 * s * np.log(safe) + 16.14
              * s) / (1 + 0.681 * s - 8.48 * s ** 2 + 8.16 * s ** 3)
    still = np.where(s < 0.4, dilute, 10 * s / phi ** 3)
    return phi * (still + 0.5 * (0.0673 + 0.212 * s + 0.0232 / phi ** 5) * np.maximum(reynolds, 0.0))


def di_felice(solid_fraction: np.ndarray, reynolds: np.ndarray) -> np.ndarray:
    """Di Felice, Int. J. Multiphase Flow 20 (1994) 153, with Dallavalle's drag of one sphere; any Re."""
    phi, re = 1 - solid_fraction, np.maximum(reynolds, _SMALL)
    exponent = 3.7 - 0.65 * np.exp(-(1.5 - np.log10(re)) ** 2 / 2)
    return (0.63 * np.sqrt(re) + 4.8) ** 2 / 24 * phi ** -exponent


def wen_yu(solid_fraction: np.ndarray, reynolds: np.ndarray) -> np.ndarray:
    """Wen & Yu, Chem. Eng. Prog. Symp. Ser. 62 (1966) 100; dilute to moderately dense."""
    return _single_sphere(reynolds) * (1 - solid_fraction) ** -3.65


def ergun(solid_fraction: np.ndarray, reynolds: np.ndarray) -> np.ndarray:
    """Ergun, Chem. Eng. Prog. 48 (1952) 89; packed beds."""
    return (150 * solid_fraction + 1.75 * reynolds) / (18 * (1 - solid_fraction) ** 2)


def gidaspow(solid_fraction: np.ndarray, reynolds: np.ndarray) -> np.ndarray:
    """Gidaspow (1994): Wen-Yu above a void fraction of 0.8, Ergun below; not continuous there."""
    return np.where(1 - solid_fraction > 0.8, wen_yu(solid_fraction, reynolds), ergun(solid_fraction, reynolds))


def schiller_naumann(solid_fraction: np.ndarray, reynolds: np.ndarray) -> np.ndarray:
    """Schiller & Naumann (1935): a single sphere, no influence of the others; Re to 1000."""
    return 1 + 0.15 * reynolds ** 0.687 + 0 * solid_fraction


def stokes(solid_fraction: np.ndarray, reynolds: np.ndarray) -> np.ndarray:
    """Stokes (1851): a single sphere in creeping flow."""
    return 1 + 0 * (solid_fraction + reynolds)


def _single_sphere(reynolds):
    """Cd Re / 24 of one sphere: Schiller-Naumann, Cd = 0.44 above Re = 1000."""
    return np.where(reynolds < 1000, 1 + 0.15 * np.minimum(reynolds, 1000) ** 0.687, 0.44 * reynolds / 24)


LAWS = {law.__name__: law for law in (beetstra, tang, tenneti, koch_hill, di_felice, wen_yu, ergun, gidaspow,
                                      schiller_naumann,
                                      stokes)}
