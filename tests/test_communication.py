"""Messages of a step that are counted on several ranks, and the model that is made of them."""
import csv

import numpy as np
import pytest

from demos.benchmarks import communication
from demos.benchmarks.communication import KINDS, STAGES, seconds


def test_every_stage_is_counted(folder):
    """Of two ranks each has one neighbour: a message to an exchange, and what one sends the other sends, too."""
    try:
        communication.compiler()
    except RuntimeError as error:
        pytest.skip(str(error))
    summary = communication.main((2,), 1, folder, progress=False)
    with open(folder + "/communication.csv") as file:
        rows = {(r["stage"], r["kind"]): [float(r[k]) for k in ("calls", "messages", "bytes")] for r in csv.DictReader(file)}
    assert len(rows) == len(STAGES) * len(KINDS)
    for stage in STAGES:
        calls, messages, sent = rows[stage, "halo"]
        assert calls == messages > 0 and sent > 8 * messages
    assert rows["fluid", "reductions"][0] > 20 and rows["contacts and moves", "halo"][0] >= summary["sub_steps"] > 5
    assert all(rows[stage, kind][1] == 0 for stage in STAGES for kind in KINDS[3:])  # no messages of their own
    assert summary["cells_per_rank"] == 6 * 4 ** 3 and summary["particles_per_rank"] > 2000


def test_a_compiler_of_another_mpi_is_refused(folder, monkeypatch):
    monkeypatch.setattr(communication.shutil, "which", {"mpirun": "/one/mpirun", "mpicc": "/other/mpicc"}.get)
    with pytest.raises(RuntimeError, match="mpirun is /one/mpirun, mpicc is /other/mpicc"):
        communication.main((2,), 1, folder, progress=False)
    monkeypatch.setattr(communication.shutil, "which", "/one/".__add__)
    monkeypatch.setattr(communication.MPI, "Get_version", lambda: (4, 1))
    with pytest.raises(RuntimeError, match="version .4, 1.; messages are counted up to version 3"):
        communication.main((2,), 1, folder, progress=False)


def test_the_model_grows_as_it_should():
    """Neighbours' bytes with the surface, reductions with the logarithm of the ranks, the rest with their number."""
    table = np.zeros((len(STAGES), len(KINDS), 3))
    table[0, 0] = 10, 60, 1e9
    table[1, KINDS.index("reductions")] = 100, 0, 800
    runs = []
    for ranks in (4, 8):
        table[2, KINDS.index("gathers")] = 3, 0, 1e6 * ranks
        runs.append({"ranks": ranks, "particles": 1000 * ranks, "rebuilds": 0.5, "table": table.tolist()})
    one, more, wider = seconds(runs, 64, 1000), seconds(runs, 64, 8000), seconds(runs, 4096, 1000)
    assert one["halo"] == pytest.approx(60 * 26 / 6 * 2e-6 + 0.1) and more["halo"] == pytest.approx(one["halo"] + 0.3)
    assert wider["reductions"] == pytest.approx(2 * one["reductions"])
    gathered = 1e6 * (4096 - 64) / 1e10 + 3 * (6 * 2e-6 + 0.5 * (4096 - 64) * 2e-6)
    assert wider["gathers"] - one["gathers"] == pytest.approx(gathered)
    assert one["single"] == one["objects"] == 0.0
