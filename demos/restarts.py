"""What the demos share to write their state and to go on from it: options of the command line, and what checkpoints keep."""
from pathlib import Path

import numpy as np
from mpi4py import MPI

import fe_el


def add_arguments(parser):
    """Options of a demo that keeps its state."""
    parser.add_argument("--checkpoint-every", type=float,
                        help="simulated time between checkpoints, OUTPUT/checkpoint.h5 [s]; absent: when the run is stopped")
    parser.add_argument("--restart", nargs="?", const=True,
                        help="go on from this checkpoint; without a name from OUTPUT/checkpoint.h5, if it is there")
    parser.add_argument("--wall-time", type=float,
                        help="seconds after which the run stops with its state written and exit code 75; absent: no limit")


class Restarts:
    """When a demo writes its state, and what it goes on from.

    Args:
        folder: of its results.
        dt (float): time step [s].
        every, restart, wall_time: of the command line.

    Raises:
        ValueError: for less than a time step between checkpoints.
    """

    def __init__(self, folder, dt, every=None, restart=None, wall_time=None):
        if every is not None and not every >= dt:
            raise ValueError(f"--checkpoint-every is {every}; give at least a time step of {dt:g} s.")
        self.path, self.dt, self.every = Path(folder) / "checkpoint.h5", dt, every
        self.restart, self.wall_time = restart, wall_time

    def going_on(self):
        """Whether there is something to go on from, so that the scene needs no start. Collective."""
        if self.restart is True:
            return MPI.COMM_WORLD.bcast(self.path.is_file())
        return bool(self.restart)

    def origin(self):
        """The file that the run goes on from, if it does."""
        return self.path if self.restart is True else Path(self.restart)

    def checkpoints(self, *parts):
        """The checkpoints of a run with these parts; ``None`` stands for physics that the scene leaves out."""
        return fe_el.Checkpoints(self.path, *(p for p in parts if p is not None), every=self.every, restart=self.restart,
                                 wall_time=self.wall_time)

    def steps(self, begin, end_time, progress):
        """Times of the steps that are left from ``begin`` on, none after the end."""
        if begin > end_time - 0.5 * self.dt:
            return iter(())
        return fe_el.time_steps(self.dt, end_time, begin, progress=progress)


class Rows(list):
    """Rows of numbers against time, which checkpoints keep."""

    def saved(self):
        """All rows."""
        return {"same": (None, {"rows": np.array(self, float)})}

    def restore(self, state):
        """Take them back."""
        self[:] = [tuple(row) for row in state["same"]["rows"]]


class Kept(dict):
    """Numbers and arrays by name, which checkpoints keep as the first rank has them."""

    def saved(self):
        """All of them."""
        return {"same": (None, {"number": len(self), **self})}

    def restore(self, state):
        """Take them back."""
        self.clear()
        self.update({name: value for name, value in state["same"].items() if name != "number"})
