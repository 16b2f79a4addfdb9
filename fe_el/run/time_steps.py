"""Time loops with progress and the time left: equal steps, and steps that follow the Courant number."""
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI
from tqdm import tqdm

from fe_el.checks import finite_number, positive_number

if TYPE_CHECKING:
    from fe_el.fluid.volume_averaged_navier_stokes import VolumeAveragedNavierStokes


def time_steps(dt: float, end_time: float, start: float = 0.0, comm: MPI.Comm = MPI.COMM_WORLD,
               progress: bool = True) -> Iterator[float]:
    """Yield the times start + dt, start + 2 dt, ... up to end_time, with a progress bar and the time left.

    Raises:
        ValueError: for a step that is not positive or an end before the start.
    """
    dt = positive_number("time step", dt)
    start, end_time = finite_number("start of the run", start), finite_number("end of the run", end_time)
    if not end_time > start:
        raise ValueError(f"The time step is {dt} and the run goes from {start} to {end_time}; give a positive step and an "
                         "end after the start.")
    number = int(np.ceil((end_time - start) / dt - 1e-9))
    with tqdm(total=number, disable=not progress or comm.rank > 0, unit="step", file=sys.stderr, mininterval=1.0) as bar:
        for k in range(1, number + 1):
            yield start + k * dt
            bar.update()


class adaptive_steps:  # noqa: N801  called like time_steps
    """Yield (time, dt) up to end_time with steps that keep the fluid's Courant number |u| dt / h at ``courant``.

    Call ``fluid.advance(dt)`` in the loop. A step never grows by more than ``growth``; it shrinks at once. A checkpoint that
    holds these steps goes on with the last one.

    Args:
        first (float): first step [s]; absent: by the Courant number of the initial velocity.
        largest (float): bound of the steps, for instance from :mod:`fe_el.time_scales` [s].

    Attributes:
        dt (float): the last step [s]; ``None`` before the first.

    Raises:
        ValueError: for numbers that are not positive, a growth below one, or if neither ``first`` nor ``largest`` is given
            and
            the fluid is at rest.

    Note:
        Collective.
    """

    def __init__(self, fluid: "VolumeAveragedNavierStokes", end_time: float, courant: float = 0.5,
                 first: float | None = None, largest: float = np.inf, growth: float = 1.2, progress: bool = True) -> None:
        if isinstance(fluid, type) or not hasattr(fluid, "courant") or not hasattr(fluid, "time"):
            raise ValueError(f"The fluid is {fluid!r}; pass an object of VolumeAveragedNavierStokes.")
        for name, value in (("Courant number (courant)", courant), ("end of the run (end_time)", end_time),
                            ("first step (first)", 1.0 if first is None else first)):
            positive_number(name, value)
        if not isinstance(largest, float) or largest != np.inf:
            positive_number("largest step (largest)", largest)
        if not positive_number("growth of the steps (growth)", growth) >= 1:
            raise ValueError(f"The growth of the steps (growth) is {growth}; it must be at least 1.")
        self.fluid, self.end_time, self.courant, self.first = fluid, end_time, courant, first
        self.largest, self.growth, self.progress = largest, growth, progress
        self._steps: Iterator[tuple[float, float]] | None = None
        self.dt: float | None = None
        self.time: float | None = None

    def __iter__(self) -> "adaptive_steps":
        return self

    def __next__(self) -> tuple[float, float]:
        self._steps = self._steps or self._all()
        return next(self._steps)

    def _all(self):
        time = self.fluid.time if self.time is None else self.time
        with tqdm(total=self.end_time - time, disable=not self.progress or self.fluid.comm.rank > 0, unit="s",
                  file=sys.stderr, mininterval=1.0) as bar:
            while time < self.end_time * (1 - 1e-12):
                self.dt = self._step(self.end_time - time)
                time = self.time = time + self.dt
                yield time, self.dt
                bar.update(self.dt)

    def _step(self, left):
        """The next step, with ``left`` [s] to go."""
        rate = self.fluid.courant(1.0)
        wanted = min(self.courant / rate if rate > 0 else np.inf, self.largest)
        last, grows = self.dt or self.first or np.inf, self.growth if self.dt is not None or self.fluid.step else 1.0
        dt = min(wanted, grows * last)
        if not np.isfinite(dt):
            raise ValueError("The fluid is at rest, so its Courant number gives no step; pass first= or largest= [s].")
        return left if dt > 0.999999 * left else min(dt, 0.5 * left) if dt > 0.5 * left else dt

    def saved(self) -> dict[str, tuple]:
        """The last step, for a checkpoint."""
        return {"same": (None, {name: np.nan if value is None else value
                                for name, value in (("dt", self.dt), ("time", self.time))})}

    def restore(self, state: dict[str, dict]) -> None:
        """Take it back."""
        self.dt, self.time = (None if np.isnan(value) else float(value)
                              for value in (state["same"][name] for name in ("dt", "time")))
        self._steps = None
