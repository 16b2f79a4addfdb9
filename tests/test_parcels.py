"""Parcels: any number of particles in each, kept wherever they go; contacts as long as those of the particles in them."""
import numpy as np
import pytest
from mpi4py import MPI

import fe_el

RHO, D = 2500.0, 2e-3
LAWS = (fe_el.LinearSpringDashpot(1000.0, 0.8, 0.0), fe_el.HertzMindlin(1e8, 0.3, 0.8, 0.0))


def test_numbers_and_diameters():
    """Number, mass and primary diameter of parcels that differ; a ratio gives its cube; one is a particle."""
    mesh, _ = fe_el.box((1.0, 1.0, 1.0), (2, 2, 2))
    p, n = fe_el.Particles(mesh, RHO), np.array([1.0, 27.0, 8000.0, 13.7, 0.5])
    p.insert_at(np.full((5, 3), 0.5), np.cbrt(n) * D, number=n)
    assert np.array_equal(p.number, n) and p.primary_diameter == pytest.approx(D, rel=1e-15)
    assert p.primary_diameter[0] == D and p.coarse_graining == pytest.approx(np.cbrt(n), rel=1e-15)
    assert p.mass == pytest.approx(n * RHO * np.pi / 6 * D ** 3, rel=1e-15)
    p.insert_at([(0.5, 0.5, 0.5)], 3 * D, coarse_graining=3.0)
    assert p.number[-1] == 27.0 and p.primary_diameter[-1] == D
    with pytest.raises(ValueError, match="number of particles in a parcel is 0; it must be finite and greater than zero"):
        p.insert_at([(0.5, 0.5, 0.5)], D, number=0.0)
    p.number[0] = -1.0
    with pytest.raises(ValueError, match="number of particle 0 is -1.0"):
        p.advance(1e-3)


@pytest.mark.ranks
def test_numbers_travel_with_the_parcels(folder, by_id):
    """Across ranks and through a checkpoint."""
    mesh, _ = fe_el.box((1.0, 1.0, 1.0), (4, 4, 4))
    p, n = fe_el.Particles(mesh, RHO), np.random.default_rng(1).uniform(0.5, 100, 50)
    p.insert_in_box((0, 0, 0), (0.3, 1, 1), 50, D, velocity=(0.7, 0, 0), number=n)
    p.advance(1.0)
    assert np.array_equal(by_id(p, p.number), n)
    fe_el.save_checkpoint(folder + "/state.h5", p)
    again = fe_el.Particles(mesh, RHO)
    fe_el.load_checkpoint(folder + "/state.h5", again)
    assert np.array_equal(by_id(again, again.number), n)


def settled(number, law):
    """Positions of beads in gas on a floor after some steps, inserted with or without naming their number."""
    mesh, tags = fe_el.box((0.02, 0.02, 0.03), (3, 3, 4))
    down = (0, 0, -9.81)
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, 1.2, 1.8e-5, down)
    air.set_velocity(5, (0, 0, 0.5))
    air.set_pressure(6)
    beads = fe_el.Particles(mesh, RHO, down)
    beads.insert_on_lattice((0, 0, 0), (0.02, 0.02, 0.02), np.full(300, D), **number)
    contacts = fe_el.Contacts(beads, law, (tags, (1, 2, 3, 4, 5)), steps_per_contact=12)
    coupling = fe_el.Coupling.of(air, beads, [fe_el.Drag("beetstra"), fe_el.PressureGradient(), fe_el.MagnusLift()])
    for _ in range(20):
        coupling.to_fluid(1e-3)
        air.advance(1e-3, coupling.fields)
        coupling.to_particles(1e-3)
        beads.advance(1e-3, contacts)
    return beads.position[np.argsort(beads.id)]


@pytest.mark.parametrize("law", LAWS)
def test_parcels_of_one_are_particles_to_the_last_digit(law):
    plain = settled({}, law)
    assert np.array_equal(settled({"number": np.ones(300)}, law), plain)
    assert np.array_equal(settled({"coarse_graining": 1.0}, law), plain)


