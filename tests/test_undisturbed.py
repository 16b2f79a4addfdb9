"""The fluid velocity without the particle's own part: spheres beside cells of their size fall as their drag law says."""
import numpy as np
import pytest

import fe_el

RHO, RHO_P, H, G = 1000.0, 2500.0, 1e-3, 9.81


def fall(ratio, reynolds, seed, cells=(8, 8, 8), travel=0.0, step=0.5, start=0.0, places=None):
    """Mean speed of spheres of ``ratio`` cells, one or at ``places`` in a unit box, relative to the mixture's and over the
    terminal one, two-way in a periodic box; mean of the last quarter."""
    places = np.random.default_rng(seed).uniform(0.3, 0.7, (1, 3)) if places is None else places
    d, length, down = ratio * H, np.array(cells) * H, np.array([0, 0, -G])
    drag = float(fe_el.drag_laws.schiller_naumann(np.zeros(1), np.array([reynolds]))[0])
    mu = np.sqrt((RHO_P - RHO) * G * d ** 3 * RHO / (18 * reynolds * drag))
    terminal, solid = reynolds * mu / (RHO * d), len(places) * np.pi / 6 * d ** 3 / length.prod()
    balance = -(solid * RHO_P + (1 - solid) * RHO) * down
    dt = min(step * H * H * RHO / mu, (0.02 if not travel else 0.1) * H / terminal)
    mesh, _ = fe_el.periodic_box(length, cells)
    water = fe_el.VolumeAveragedNavierStokes(mesh, None, RHO, mu, down, 1e-9, mean_pressure_gradient=balance)
    beads = fe_el.Particles(mesh, RHO_P, down)
    beads.insert_at(places * length, d, velocity=(0.0, 0.0, -start * terminal))
    forces = [fe_el.Drag("schiller_naumann"), fe_el.PressureGradient(balance), fe_el.UndisturbedVelocity()]
    coupling, speed = fe_el.Coupling(beads, water.velocity, water.pressure, RHO, mu, forces), []
    for _ in range(int(travel * H / terminal / dt) or max(60, int(4 * H * H * RHO / mu / dt))):
        coupling.to_fluid(dt)
        water.advance(dt, coupling.fields)
        coupling.to_particles(dt)
        beads.advance(dt)
        assert coupling.momentum_imbalance < 1e-12
        speed.append((water.momentum()[2] / (RHO * length.prod()) - beads.velocity[:, 2].mean()) / terminal)
    return float(np.mean(speed[-len(speed) // 4:]))


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
