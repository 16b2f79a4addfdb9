"""Time-marching schemes of the momentum exchange: each is a choice of the drag coefficient A and the momentum source B.

A scheme sees the particles' side as arrays (:class:`Exchange`) and a linear map from particles to cell densities. It returns
A and B, and the force on the particles once the fluid's new velocity is known. The fluid does not know which scheme it is.
"""
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fe_el.coupling import particle_loops as loops
from fe_el.nodes.work_arrays import WorkArrays


class Exchange(NamedTuple):
    """What a scheme needs; d is the dimension."""

    dt: float
    volume: np.ndarray        #: (particles, 1) [m^3]
    density: np.ndarray       #: (particles, 1) [kg/m^3], infinite for a particle that is held
    velocity: np.ndarray      #: (particles, d) particle velocity [m/s]
    acceleration: np.ndarray  #: (particles, d) by everything but drag [m/s^2]
    beta: np.ndarray          #: (particles, 1) drag coefficient per particle volume [kg/(m^3 s)]
    fluid_velocity: np.ndarray  #: (particles, d) at the particle, before the step [m/s]
    offset: np.ndarray        #: (particles, d) interpolated less cell-mean fluid velocity [m/s]; None: zero
    to_cells: Callable        #: (particles, k) -> cell densities (cells, k), mapped, spilled and smoothed
    raw: Callable             #: (particles, k) -> cell totals (cells, k), mapped only
    cell_velocity: np.ndarray  #: (cells, d) fluid velocity before the step [m/s]
    continue_mean: Callable   #: (field, filled) -> mean particle velocity continued into empty cells
    late: np.ndarray          #: (particles,) share of the step after which a particle comes in; no rows: none does

    @property
    def mean_beta(self) -> np.ndarray:
        """(particles, 1) mean over the step: what comes in late has no drag before that."""
        return self.beta * (1 - self.late[:, None]) if len(self.late) else self.beta


class Conservative:
    """Exact relaxation of every particle over the step; what particles gain the fluid loses, to round-off, for any step.

    dv/dt = g_i + (beta_i / rho_p) (u - v) with constant u and g_i (all but drag) has the drag impulse V_i beta'_i dt (u -
    v*_i) with a_i = dt beta_i / rho_p, beta'_i = rho_p (1 - exp(-a_i)) / dt and v*_i = v_i + g_i dt (1 / (1 - exp(-a_i)) - 1
    / a_i). So A_j = sum w_ij V_i beta'_i / V_j, B_j = sum w_ij V_i beta'_i v*_i / V_j, and particle i then receives exactly
    V_i beta'_i (sum_j w_ij u_j - v*_i) with the new u. The settling velocity is exact at any step, and so is the drag on a
    particle that is held, whose beta'_i is beta_i.
    """

    def __init__(self) -> None:
        self._work = WorkArrays()

    def fields(self, x: Exchange) -> tuple[np.ndarray, np.ndarray]:
        """A (cells, 1) and B (cells, d)."""
        (n, d), work = x.velocity.shape, self._work
        self.target, self.relaxation_rate = work.empty("target", n, d), work.empty("relaxation_rate", n)
        self.rate_and_source = work.empty("rate_and_source", n, 1 + d)
        velocity = x.velocity if x.offset is None else x.velocity - x.offset
        loops.relax(x.dt, x.volume, x.density, x.beta, velocity, x.acceleration, x.late, self.relaxation_rate, self.target,
                    self.rate_and_source)
        out = x.to_cells(self.rate_and_source)
        return out[:, :1], out[:, 1:]

    def force(self, fluid_velocity: np.ndarray) -> np.ndarray:
        """(particles, d) [N] from the fluid's new velocity at the particles."""
        force = self._work.empty("force", *self.target.shape)
        loops.drag_force(self.rate_and_source, self.target, fluid_velocity, force)
        return force


