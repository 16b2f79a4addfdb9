"""The fluid velocity without the particle's own part: spheres beside cells of their size fall as their drag law says."""
import numpy as np
import pytest

import fe_el
from demos.benchmarks import undisturbed_velocity
from demos.benchmarks.undisturbed_velocity import RHO_P, fall, images


@pytest.mark.parametrize("ratio", [0.1, 0.5, 1.0])
def test_sphere_in_creeping_flow(ratio):
    """At every place; 1 less what the images in a periodic box of 8 cells do, 2.837 d / (2 L) (Hasimoto 1959)."""
    found = [fall(ratio, 0.08, seed) for seed in range(6)]
    assert found == pytest.approx([1 - 2.837 * ratio / 16] * 6, rel=0.05)


def test_sphere_of_three_cells():
    """In a box of six diameters; the series of Hasimoto's images to the third power."""
    exact = 1 - 2.837 * 3 / 36 + 4.189 * (3 / 36) ** 3
    assert fall(3.0, 0.08, 0, (18, 18, 18), step=2.0) == pytest.approx(exact, rel=0.1)


@pytest.mark.parametrize("ratio", [0.1, 0.5, 1.0])
def test_sphere_at_reynolds_number_146(ratio):
    """Over nine cells, before it meets its own wake."""
    assert fall(ratio, 146.0, 1, (8, 8, 12), 9.0, start=1.0) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("ratio", [0.1, 0.5, 1.0])
@pytest.mark.parametrize("reynolds", [20.0, 1000.0])
def test_sphere_between_creeping_and_fast(ratio, reynolds):
    """Where neither viscosity nor the flow past it alone carries away what the sphere has done; mean of two places."""
    found = np.mean([fall(ratio, reynolds, seed, (12, 12, 12), 9.0, start=1.0) for seed in (1, 2)])
    assert found == pytest.approx(1.0, abs=0.05)


def stokeslet(place, cells, width):
    """Vertical velocity at ``place`` in a periodic cube of ``cells``, of a force of one along it, times the viscosity: the
    sum over waves (Hasimoto 1959), of a force spread over ``width``."""
    number = np.arange(-40, 41)
    k = np.stack(np.meshgrid(number, number, number, indexing="ij"), -1).reshape(-1, 3) * 2 * np.pi / cells
    k = k[(k != 0).any(1)]
    square = (k ** 2).sum(1)
    return (np.cos(k @ place) * (1 - k[:, 2] ** 2 / square) / square * np.exp(-square * width ** 2 / 2)).sum() / cells ** 3


@pytest.mark.parametrize("ratio, cells", [(0.5, 8), (1.0, 12)])
@pytest.mark.parametrize("apart", [(0.0, 0.0, 3.0), (3.0, 0.0, 0.0)])
def test_two_spheres_carry_each_other(ratio, cells, apart):
    """In line and side by side at three diameters: their speed over that of one is what point forces give."""
    apart, alone, both = ratio * np.array(apart), [], []
    for seed in range(3):
        place = np.random.default_rng(seed).uniform(0.3, 0.6, 3)
        alone.append(fall(ratio, 0.08, 0, (cells,) * 3, places=place[None]))
        both.append(fall(ratio, 0.08, 0, (cells,) * 3, places=np.array([place, place + apart / cells])))
    one = 1 - 2.837 * ratio / (2 * cells)
    exact = 1 + 3 * np.pi * ratio * stokeslet(apart, cells, 0.3 * ratio) / one
    assert np.mean(both) / np.mean(alone) == pytest.approx(exact, rel=0.04)


@pytest.mark.parametrize("reynolds", [20.0, 146.0])
def test_a_dilute_suspension_settles_as_its_law_says(reynolds):
    """A thousandth of spheres half as large as a cell, over nine cells."""
    places = np.random.default_rng(2).uniform(0, 1, (12, 3))
    assert fall(0.5, reynolds, 0, (8, 8, 12), 9.0, start=1.0, places=places) == pytest.approx(1.0, abs=0.03)


def test_images_of_a_force_that_creeps_and_of_one_that_outruns_them():
    """At rest long since those of Hasimoto, 2.837/(6 pi mu L); over a short way none."""
    assert images(8.0, 1e3, 1e3) * 1e3 == pytest.approx(-2.837 / (6 * np.pi * 8.0), rel=0.02)
    assert abs(images(24.0, 1.0, 2.0)) < 0.02 * 2.837 / (6 * np.pi * 24.0)


