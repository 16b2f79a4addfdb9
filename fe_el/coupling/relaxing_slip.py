"""Drag that is not linear in the slip, over a step in which the slip relaxes.

A law gives the coefficient at one slip s; over a long step ds/dt = -k(s) s, with k = beta / rho_p, falls differently from
the exponential with k of the start. The coefficient here is that of the exponential with the same slip at the end, so the
impulse is right, and the rate that particles move by is the one whose exponential has the same mean slip, so the way is.
"""
import numpy as np

SUB_STEP = 0.1  # of the slip's own relaxation time
MOST = 64  # sub-steps


def over_step(coefficient, slip, density, span):
    """Mean coefficient (particles,) [kg/(m^3 s)] and rate of the way (particles,) [1/s] over a step.

    Args:
        coefficient: function (slip) -> beta (particles,), of the law.
        slip: (particles,) at the start [m/s].
        density: (particles,) of the particles [kg/m^3].
        span: (particles,) or a number, how long the drag acts [s].
    """
    rate = coefficient(slip) / density
    own = np.clip(np.ceil(rate * span / SUB_STEP), 1, MOST)  # sub-steps of each particle, whatever others are there
    steps, left, way, a = int(own.max(initial=1)), np.ones_like(slip), np.zeros_like(slip), np.zeros_like(slip)
    for n in range(steps):  # exponential midpoint rule
        h = np.where(n < own, span / own, 0.0)
        rate = rate if n == 0 else coefficient(slip * left) / density
        rate = coefficient(slip * left * np.exp(-0.5 * h * rate)) / density
        way += left * -np.expm1(-h * rate) / np.maximum(rate, 1e-300)
        a += h * rate
        left = np.exp(-a)
    behind = (1 - way / span) / np.maximum(1 - left, 1e-300)
    return density * a / span, np.where(a < 1e-3, a, _exponent(behind)) / span


def _exponent(behind):
    """a with 1 / (1 - exp(-a)) - 1 / a = behind, of 1/2 to 1 (Newton)."""
    behind = np.clip(behind, 0.5 + 1e-9, 1 - 1e-9)
    a = 1.5 * (2 * behind - 1) / (1 - behind) / (1 + behind) * 2
    for _ in range(8):
        e = -np.expm1(-a)
        a = np.maximum(a - (1 / e - 1 / a - behind) / (1 / a ** 2 - (1 - e) / e ** 2), 1e-4)
    return a
