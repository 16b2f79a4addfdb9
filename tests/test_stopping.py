"""Runs that are told to stop write a checkpoint and leave with exit code 75."""
import os
import signal
import subprocess
import sys
import time

import pytest

import fe_el

SCRIPT = """
import os, signal, sys, time, fe_el
from mpi4py import MPI
mesh, tags = fe_el.box((0.02, 0.02, 0.02), (2, 2, 2))
beads = fe_el.Particles(mesh, 2500.0, (0, 0, -1.0))
beads.insert_at([(0.005, 0.01, 0.019), (0.015, 0.01, 0.019)], 1e-3)
path, wall_time, own = sys.argv[1], float(sys.argv[2]), sys.argv[3]
with fe_el.StopAndSave(lambda: fe_el.save_checkpoint(path, beads, steps=beads.step), wall_time) as stop:
    for now in fe_el.time_steps(1e-6, 1.0, progress=False):
        beads.advance(1e-6)
        time.sleep(1e-3)
        if beads.step == 20 and MPI.COMM_WORLD.rank == 0:
            print("runs", flush=True)
        if own == "own" and beads.step == 20 and MPI.COMM_WORLD.rank == MPI.COMM_WORLD.size - 1:
            os.kill(os.getpid(), signal.SIGUSR1)
        stop.check()
"""


def went_on_from(path):
    mesh, _ = fe_el.box((0.02, 0.02, 0.02), (2, 2, 2))
    beads = fe_el.Particles(mesh, 2500.0)
    return fe_el.load_checkpoint(path, beads)["steps"], beads


@pytest.mark.parametrize("how", ["SIGTERM", "SIGUSR1", "wall time"])
def test_a_run_that_is_told_to_stop_leaves_its_state(tmp_path, how):
    path = str(tmp_path / "a.h5")
    command = [sys.executable, "-W", "ignore", "-c", SCRIPT, path, "0.5" if how == "wall time" else "100", "-"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as run:
        assert run.stdout.readline() == "runs\n"
        if how != "wall time":
            run.send_signal(getattr(signal, how))
        said, begin = run.communicate(timeout=30)[1], time.monotonic()
    assert run.returncode == 75 and how in said and "written" in said and time.monotonic() - begin < 10
    steps, beads = went_on_from(path)
    assert steps >= 20 and len(beads) == 2 and beads.step == steps


def test_a_signal_to_one_rank_stops_all(tmp_path):
    (tmp_path / "run.py").write_text(SCRIPT)
    path = str(tmp_path / "a.h5")
    run = subprocess.run(["mpirun", "-n", "2", "--oversubscribe", sys.executable, "-W", "ignore", str(tmp_path / "run.py"),
                          path, "100", "own"], capture_output=True, text=True, timeout=120,
                         env={**os.environ, "OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"})
    assert run.returncode == 75 and run.stderr.count("The run stops (signal SIGUSR1)") == 1
    assert went_on_from(path)[0] == 20


def test_a_run_goes_on_while_nobody_tells_it_to_stop():
    handler = signal.getsignal(signal.SIGTERM)
    with fe_el.StopAndSave(lambda: pytest.fail("nothing to save")) as stop:
        stop.check()
    assert signal.getsignal(signal.SIGTERM) is handler
    with pytest.raises(ValueError, match="wall_time"):
        fe_el.StopAndSave(print, -1.0)
    with pytest.raises(ValueError, match="function"):
        fe_el.StopAndSave("run.h5")