def test_many_places(tmp_path):
    """Two places of two spheres: the errors are those of the single falls, and the summary's the worst and the mean."""
    numbers = undisturbed_velocity.main((20.0,), (0.1, 0.5), 2, str(tmp_path), progress=False)
    rows = np.loadtxt(tmp_path / "undisturbed_velocity.csv", delimiter=",", skiprows=1)
    exact = undisturbed_velocity.expected(0.5, 20.0, 12)
    found = [fall(0.5, 20.0, seed, (12, 12, 12), 9.0, start=1.0) - exact for seed in range(2)]
    assert rows[2:, 3] == pytest.approx(found, abs=1e-9) and exact == pytest.approx(1.0, abs=2e-3)
    assert numbers["mean_re_20_ratio_0_5"] == pytest.approx(np.mean(found)) and np.abs(rows[:, 3]).max() < 0.05


@pytest.mark.parametrize("step", [0.05, 5.0])
def test_any_step(step):
    """Steps of a few and of four hundred times what viscosity needs in a cell: stable, and about the same."""
    assert fall(0.5, 0.02, 0, step=step) == pytest.approx(1 - 2.837 * 0.5 / 16, rel=0.15)


def bed(forces, solid=0.4):
    """Held beads, many to a cell, in a gas that moves."""
    mesh, _ = fe_el.periodic_box((4e-3,) * 3, (3, 3, 3))
    d = 3e-4
    count = int(solid * 64e-9 / (np.pi / 6 * d ** 3))
    air = fe_el.VolumeAveragedNavierStokes(mesh, None, 1.2, 1.8e-5)
    air.set_initial_velocity((0.0, 0.0, 1.0))
    beads = fe_el.Particles(mesh, RHO_P)
    beads.insert_in_box((0, 0, 0), (4e-3,) * 3, count, d, seed=1)
    beads.hold()
    coupling = fe_el.Coupling(beads, air.velocity, air.pressure, 1.2, 1.8e-5, [fe_el.Drag("beetstra"), *forces])
    for _ in range(3):
        coupling.to_fluid(1e-5)
        air.advance(1e-5, coupling.fields)
        coupling.to_particles(1e-5)
    return beads.comm.allreduce(beads.force[:, 2].sum())


@pytest.mark.ranks
def test_it_fades_in_a_bed():
    """With some twenty-five beads to a cell drag differs by less than half a percent."""
    assert bed([fe_el.UndisturbedVelocity()]) == pytest.approx(bed([]), rel=5e-3)


@pytest.mark.ranks
def test_momentum_of_scattered_beads():
    """Most alone in their cells; laws that know the solid fraction."""
    from tests.test_forces import step, suspension
    air, beads, coupling = suspension([fe_el.Drag("beetstra"), fe_el.PressureGradient(), fe_el.UndisturbedVelocity()])
    for _ in range(4):
        step(air, beads, coupling, 1e-3)
        assert coupling.momentum_imbalance < 1e-12
    assert beads.comm.allreduce(float(np.abs(beads.properties["_own_velocity"]).max(initial=0.0))) > 0


def test_what_is_not_known_is_refused():
    mesh, _ = fe_el.periodic_box((1.0, 1.0), (3, 3))
    plane, beads = fe_el.VolumeAveragedNavierStokes(mesh), fe_el.Particles(mesh, 1000.0)
    forces = [fe_el.Drag("stokes"), fe_el.UndisturbedVelocity()]
    with pytest.raises(ValueError, match="three dimensions"):
        fe_el.Coupling(beads, plane.velocity, plane.pressure, 1.0, 1e-3, forces)
    mesh, _ = fe_el.periodic_box((1.0, 1.0, 1.0), (3, 3, 3))
    air, beads = fe_el.VolumeAveragedNavierStokes(mesh), fe_el.Particles(mesh, 1000.0)
    for words, kwargs in (("shares", {"mapping": "hat"}), ("PatchAverage", {"smoothing": fe_el.PatchAverage(mesh)})):
        with pytest.raises(ValueError, match=words):
            fe_el.Coupling(beads, air.velocity, air.pressure, 1.0, 1e-3, forces, **kwargs)
