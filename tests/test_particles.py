"""Storage, insertion and location of particles."""
import numpy as np
import pytest

import fe_el
from fe_el.particles import location


@pytest.mark.ranks
def test_every_particle_is_in_its_cell_and_owned_once():
    mesh, _ = fe_el.box((1.0, 1.0, 1.0), (4, 4, 4))
    p = fe_el.Particles(mesh, density=1000.0)
    p.insert_in_box((0, 0, 0), (1, 1, 1), 2000, diameter=1e-3, seed=3)
    assert p.total_number == 2000
    for _ in range(10):
        p.velocity[:] = np.random.default_rng(p.step).normal(size=(2000, 3))[p.id]
        p.velocity[(p.position < 0.2)] = 1.0
        p.velocity[(p.position > 0.8)] = -1.0
        p.advance(0.02)
        b = p.cells.barycentric[p.cell]
        inside = np.einsum("pfk,pk->pf", b[:, :, :3], p.position) + b[:, :, 3]
        assert (p.cell < p.cells.owned).all() and inside.min(initial=0) > -1e-11
    ids = np.sort(np.concatenate(p.comm.allgather(p.id)))
    assert np.array_equal(ids, np.arange(2000))


@pytest.mark.ranks
def test_a_particle_that_leaves_stops_the_run():
    mesh, _ = fe_el.box((1.0, 1.0), (4, 4))
    p = fe_el.Particles(mesh, density=1000.0)
    p.insert_at([[0.9, 0.5]], diameter=1e-3, velocity=(10.0, 0.0))
    with pytest.raises(fe_el.LostParticle, match="outside the mesh"):
        p.advance(0.1)


@pytest.mark.ranks
@pytest.mark.parametrize("kwargs, words", [
    ({"position": [[2.0, 0, 0]], "diameter": 1e-3}, "outside the mesh"),
    ({"position": [[0.5, 0.5, 0.5]], "diameter": -1e-3}, "diameter"),
    ({"position": [[0.5, 0.5, 0.5]], "diameter": 1e-3, "density": 0.0}, "density"),
    ({"position": [[np.nan, 0.5, 0.5]], "diameter": 1e-3}, "finite"),
    ({"position": [], "diameter": 1e-3}, "empty")])
def test_bad_insertions_are_refused(kwargs, words):
    mesh, _ = fe_el.box((1.0, 1.0, 1.0), (2, 2, 2))
    with pytest.raises(ValueError, match=words):
        fe_el.Particles(mesh, density=1000.0).insert_at(**kwargs)


def test_free_fall_is_exact():
    mesh, _ = fe_el.box((1.0, 1.0, 1.0), (2, 2, 2))
    p = fe_el.Particles(mesh, density=1000.0, gravity=(0, 0, -10.0))
    p.insert_at([[0.5, 0.5, 0.9]], diameter=1e-3)
    for _ in range(10):
        p.advance(0.03)
    assert p.position[0] == pytest.approx([0.5, 0.5, 0.9 - 5.0 * 0.09], abs=1e-14)


def test_insertion_without_overlap():
    mesh, _ = fe_el.box((1.0, 1.0, 1.0), (2, 2, 2))
    p = fe_el.Particles(mesh, density=1000.0)
    d = np.repeat([0.05, 0.1], [300, 50])
    p.insert_in_box((0.05,) * 3, (0.95,) * 3, 350, diameter=d, seed=1, without_overlap=True)
    gap = np.linalg.norm(p.position[:, None] - p.position, axis=2) - 0.5 * (p.diameter[:, None] + p.diameter)
    assert gap[np.triu_indices(350, 1)].min() >= 0
    with pytest.raises(ValueError, match="fit without overlap"):
        p.insert_in_box((0, 0, 0), (0.2, 0.2, 0.2), 100, diameter=0.1, without_overlap=True)


@pytest.mark.ranks
@pytest.mark.parametrize("periodic", [False, True])
def test_a_second_batch_does_not_overlap_the_first(periodic, by_id):
    """Two sizes in one box, one after the other: no pair overlaps, periodic images included."""
    side = 0.03
    mesh = fe_el.periodic_box((side,) * 3, (4,) * 3)[0] if periodic else fe_el.box((side,) * 3, (4,) * 3)[0]
    beads = fe_el.Particles(mesh, 2500.0)
    for diameter, seed in ((1.5e-3, 1), (2e-3, 2)):
        beads.insert_in_box((1e-3,) * 3, (side - 1e-3,) * 3, 150, diameter, seed=seed, without_overlap=True)
    x, d = by_id(beads, beads.position), by_id(beads, beads.diameter)
    apart = x[:, None] - x
    if periodic:
        apart -= np.round(apart / side) * side
    gap = np.linalg.norm(apart, axis=2) - 0.5 * (d[:, None] + d)
    assert gap[np.triu_indices(len(d), 1)].min() > 0


