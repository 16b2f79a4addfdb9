"""The table of one rank and several: what it is made of, and a small run."""
import csv

import numpy as np
import pytest

from demos.benchmarks import communication, strong_scaling
from demos.benchmarks.strong_scaling import HEAD, STAGES, table


def test_losses_are_told_apart():
    """Two ranks that share 12 ms of work, a tenth of it done twice, two to one in the first stage."""
    one, many = np.zeros((1, len(STAGES), 3)), np.zeros((2, len(STAGES), 3))
    one[0, 1], one[0, 3] = (6e-3, 6e-3, 0.0), (6e-3, 6e-3, 0.0)
    many[:, 1] = (4.4e-3, 4.4e-3, 0.0), (4.4e-3, 4.4e-3, 2.2e-3)
    many[:, 3] = (3.3e-3, 3.3e-3, 0.0)
    slow = {"seconds": (1.5 * many).tolist()}
    rows = table([{"seconds": one.tolist()}], [{"seconds": many.tolist()}, slow], [{"seconds": (1.2 * one).tolist() * 2}])
    assert [row[0] for row in rows] == ["fluid", "contacts", "step"]
    fluid, contacts, step = (dict(zip(HEAD, row)) for row in rows)
    assert fluid["speed_up"] == pytest.approx(6 / 4.4) and fluid["imbalance"] == pytest.approx(4 / 3)
    assert fluid["work_over_that_of_one"] == pytest.approx(1.1) and fluid["inside_mpi_ms"] == pytest.approx(1.1)
    assert contacts["imbalance"] == pytest.approx(1.0) and contacts["speed_up_of_work"] == pytest.approx(2 / 1.1)
    assert step["wall_ms"] == pytest.approx(7.7) and step["work_over_that_of_one"] == pytest.approx(1.1)
    assert step["imbalance"] == pytest.approx(7.7 / 6.6)  # the slowest of each stage: they wait for each other
    assert step["speed_up_of_machine"] == pytest.approx(2 / 1.2)


def test_strong_scaling(folder):
    try:
        communication.compiler()
    except RuntimeError as error:
        pytest.skip(str(error))
    summary = strong_scaling.main(["silo"], 2, 1, 1, 0.05, 1e-3, True, folder, progress=False)
    assert sum(summary["silo_particles"]) <= 300 and summary["silo_rebuilds"] >= 0
    with open(folder + "/strong_scaling.csv") as file:
        rows = list(csv.DictReader(file))
    assert [row["stage"] for row in rows] == ["contacts", "neighbours", "step"]
    assert all(float(row["work_over_that_of_one"]) > 0 for row in rows)
