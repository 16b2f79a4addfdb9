"""Compilation in a process of its own, beside the run's."""
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from mpi4py import MPI

import fe_el
from fe_el.particles.contacts import ahead

LOOPS = '''
import os
import sys
import time

from numba import float64

from fe_el.compiled import ahead, compile_time
from fe_el.compiled.cache import njit

ahead.cores = lambda: int(os.environ.get("CORES", 2))


@njit
def one(x):
    return x + 1.0


@njit
def three(x):
    return one(one(one(x)))


def kinds():
    time.sleep(float(os.environ.get("SLOW", 0)))
    return (float64,)


loop = ahead.Ahead("loops", "loop", three, kinds)


def main(cut):
    """Begin, cut the process short, and call."""
    loop.begin()
    started = loop.process is not None
    if cut == "kill":
        loop.process.kill()
    if cut == "leave":
        print(loop.process.pid, loop.folder, flush=True)
        time.sleep(60)
    print(started, loop(1.0), sum(three.stats.cache_hits.values()), loop.process, compile_time.compile_seconds() > 0)
'''


@pytest.fixture
def loops(tmp_path):
    """Starts ``main`` of LOOPS with a cache of its own."""
    (tmp_path / "loops.py").write_text(LOOPS)

    def start(cut, **settings):
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kept"), "PYTHONPATH": str(tmp_path), **settings}
        return subprocess.Popen([sys.executable, "-c", f"import loops; loops.main('{cut}')"], env=environment, text=True,
                                stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                                preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL))  # jobs of a shell ignore it

    def run(cut="", **settings):
        process = start(cut, **settings)
        said, errors = process.communicate(timeout=120)
        assert not process.returncode and not errors, errors
        return said.split()
    run.start = start
    run.left = lambda: [path.name for path in (tmp_path / "kept").rglob("*") if path.name.startswith("ahead-")]
    run.kept = lambda: {path.name.split(".")[1].split("-")[0] for path in (tmp_path / "kept").rglob("*.nb?")}
    return run


def test_a_cold_cache_gets_the_loop_from_the_process_and_a_warm_one_starts_none(loops):
    assert loops() == ["True", "4.0", "1", "None", "True"]
    assert loops.kept() == {"three"}  # what it calls was compiled by the process alone
    assert loops() == ["False", "4.0", "1", "None", "False"]
    assert not loops.left()


def test_a_process_that_dies_costs_only_time(loops):
    assert loops("kill", SLOW="100") == ["True", "4.0", "0", "None", "True"]
    assert not loops.left()
    assert loops() == ["False", "4.0", "1", "None", "False"]


def test_one_core_is_left_to_the_run(loops):
    assert loops(CORES="1") == ["False", "4.0", "0", "None", "True"]


def lives(pid):
    """Whether there is such a process, or more than its exit code."""
    try:
        with open(f"/proc/{pid}/stat") as state:
            return state.read().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.parametrize("end", (signal.SIGKILL, signal.SIGINT))
def test_the_process_ends_with_the_run(loops, end):
    run = loops.start("leave", SLOW="100")
    pid, folder = run.stdout.readline().split()
    assert os.path.isdir(folder)
    time.sleep(1.0)
    run.send_signal(end)
    run.communicate(timeout=60)
    until = time.monotonic() + 30
    while (os.path.isdir(folder) or lives(pid)) and time.monotonic() < until:
        time.sleep(0.1)
    assert not lives(pid) and not loops.left()


def scene():
    """Two beads above a floor."""
    mesh, tags = fe_el.box((0.01, 0.01, 0.01), (2, 2, 2))
    beads = fe_el.Particles(mesh, 2500.0, (0, 0, -9.81))
    beads.insert_at(np.array([[0.003, 0.005, 0.0009], [0.0049, 0.005, 0.0009]]), 2e-3)
    law = fe_el.LinearSpringDashpot(1000.0, 0.9, 0.1)
    return beads, fe_el.Contacts(beads, law, walls=[fe_el.FacetWalls(tags, 5), fe_el.PlaneWall((0, 0, 0), (1, 0, 0))])


def test_types_of_sub_steps_are_those_of_a_scene():
    beads, contacts = scene()
    beads.advance(1e-4, contacts)
    assert str(tuple(ahead.kinds())) in map(str, ahead.sub_steps.dispatcher.signatures)


@pytest.mark.ranks
def test_only_a_run_on_one_rank_starts_a_process(monkeypatch):
    asked = []
    monkeypatch.setattr(ahead.sub_steps, "begin", asked.append)
    scene()
    assert asked == [MPI.COMM_WORLD.size == 1]
