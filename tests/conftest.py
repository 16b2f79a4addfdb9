"""Shared helpers of the tests."""
import csv
import sys
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI


def pytest_runtest_logreport(report):
    """Under mpirun a failing rank ends all: the others would wait for it for ever."""
    if report.failed and MPI.COMM_WORLD.size > 1:
        print(f"\nrank {MPI.COMM_WORLD.rank}: {report.nodeid} failed\n{report.longreprtext}", file=sys.__stderr__,
              flush=True)
        MPI.COMM_WORLD.Abort(1)


@pytest.fixture
def folder(tmp_path_factory):
    """A new folder that every rank knows."""
    comm = MPI.COMM_WORLD
    return comm.bcast(str(tmp_path_factory.mktemp("run")) if comm.rank == 0 else None)


@pytest.fixture
def reference():
    """Rows of a reference table as dictionaries, numbers where they are numbers."""
    def read(name):
        def number(text):
            try:
                return float(text)
            except (TypeError, ValueError):
                return text
        with open(Path(__file__).parent / "reference" / name) as file:
            return [{k: number(v) for k, v in row.items()} for row in csv.DictReader(file)]
    return read


@pytest.fixture
def by_id():
    """A particle array in the order of the ids, complete on every rank."""
    def order(particles, array):
        out = np.zeros((particles.next_id, *array.shape[1:]))
        out[particles.id] = array
        return particles.comm.allreduce(out)
    return order
