"""Shared helpers of the tests. mpi4py is imported where it is needed: what starts MPI hands its environment on to the
processes that share the tests between them, and each of those is a run of its own."""
import csv
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest


def pytest_pycollect_makemodule():
    """MPI before the first test file, whichever that is: the wheels of dolfinx find theirs through mpi4py."""
    from mpi4py import MPI  # noqa: F401


def pytest_runtest_logreport(report):
    """Under mpirun a failing rank ends all: the others would wait for it for ever."""
    if "mpi4py.MPI" not in sys.modules:  # the process that hands tests to others
        return
    from mpi4py import MPI
    if report.failed and MPI.COMM_WORLD.size > 1:
        print(f"\nrank {MPI.COMM_WORLD.rank}: {report.nodeid} failed\n{report.longreprtext}", file=sys.__stderr__,
              flush=True)
        MPI.COMM_WORLD.Abort(1)


@pytest.fixture
def folder(tmp_path_factory):
    """A new folder that every rank knows."""
    from mpi4py import MPI
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


@pytest.fixture
def mpirun():
    """Starts python on a number of ranks of their own: ``mpirun(ranks, *arguments)``, a ``CompletedProcess``."""
    from fe_el.parallel.failures import environment_outside_mpirun
    if shutil.which("mpirun") is None:
        pytest.skip("needs mpirun")
    environment = environment_outside_mpirun() | {  # as root, on more ranks than cores, for OpenMPI 4 and 5
        "OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
        "OMPI_MCA_rmaps_base_oversubscribe": "1", "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe"}

    def start(ranks, *arguments):
        return subprocess.run(["mpirun", "-n", str(ranks), sys.executable, *arguments], capture_output=True, text=True,
                              timeout=600, env=environment, stdin=subprocess.DEVNULL)
    return start