def collision(law, diameters, numbers, wall=False, h=1 / 400):
    """Duration over contact time of two single particles, and restitution, of two parcels, or of one and a wall."""
    mesh, tags = fe_el.box((0.1, 0.1, 0.1), (2, 2, 2))
    p, v = fe_el.Particles(mesh, RHO), 0.4
    size = np.array(diameters) * np.cbrt(numbers)
    gap = 1e-9
    x = [0.5 * size[0] + gap, 0.05, 0.05] if wall else [0.05, 0.05, 0.05]
    p.insert_at([x], size[0], velocity=(-v, 0, 0) if wall else (v / 2, 0, 0), number=numbers[0])
    if not wall:
        p.insert_at([(0.05 + size.sum() / 2 + gap, 0.05, 0.05)], size[1], velocity=(-v / 2, 0, 0), number=numbers[1])
    contacts = fe_el.Contacts(p, law, (tags, 1) if wall else None, steps_per_contact=50)
    mass, radius = RHO * np.pi / 6 * np.array(diameters) ** 3, np.array(diameters) / 2
    pair = (mass[0], radius[0]) if wall else (mass.prod() / mass.sum(), radius.prod() / radius.sum())
    whole, touched = law.contact_time(*pair, v), 0
    for _ in range(int(1.5 / h)):
        p.advance(h * whole, contacts)
        touched += contacts.touching > 0
    order = np.argsort(p.id)
    apart = p.velocity[order, 0] @ (np.array([1.0]) if wall else np.array([-1.0, 1.0]))
    return touched * h, apart / v


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("wall", [False, True])
def test_contacts_of_parcels_last_as_those_of_their_particles(law, wall):
    """Pairs of equal and unequal parcels, and parcels on a wall: duration and restitution are those of single particles."""
    for diameters, numbers in (((D, D), (27.0, 27.0)), ((D, 2 * D), (300.0, 7.5)), ((D, D), (1.0, 64.0))):
        single, parcels = collision(law, diameters, (1.0, 1.0), wall), collision(law, diameters, numbers, wall)
        assert parcels == pytest.approx(single, rel=0.006)
        assert single[1] == pytest.approx(0.8, abs=0.01)


def test_sub_steps_do_not_depend_on_the_parcels():
    mesh, _ = fe_el.box((0.1, 0.1, 0.1), (2, 2, 2))
    limits = []
    for n in (1.0, 1000.0):
        p = fe_el.Particles(mesh, RHO)
        p.insert_at([(0.05, 0.05, 0.05)], D * np.cbrt(n), number=n)
        limits.append(fe_el.Contacts(p, LAWS[0]).step_limit())
    assert limits[1] == pytest.approx(limits[0], rel=1e-12)


@pytest.mark.ranks
def test_parcels_of_unequal_numbers_collide_alike_on_all_ranks(by_id):
    found = []
    for comm in (MPI.COMM_SELF, MPI.COMM_WORLD):
        mesh, tags = fe_el.box((0.05, 0.05, 0.05), (4, 4, 4), comm=comm)
        p = fe_el.Particles(mesh, RHO, (0, 0, -9.81))
        n = np.random.default_rng(2).uniform(1, 9, 60)
        p.insert_on_lattice((0, 0, 0), (0.05,) * 3, np.full(60, 3e-3), number=n, velocity=(0.1, 0.2, -0.3))
        contacts = fe_el.Contacts(p, LAWS[0], (tags, (1, 2, 3, 4, 5, 6)), steps_per_contact=20)
        for _ in range(30):
            p.advance(1e-3, contacts)
        found.append(by_id(p, p.position))
    assert np.abs(found[0] - found[1]).max() < 1e-9


def test_drag_of_a_parcel_is_that_of_its_particles():
    """A parcel of a thousand settles in still gas as one of its particles does, whatever the numbers."""
    mesh, tags = fe_el.box((0.1, 0.1, 0.1), (1, 1, 1))
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, 1.2, 1.8e-5)
    dust, d = fe_el.Particles(mesh, RHO, (0, 0, -9.81)), 50e-6
    n = np.array([1.0, 1000.0, 37.3])
    dust.insert_at([(0.03, 0.05, 0.05), (0.05, 0.05, 0.05), (0.07, 0.05, 0.05)], d * np.cbrt(n), number=n)
    coupling = fe_el.Coupling(dust, air.velocity, air.pressure, 1.2, 1.8e-5, [fe_el.Drag("stokes")])
    for _ in range(20):
        coupling.to_fluid(1e-3)
        coupling.to_particles(1e-3)
        dust.advance(1e-3)
    tau = RHO * d ** 2 / (18 * 1.8e-5)
    assert dust.velocity[:, 2] == pytest.approx(9.81 * tau * np.expm1(-0.02 / tau), rel=1e-5)
