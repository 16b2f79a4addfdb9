"""Runs that are told to stop write a checkpoint and leave with exit code 75."""
import signal
import subprocess
import sys

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
        if beads.step == 1 and MPI.COMM_WORLD.rank == 0:
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
        said = run.communicate(timeout=30)[1]
    assert run.returncode == 75 and how in said and "written" in said
    steps, beads = went_on_from(path)
    assert steps >= 1 and len(beads) == 2 and beads.step == steps


def test_a_signal_to_one_rank_stops_all(tmp_path, mpirun):
    (tmp_path / "run.py").write_text(SCRIPT)
    path = str(tmp_path / "a.h5")
    run = mpirun(2, "-W", "ignore", str(tmp_path / "run.py"), path, "100", "own")
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


class Falling:
    """A bead that falls, and how often its state was asked for."""

    def __init__(self):
        mesh, _ = fe_el.box((0.02, 0.02, 0.02), (2, 2, 2))
        self.beads, self.saves = fe_el.Particles(mesh, 2500.0, (0, 0, -1.0)), 0

    def saved(self):
        self.saves += 1
        return {"same": (None, {"saves": self.saves})}

    def restore(self, state):
        self.saves = int(state["same"]["saves"])

    def run(self, path, end, **options):
        """Advance to the end; the times of the steps that were made."""
        times = []
        with fe_el.Checkpoints(path, self.beads, self, **options) as checkpoints:
            if not checkpoints.time:
                self.beads.insert_at([(0.01, 0.01, 0.019)], 1e-3)
            for now in fe_el.time_steps(0.01, end, checkpoints.time, progress=False):
                self.beads.advance(0.01)
                times.append(now)
                checkpoints.after(now)
        return times


def test_checkpoints_at_intervals_and_from_where_a_run_goes_on(tmp_path, capfd):
    """Every third step; a run without a file begins and says so; one that goes on makes the steps that are left."""
    path, first = tmp_path / "a.h5", Falling()
    assert len(first.run(path, 0.1, every=0.03, restart=True)) == 10 and first.saves == 3
    assert "the run begins" in capfd.readouterr().err
    again = Falling()
    assert again.run(path, 0.1, every=0.03, restart=True) == pytest.approx([0.1]) and again.saves == 3
    assert (again.beads.position == first.beads.position).all()
    assert Falling().run(tmp_path / "b.h5", 0.1, restart=path) == pytest.approx([0.1])
    assert not (tmp_path / "b.h5").exists()
    fe_el.save_checkpoint(path, again.beads, again)
    with pytest.raises(ValueError, match="at which time"):
        fe_el.Checkpoints(path, again.beads, again, restart=True)
    with pytest.raises(FileNotFoundError):
        fe_el.Checkpoints(path, again.beads, again, restart=tmp_path / "none.h5")


def test_checkpoints_write_when_the_wall_time_is_over(tmp_path):
    falling = Falling()
    with pytest.raises(SystemExit) as left:
        falling.run(tmp_path / "a.h5", 10.0, wall_time=1e-6)
    assert left.value.code == 75 and falling.saves == 1
    assert Falling().run(tmp_path / "a.h5", 0.03, restart=True) == pytest.approx([0.02, 0.03])