def test_many_particles_are_put_in_the_order_of_their_cells(monkeypatch):
    """Those of a cell follow each other, and nothing else changes: fields and users' properties move along."""
    mesh, _ = fe_el.periodic_box((1.0, 1.0, 1.0), (8, 8, 8))
    runs = []
    for many in (1000, 10 ** 9):
        monkeypatch.setattr(location, "MANY", many)
        p = fe_el.Particles(mesh, 1000.0, gravity=(0, 0, -9.81))
        p.insert_in_box((0, 0, 0), (1, 1, 1), 4000, 0.01, velocity=(0.3, 0.2, 0.1), seed=2)
        p.properties["mark"] = np.sin(p.id)
        for _ in range(3):
            p.advance(1e-3)
        runs.append(p)
        blocks = 1 + np.count_nonzero(np.diff(p.cell))
        assert blocks < 1.5 * len(np.unique(p.cell)) if many == 1000 else blocks > 3000
    sorted_, plain = runs
    row = np.argsort(sorted_.id)
    assert np.array_equal(sorted_.properties["mark"], np.sin(sorted_.id))
    assert np.array_equal(sorted_.position[row], plain.position) and np.array_equal(sorted_.cell[row], plain.cell)


@pytest.mark.ranks
@pytest.mark.parametrize("dimension", [2, 3])
def test_beads_inserted_without_overlap_lie_inside_the_boundary(dimension):
    mesh, _ = fe_el.box((0.02,) * dimension, (4,) * dimension)
    p, d = fe_el.Particles(mesh, 2500.0), 2e-3
    p.insert_in_box((0,) * dimension, (0.02,) * dimension, 40, d, seed=1, without_overlap=True)
    p.insert_in_box((0,) * dimension, (0.02,) * dimension, 10, d / 2, seed=2, without_overlap=True)
    x, r = p.position[:, :dimension], p.diameter[:, None] / 2
    assert p.total_number == 50 and (x > r * (1 - 1e-8)).all() and (x < 0.02 - r * (1 - 1e-8)).all()
    with pytest.raises(ValueError, match="Only 0 of 1 particles fit"):
        p.insert_in_box((0,) * dimension, (5e-4,) * dimension, 1, d, without_overlap=True)


@pytest.mark.ranks
def test_a_refused_insertion_changes_nothing():
    mesh, _ = fe_el.box((1.0, 1.0, 1.0), (2, 2, 2))
    p = fe_el.Particles(mesh, 1000.0)
    p.insert_at([(0.5, 0.5, 0.5)], 0.1)
    p.properties["heat"] = np.ones(len(p))
    here = {name: len(a) for part in p.arrays() for name, a in part.items()}
    for bad in ({"material": -1}, {"coarse_graining": 0.0}, {"diameter": [0.1, 0.1, 0.1]}, {"velocity": (np.nan, 0, 0)},
                {"density": -1.0}, {"displacement": -1.0}, {"displacement": 5.0}):
        with pytest.raises(ValueError):
            p.insert_at(**{"position": [(0.2, 0.2, 0.2), (0.7, 0.7, 0.7)], "diameter": 0.1, **bad})
        assert {name: len(a) for part in p.arrays() for name, a in part.items()} == here and p.next_id == 1


def test_a_lattice_with_small_displacements_does_not_stand_as_columns():
    """Equal beads one above the other: put exactly so they stand as a column, displaced by a thousandth they fall over."""
    mesh, tags = fe_el.box((0.05, 0.05, 0.05), (2, 2, 2))
    heights = []
    for displacement in (0.0, 2e-6):
        p, d = fe_el.Particles(mesh, 2500.0, (0, 0, -9.81)), 2e-3
        p.insert_at([(0.025, 0.025, (k + 0.5) * d) for k in range(8)], d, displacement=displacement, seed=3)
        p.position[:, 2] += 5e-6
        c = fe_el.Contacts(p, fe_el.LinearSpringDashpot(1000.0, 0.5, 0.3), (tags, (1, 2, 3, 4, 5)))
        for _ in range(60):
            p.advance(1e-2, c)
        heights.append(p.position[:, 2].max())
    assert heights[0] == pytest.approx(7.5 * 2e-3, rel=0.01) and heights[1] < 4e-3
