"""Numba loops over cells alone; each reads and writes all it needs at once, as memory is what limits them."""
from fe_el.compiled.cache import njit
from fe_el.compiled.for_each_dimension import FAST


@njit(fastmath=FAST)
def begin(density, dt, phi0, phi, drag, volume, rate, mass0, mass1, damping):
    """Rate of the void fraction, fluid masses before and after, and the part of the velocity that drag takes; whether any
    rate is not zero."""
    moves = False
    for c in range(len(phi)):
        rate[c] = (phi[c] - phi0[c]) / dt
        moves |= rate[c] != 0.0
        mass0[c], mass1[c] = density * phi0[c] * volume[c], density * phi[c] * volume[c]
        damping[c] = drag[c] * dt / (density * phi[c] + drag[c] * dt)
    return moves


@njit(fastmath=FAST)
def stress_of(phi0, phi, middle, viscosity, of_mixture, share, stress):
    """The cells' share of the stress, in the ``middle`` of the step or at its end, and that times the viscosity."""
    for c in range(len(phi)):
        share[c] = 0.5 * (phi0[c] + phi[c]) if middle else phi[c]
        stress[c] = viscosity if of_mixture else viscosity * share[c]


@njit(fastmath=FAST)
def supply_of(rate, rate0, part, supply):
    """rate + part (rate - rate0)."""
    for c in range(len(rate)):
        supply[c] = rate[c] + part * (rate[c] - rate0[c])


@njit
def totals(values, volume):
    """Integral of cell values, and that of their size."""
    total, size = 0.0, 0.0
    for c in range(len(values)):
        total += values[c] * volume[c]
        size += abs(values[c]) * volume[c]
    return total, size
