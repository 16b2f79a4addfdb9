"""Runs that are told to stop: a signal or a limit of the wall clock ends them after the step, with their state written."""
import signal
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from mpi4py import MPI

from fe_el.checks import positive_number

STOPPED = 75  #: exit code of a run that was told to stop and can go on from its checkpoint (EX_TEMPFAIL of sysexits.h)


class StopAndSave:
    """Ends a run in good order when a signal comes to any rank, or when its wall time is over.

        with fe_el.StopAndSave(lambda: fe_el.save_checkpoint("run.h5", beads, contacts, air), wall_time=7100.0) as stop:
            for time in fe_el.time_steps(dt, end_time):
                ...
                stop.check()

    The signals are SIGTERM, and SIGUSR1, which mpirun and batch systems pass on some time before they kill (mpirun kills
    its ranks a second after SIGTERM). Then :meth:`check` calls ``save`` on all ranks, rank 0 says so, and all leave with the
    exit code 75 (``SystemExit``), which no error has.

    Args:
        save: function without arguments, called once on all ranks.
        wall_time (float): seconds after which the run stops; leave room for a step and for writing; absent: no limit.
        comm: communicator of the run.

    Raises:
        ValueError: for something that cannot be called, or a wall time that is not positive.

    Note:
        Collective. Signals reach the main thread of Python only.
    """

    def __init__(self, save: Callable[[], Any], wall_time: float | None = None, comm: MPI.Comm = MPI.COMM_WORLD) -> None:
        if not callable(save):
            raise ValueError(f"save is {save!r}; pass a function without arguments that writes the state.")
        self.save, self.comm, self.start = save, comm, time.monotonic()
        self.wall_time = np.inf if wall_time is None else positive_number("wall_time", wall_time)
        self.reason = 0
        self._before: dict[int, Any] = {}  # handlers of the signals

    def __enter__(self) -> "StopAndSave":
        for number in (signal.SIGTERM, signal.SIGUSR1):
            self._before[number] = signal.signal(number, self._told)
        return self

    def __exit__(self, kind, error, trace):
        for number, handler in self._before.items():
            signal.signal(number, handler)
        return False

    def _told(self, number, frame):
        self.reason = int(number)

    def check(self) -> None:
        """End the run if it was told to stop; once per step, at its end, where the state is whole. Collective."""
        mine = self.reason or (-1 if time.monotonic() - self.start > self.wall_time else 0)
        reasons = [r for r in self.comm.allgather(mine) if r]
        if not reasons:
            return
        self.save()
        if self.comm.rank == 0:
            why = f"signal {signal.Signals(max(reasons)).name}" if max(reasons) > 0 else f"wall time {self.wall_time:g} s"
            print(f"The run stops ({why}); its state is written. Exit code {STOPPED}: go on from the checkpoint.",
                  file=sys.stderr, flush=True)
        raise SystemExit(STOPPED)
