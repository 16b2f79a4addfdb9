"""Averages of particle fields, profiles and counts through planes."""
import numpy as np
import pytest

import fe_el

RHO = 2500.0


def stream(number=400, velocity=(1.0, 0.5, 0.0)):
    """Grains that fly through a box with one velocity."""
    mesh, tags = fe_el.box((0.1, 0.1, 0.1), (4, 4, 4), slices_along=0)
    grains = fe_el.Particles(mesh, RHO)
    grains.insert_in_box((0.0, 0.0, 0.0), (0.05, 0.05, 0.1), number, 2e-3, seed=1, velocity=velocity)
    grains.remove_at(tags, (1, 2, 3, 4, 5, 6))
    return grains


@pytest.mark.ranks
def test_means_are_those_of_the_particles():
    """Integrals of mean fields are means of volume, mass and momentum; the velocity is that of all; variances by hand."""
    grains = stream()
    grains.velocity[:, 2] = np.where(grains.id % 2, 0.2, -0.2)
    average, dt, sums, fractions = fe_el.ParticleFieldAverage(grains), 2e-3, [], []
    for step in range(6):
        weight = dt if step % 2 else 2 * dt
        average.add(weight)
        out = np.zeros((len(grains.cells.volume), 1))
        average.mapping.deposit(grains.volume[:, None], out)
        fractions.append((grains.halo.reverse_add(out)[:, 0] / grains.cells.volume)[:grains.cells.owned])
        sums.append((weight, grains.comm.allreduce(grains.volume.sum()), grains.momentum()))
        grains.advance(dt)
    weights, volumes, momenta = (np.array(column) for column in zip(*sums))
    cell, comm = grains.cells.volume[:grains.cells.owned], grains.comm
    assert average.duration == pytest.approx(weights.sum())
    assert comm.allreduce(cell @ average.solid_fraction) == pytest.approx(np.average(volumes, weights=weights), rel=1e-12)
    mass = RHO * np.average(volumes, weights=weights)
    assert comm.allreduce(cell @ average.concentration) == pytest.approx(mass, rel=1e-12)
    assert comm.allreduce(cell @ average.flux) == pytest.approx(np.average(momenta, 0, weights), rel=1e-12, abs=1e-12)
    filled = average.solid_fraction > 0
    assert average.velocity[filled][:, :2] == pytest.approx(np.tile([1.0, 0.5], (filled.sum(), 1)), rel=1e-9)
    assert average.velocity_variance[filled][:, 2] == pytest.approx(0.04 - average.velocity[filled][:, 2] ** 2, abs=1e-9)
    mean = np.average(fractions, 0, weights)
    assert average.solid_fraction_variance == pytest.approx(np.average((fractions - mean) ** 2, 0, weights), abs=1e-15)
    assert average.functions()[0].x.array[:len(cell)] == pytest.approx(mean, rel=1e-12)


@pytest.mark.ranks
def test_a_profile_of_heights():
    """Mean and scatter in slabs, by mass; slabs without particles have none."""
    mesh, _ = fe_el.box((1.0, 1.0), (4, 4))
    grains = fe_el.Particles(mesh, RHO)
    grains.insert_at([[0.1, 0.2], [0.15, 0.6], [0.6, 0.5]], [1e-3, 2e-3, 1e-3])
    profile = fe_el.ParticleProfile(grains, [0.0, 0.25, 0.5, 1.0], lambda p: p.position[:, 1])
    profile.add(0.5)
    profile.add(1.5)
    mean = (0.2 + 8 * 0.6) / 9
    assert profile.mean[[0, 2]] == pytest.approx([mean, 0.5]) and np.isnan(profile.mean[1])
    assert profile.deviation[[0, 2]] == pytest.approx([np.sqrt((0.2 ** 2 + 8 * 0.6 ** 2) / 9 - mean ** 2), 0.0], abs=1e-7)
    assert profile.mass == pytest.approx(RHO * np.pi / 6 * 1e-9 * np.array([9.0, 0.0, 1.0])) and profile.duration == 2.0


@pytest.mark.ranks
def test_mass_through_a_plane_is_what_lies_behind_it():
    grains = stream()
    plane = fe_el.PlaneFlux(grains, (0.06, 0, 0), (2.0, 0, 0))
    back = fe_el.PlaneFlux(grains, (0.07, 0, 0), (-1.0, 0, 0))
    for _ in range(40):
        plane.add(1e-3)
        back.add(1e-3)
        grains.advance(1e-3)
    plane.add(1e-3)
    here = grains.comm.allreduce(np.array([grains.mass[grains.position[:, 0] > 0.06].sum(),
                                           (grains.position[:, 0] > 0.06).sum()]))
    assert plane.mass == pytest.approx(here[0] + grains.left_mass, rel=1e-12)
    assert plane.number == here[1] + grains.left > 100 and back.mass < 0
    assert plane.mass_rate == pytest.approx(plane.mass / 41e-3)


@pytest.mark.ranks
def test_observers_go_on_from_a_checkpoint(folder):
    def run(grains, observers, steps):
        for _ in range(steps):
            for observer in observers:
                observer.add(1e-3)
            grains.advance(1e-3)

    def observers_of(grains):
        return [fe_el.ParticleFieldAverage(grains), fe_el.PlaneFlux(grains, (0.06, 0, 0), (1.0, 0, 0)),
                fe_el.ParticleProfile(grains, np.linspace(0, 0.1, 6), lambda p: p.position[:, 1])]
    grains = stream()
    whole = observers_of(grains)
    run(grains, whole, 20)
    fe_el.save_checkpoint(folder + "/state.h5", grains, *whole)
    again = stream(10)
    parts = observers_of(again)
    fe_el.load_checkpoint(folder + "/state.h5", again, *parts)
    run(grains, whole, 10)
    run(again, parts, 10)
    assert parts[0].flux == pytest.approx(whole[0].flux, rel=1e-9, abs=1e-9)
    assert parts[0].solid_fraction_variance == pytest.approx(whole[0].solid_fraction_variance, rel=1e-9, abs=1e-15)
    assert parts[1].mass == pytest.approx(whole[1].mass, rel=1e-12) and parts[1].number == whole[1].number > 0
    assert parts[2].mean == pytest.approx(whole[2].mean, rel=1e-12, nan_ok=True)


def test_bad_input_is_refused():
    grains = stream(2)
    box, _ = fe_el.periodic_box((1.0, 1.0), (3, 3), (True, False))
    for words, make in (("edges", lambda: fe_el.ParticleProfile(grains, [1.0, 0.0], len)),
                        ("normal of a plane is zero", lambda: fe_el.PlaneFlux(grains, (0, 0, 0), (0, 0, 0))),
                        ("periodic direction", lambda: fe_el.PlaneFlux(fe_el.Particles(box, RHO), (0, 0, 0), (1, 0, 0))),
                        ("weight of an average", lambda: fe_el.ParticleFieldAverage(grains).add(0.0))):
        with pytest.raises(ValueError, match=words):
            make()
