"""The benchmarks of walls of facets, small."""
import csv

import numpy as np
import pytest

from demos.benchmarks import curved_walls, wall_contacts


@pytest.fixture
def folder(tmp_path):
    return str(tmp_path / "out")


def test_impacts_on_pipes_and_cones(folder):
    """Restitution within 0.01, stiffness within 2 %; no gain beyond that of a step which splits the first touch."""
    numbers = curved_walls.main((64,), (2.0,), (0.0, 60.0), (0.5, 1.0), points=3, output=folder, progress=False)
    assert numbers["impacts"] == 2 * 2 * 3 * 3 == 3 * len(list(csv.reader(open(folder + "/curved_walls.csv")))[1:])
    assert all(numbers[f"{name} error_of_mean"] < 0.01 for name in curved_walls.OBLIQUE)
    assert numbers["stiffness_error"] < 0.02 and numbers["gain"] < (np.pi / 50) ** 2 / 8


def test_reference_is_the_law_where_the_impact_is_straight():
    """And a grazing one around a narrow pipe is not: the normal turns."""
    straight, along, around = curved_walls.smooth(1.3, 40.0, 0.3, 0.5, 500)
    assert straight == pytest.approx(0.3, abs=1e-4) and along == pytest.approx(0.3, abs=1e-4) and abs(around - 0.3) > 1e-3


def test_restitution_along_the_impulse_is_the_energy_lost():
    v, n = np.random.default_rng(1).normal(size=(2, 5, 3))
    after = v - 1.7 * (v * n).sum(1)[:, None] * n / (n * n).sum(1)[:, None]
    assert curved_walls.along_the_impulse(v, after) == pytest.approx(0.7)


def test_wall_contacts(folder):
    """Every scene touches what it is made to touch."""
    numbers = wall_contacts.main(beads=100, steps=20, repeats=1, output=folder)
    assert numbers["contacts_per_bead_free"] == 0 and numbers["contacts_per_bead_floor"] == 1
    assert numbers["contacts_per_bead_pipe"] > 0.8 and numbers["contacts_per_bead_surface"] > 0.8
    assert all(numbers[f"nanoseconds_per_bead_{name}"] > 0 for name in wall_contacts.SCENES)
