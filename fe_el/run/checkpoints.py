"""Checkpoints of a run on its way: at intervals and when it is told to stop, and what it goes on from."""
import math
import sys
from pathlib import Path
from typing import Any

from fe_el.checks import file_name, finite_number, positive_number
from fe_el.run.checkpoint import comm_of, load_checkpoint, save_checkpoint
from fe_el.run.stopping import StopAndSave


class Checkpoints:
    """Writes a run's state at intervals and when it is told to stop, and goes on from what was written.

        with fe_el.Checkpoints("out/run.h5", beads, contacts, air, output, every=0.1, restart=True) as checkpoints:
            for time in fe_el.time_steps(dt, end_time, checkpoints.time):
                ...
                output.write(time)
                checkpoints.after(time)

    A signal or the end of the wall time ends the run with exit code 75, see :class:`StopAndSave`.

    Args:
        path: file to write; each checkpoint replaces the one before.
        parts: as for :func:`save_checkpoint`; with the :class:`ParaViewOutput` frames come at the times of the unbroken run.
        every (float): simulated time between two checkpoints [s]; absent: the state is written when the run is told to stop.
        restart: ``True``: go on from ``path``, or begin if there is no such file yet; another path: go on from that; absent:
            begin.
        wall_time (float): seconds after which the run stops with its state written; absent: no limit.

    Attributes:
        time (float): simulated time so far [s]; after a restart that of the checkpoint, else zero.

    Raises:
        FileNotFoundError, ValueError: as :func:`load_checkpoint`, and for numbers that are not positive.

    Note:
        Collective.
    """

    def __init__(self, path: str | Path, *parts: Any, every: float | None = None, restart: bool | str | Path | None = None,
                 wall_time: float | None = None) -> None:
        self.path, self.parts, self.comm, self.time = file_name("path of the checkpoints", path), parts, comm_of(parts), 0.0
        self.every = None if every is None else positive_number("time between checkpoints (every)", every)
        origin = self._origin(restart)
        if origin is not None:
            numbers = load_checkpoint(origin, *parts)
            if "time" not in numbers:
                raise ValueError(f"The checkpoint {origin} does not say at which time it was written; give "
                                 "save_checkpoint(..., time=), or use load_checkpoint.")
            self.time = float(numbers["time"])
        self._saved = self.time
        self._stop = StopAndSave(self.save, wall_time, self.comm)

    def _origin(self, restart):
        """The file to go on from, or ``None``."""
        if restart is None or restart is False:
            return None
        if restart is not True:
            return file_name("checkpoint to go on from (restart)", restart)
        there = self.comm.bcast(self.path.is_file() if self.comm.rank == 0 else None)
        if not there and self.comm.rank == 0:
            print(f"There is no checkpoint {self.path} yet: the run begins.", file=sys.stderr)
        return self.path if there else None

    def __enter__(self) -> "Checkpoints":
        self._stop.__enter__()
        return self

    def __exit__(self, kind, error, trace):
        return self._stop.__exit__(kind, error, trace)

    def after(self, time: float) -> None:
        """Write the state if it is time to, and end the run if it was told to stop; at the end of every step. Collective."""
        self.time = finite_number("time", time)
        if self.every is not None and self._number(time) > self._number(self._saved):
            self.save()
        self._stop.check()

    def _number(self, time):
        return math.floor(time / self.every + 1e-6)

    def save(self) -> None:
        """Write the state of the last :meth:`after` now, unless it is written already. Collective."""
        if self.time != self._saved:
            save_checkpoint(self.path, *self.parts, time=self.time)
            self._saved = self.time