class Explicit:
    """Drag from the old velocities: A = 0, B = -sum w F_i / V. Unstable beyond 2 tau_f at the largest local solid
    fraction."""

    relaxation_rate = 0.0  # the force is constant over the step

    def fields(self, x: Exchange) -> tuple[np.ndarray, np.ndarray]:
        """A (cells, 1) and B (cells, d)."""
        self.drag = x.volume * x.mean_beta * (x.fluid_velocity - x.velocity)
        b = -x.to_cells(self.drag)
        return np.zeros((len(b), 1)), b

    def force(self, fluid_velocity: np.ndarray) -> np.ndarray:
        """(particles, d) [N]: the old drag, whatever the new velocity is."""
        return self.drag


class Implicit(Explicit):
    """The paper's eq. 8: B = A <v> with the cell's drag and mean particle velocity at the new time. Momentum drifts."""

    def _new(self, x):
        """Velocity of the particles after their explicit step."""
        return x.velocity + x.dt * (x.acceleration + self.drag / (x.density * x.volume))

    def _mean(self, x):
        """Mean particle velocity after the explicit step of the particles, and the cells that hold any."""
        new = self._new(x)
        sums = x.raw(np.hstack([x.volume, x.volume * new]))
        filled = sums[:, 0] > 0
        mean = np.where(filled[:, None], sums[:, 1:] / np.where(filled, sums[:, 0], 1.0)[:, None], 0.0)
        return mean, filled

    def fields(self, x: Exchange) -> tuple[np.ndarray, np.ndarray]:
        """A (cells, 1) and B (cells, d)."""
        super().fields(x)
        a = x.to_cells(x.volume * x.mean_beta)
        return a, a * x.continue_mean(*self._mean(x))


class ImplicitFromForce(Implicit):
    """Eq. 8 with the coefficient that eq. 7 gives from the known force of eq. 6, A = |force| / |u - <v>|, as in
    CFDEMcoupling.

    It differs from ``implicit`` where particles see another velocity than the cell's mean. Momentum drifts, the more so with
    ``fluid_velocity="linear"``, which is what the paper has.
    """

    def fields(self, x: Exchange) -> tuple[np.ndarray, np.ndarray]:
        """A (cells, 1) and B (cells, d)."""
        Explicit.fields(self, x)
        mean = x.continue_mean(*self._mean(x))
        force = x.to_cells(x.volume * x.mean_beta * (x.fluid_velocity - self._new(x)))
        slip = np.linalg.norm(x.cell_velocity - mean, axis=1, keepdims=True)
        a = np.linalg.norm(force, axis=1, keepdims=True) / np.maximum(slip, 1e-12)
        return a, a * mean


class Split(Explicit):
    """Implicit in the cell, the rest explicit: B = -sum w F_i / V + A u_before (Radl et al. 2012)."""

    def fields(self, x: Exchange) -> tuple[np.ndarray, np.ndarray]:
        """A (cells, 1) and B (cells, d)."""
        _, b = super().fields(x)
        a = x.to_cells(x.volume * x.mean_beta)
        return a, b + a * x.cell_velocity


class VoidCellsExplicit(Implicit):
    """Eq. 8 in cells that hold particles, explicit in cells that only smoothing reaches; no mean velocity is continued."""

    def fields(self, x: Exchange) -> tuple[np.ndarray, np.ndarray]:
        """A (cells, 1) and B (cells, d)."""
        _, b = Explicit.fields(self, x)
        mean, filled = self._mean(x)
        a = np.where(filled[:, None], x.to_cells(x.volume * x.mean_beta), 0.0)
        return a, np.where(filled[:, None], a * mean, b)


SCHEMES: dict[str, Callable[[], Conservative | Explicit]] = {
    "conservative": Conservative, "explicit": Explicit, "implicit": Implicit, "implicit_from_force": ImplicitFromForce,
    "split": Split, "void_cells_explicit": VoidCellsExplicit}


def scheme_of(name: str) -> Conservative | Explicit:
    """The scheme of that name.

    Raises:
        ValueError: for an unknown name.
    """
    if not isinstance(name, str) or name not in SCHEMES:
        raise ValueError(f"There is no coupling scheme {name!r}; use one of {sorted(SCHEMES)}.")
    return SCHEMES[name]()
