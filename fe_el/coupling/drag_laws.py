"""Drag laws F(solid_fraction, reynolds) of one sphere in a suspension, for model A.

The drag force of a sphere is f = 3 pi mu d phi F (u - v) with phi = 1 - solid_fraction and Reynolds number
rho phi |u - v| d / mu. Every law takes and returns arrays, is finite at Reynolds number zero (Stokes), and may be
replaced by a function of your own with the same two arguments.
"""
import numpy as np

_SMALL = 1e-12


def beetstra(solid_fraction, reynolds):
    """Beetstra, van der Hoef & Kuipers, AIChE J. 53 (2007) 489; Re to 1000, solid fraction to 0.6."""
    s, phi, re = solid_fraction, 1 - solid_fraction, np.maximum(reynolds, _SMALL)
    viscous = 10 * s / phi ** 2 + phi ** 2 * (1 + 1.5 * np.sqrt(s))
    inertial = (1 / phi + 3 * s * phi + 8.4 * re ** -0.343) / (1 + 10 ** (3 * s) * re ** (-(1 + 4 * s) / 2))
    return viscous + 0.413 * re / (24 * phi ** 2) * inertial


def wen_yu(solid_fraction, reynolds):
    """Wen & Yu, Chem. Eng. Prog. Symp. Ser. 62 (1966) 100; dilute to moderately dense."""
    return _single_sphere(reynolds) * (1 - solid_fraction) ** -3.65


def ergun(solid_fraction, reynolds):
    """Ergun, Chem. Eng. Prog. 48 (1952) 89; packed beds."""
    return (150 * solid_fraction + 1.75 * reynolds) / (18 * (1 - solid_fraction) ** 2)


def gidaspow(solid_fraction, reynolds):
    """Gidaspow (1994): Wen-Yu above a void fraction of 0.8, Ergun below; not continuous there."""
    return np.where(1 - solid_fraction > 0.8, wen_yu(solid_fraction, reynolds), ergun(solid_fraction, reynolds))


def schiller_naumann(solid_fraction, reynolds):
    """Schiller & Naumann (1935): a single sphere, no influence of the others; Re to 1000."""
    return 1 + 0.15 * reynolds ** 0.687 + 0 * solid_fraction


def _single_sphere(reynolds):
    """Cd Re / 24 of one sphere: Schiller-Naumann, Cd = 0.44 above Re = 1000."""
    return np.where(reynolds < 1000, 1 + 0.15 * np.minimum(reynolds, 1000) ** 0.687, 0.44 * reynolds / 24)


LAWS = {law.__name__: law for law in (beetstra, wen_yu, ergun, gidaspow, schiller_naumann)}
