"""MP-PIC: momentum, energy, close packing and walls."""
import numpy as np
import pytest
from mpi4py import MPI

import fe_el

RHO, GRAVITY = 2500.0, 9.81


def column(dimension, cells, number=1500, fraction=0.25, comm=MPI.COMM_WORLD, **options):
    """Parcels of grains of 1 mm spread over a column of 5 x (5 x) 20 cm."""
    d, down = dimension, np.zeros(3)
    down[d - 1] = -GRAVITY
    lengths = (0.05,) * (d - 1) + (0.2,)
    mesh, tags = fe_el.box(lengths, (cells,) * (d - 1) + (4 * cells,), comm=comm)
    grains = fe_el.Particles(mesh, RHO, down, thickness=0.05)
    diameter = (fraction * 0.05 ** 2 * 0.2 / number * 6 / np.pi) ** (1 / 3)
    grains.insert_in_box((0,) * d, tuple(0.999 * x for x in lengths), number, diameter, seed=1,
                         coarse_graining=diameter / 1e-3)
    packing = fe_el.MultiphasePIC(grains, walls=(tags, tuple(range(1, 2 * d))), **{"wall_restitution": 0.5, **options})
    return grains, packing


def energy(grains):
    """Kinetic and potential energy [J]."""
    height = -(grains.position @ grains.gravity)
    return grains.kinetic_energy() + grains.comm.allreduce(float(grains.mass @ height))


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_column_settles_to_close_packing(dimension):
    """It keeps to 0.63 within 0.03 while it falls and at rest; walls carry its weight, and its momentum goes to them."""
    grains, packing = column(dimension, 3 if dimension == 3 else 4)
    start, weight = energy(grains), grains.comm.allreduce(grains.mass.sum()) * GRAVITY
    total, fullest, force = np.zeros(3), 0.0, []
    for step in range(400):
        before = grains.momentum()
        grains.advance(1e-3, packing)
        walls = packing.walls[0].force
        total = grains.momentum() - before - 1e-3 * (grains.comm.allreduce(grains.mass.sum()) * grains.gravity - walls)
        assert np.abs(total).max() < 1e-12 * weight and packing.momentum_imbalance < 1e-12
        assert energy(grains) < start
        fullest = max(fullest, packing.max_solid_fraction if step else 0.0)
        force.append(walls[dimension - 1])
    assert fullest < 0.66
    speed = np.sqrt(2 * grains.kinetic_energy() / (weight / GRAVITY))
    assert speed < 0.015 and np.mean(force[-100:]) == pytest.approx(-weight, rel=0.02)
    mean = grains.comm.allreduce(float(grains.mass @ grains.position[:, dimension - 1])) / (weight / GRAVITY)
    assert 0.25 * 0.2 / (2 * mean) == pytest.approx(0.62, abs=0.012)  # the stress is that of 0.63 at the floor only


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_long_step_over_fills_nothing_that_a_short_one_does_not(dimension):
    """Steps in which grains fall through a cell and more are made in parts, with their ledger; few are left at rest. Where
    the front meets the floor, and while it simmers, nodes hold up to 15 % more than close packing: 0.64 to 0.71."""
    grains, packing = column(dimension, 4)
    start, weight = energy(grains), grains.comm.allreduce(grains.mass.sum()) * GRAVITY
    for _ in range(40):
        before, last = grains.momentum(), energy(grains)
        grains.advance(1e-2, packing)
        force = sum(wall.force for wall in packing.walls)
        total = grains.momentum() - before - 1e-2 * (weight / GRAVITY * grains.gravity - force)
        assert np.abs(total).max() < 1e-12 * weight and packing.momentum_imbalance < 1e-12
        assert packing.max_solid_fraction < 0.7245 and energy(grains) < last + 2e-3 * start
    assert packing.steps_largest > 5 and packing.steps_last < packing.steps_largest / 3


def test_free_flight_in_parts_is_that_of_the_whole_step():
    """With any relaxation; and beside the force of the stress the impulse is that of the step."""
    from fe_el.particles.motion import free_flight
    from fe_el.particles.packing_kernels import force_in_part
    rng, n, dt, gravity = np.random.default_rng(0), 6, 0.1, np.array([0.0, 0.0, -GRAVITY])
    rate, mass, held = np.array([0.0, 1e-3, 1.0, 30.0, 1e3, 1.0]), rng.uniform(1, 2, n), np.arange(n) == 5
    force, stress, v = rng.normal(size=(3, n, 3))
    whole, none, out = (np.zeros((n, 3)), v.copy()), np.zeros(0), np.empty((n, 3))
    free_flight(*whole, force, mass, gravity, rate, held, none, dt)
    for pushed in (np.zeros((n, 3)), stress):
        parts, impulse = (np.zeros((n, 3)), v.copy()), np.zeros((n, 3))
        for start, end in ((0.0, 0.03), (0.03, 0.035), (0.035, 0.1)):
            force_in_part(force, pushed, mass, gravity, rate, held, dt, start, end - start, out)
            free_flight(*parts, out, mass, gravity, rate, held, none, end - start)
            impulse += (end - start) * out
        assert np.allclose(impulse[~held], dt * force[~held], atol=1e-13)
        if not pushed.any():
            assert np.allclose(parts, whole, rtol=1e-12, atol=1e-14)


@pytest.mark.ranks
@pytest.mark.parametrize("dimension", [2, 3])
def test_without_gravity_energy_falls_in_every_step(dimension):
    """Collisions and walls take energy; what the stress gives back in a step is less."""
    mesh, tags = fe_el.box((0.05,) * dimension, (4,) * dimension)
    grains = fe_el.Particles(mesh, RHO, thickness=0.05)
    diameter = (0.4 * 0.05 ** 3 / 2000 * 6 / np.pi) ** (1 / 3)
    grains.insert_in_box((0,) * dimension, (0.05,) * dimension, 2000, diameter, seed=1, coarse_graining=diameter / 1e-3)
    grains.velocity[:, :dimension] = np.random.default_rng(0).normal(size=(2000, dimension))[grains.id]
    packing = fe_el.MultiphasePIC(grains, walls=(tags, tuple(range(1, 2 * dimension + 1))))
    energies = [grains.kinetic_energy()]
    for _ in range(40):
        grains.advance(1e-3, packing)
        energies.append(grains.kinetic_energy())
    assert (np.diff(energies) < 0).all() and energies[-1] < 0.05 * energies[0]


@pytest.mark.ranks
def test_periodic_momentum_stays_to_round_off():
    """Two streams that meet stop each other; together they keep their momentum."""
    mesh, _ = fe_el.periodic_box((0.05, 0.05), (6, 6), (True, True))
    grains = fe_el.Particles(mesh, RHO, thickness=0.05)
    grains.insert_in_box((0, 0), (0.05, 0.05), 1000, 3e-3, seed=2)
    grains.velocity[:, 0] = np.where(grains.position[:, 0] < 0.025, 1.0, -0.5)
    packing, start = fe_el.MultiphasePIC(grains), grains.momentum()
    scale = grains.comm.allreduce(float(grains.mass @ np.abs(grains.velocity[:, 0])))
    for _ in range(50):
        grains.advance(5e-4, packing)
    assert np.abs(grains.momentum() - start).max() < 1e-12 * scale and packing.momentum_imbalance < 1e-12


@pytest.mark.ranks
def test_what_moves_does_not_depend_on_ranks(by_id):
    places = []
    for comm in (MPI.COMM_SELF, MPI.COMM_WORLD):
        grains, packing = column(3, 2, 300, comm=comm)
        for _ in range(25):
            grains.advance(2e-3, packing)
        places.append(by_id(grains, grains.position))
    assert np.abs(places[0] - places[1]).max() < 1e-11


@pytest.mark.parametrize("dimension", [2, 3])
def test_one_point_bounces_by_the_restitution(dimension):
    """From facets and from a plane alike: heights fall by e^2, the tangential velocity by its restitution, none gains
    energy."""
    mesh, tags = fe_el.box((1.0,) * dimension, (3,) * dimension)
    down = np.zeros(3)
    down[dimension - 1] = -GRAVITY
    normal = -down / GRAVITY
    for floor in (fe_el.FacetWalls(tags, 2 * dimension - 1), fe_el.PlaneWall((0, 0, 0), normal)):
        point = fe_el.Particles(mesh, RHO, down)
        place = np.full(dimension, 0.3)
        place[-1] = 0.2
        velocity = np.zeros(dimension)
        velocity[0] = 0.3
        point.insert_at([place], 1e-6, velocity=velocity)
        packing = fe_el.MultiphasePIC(point, walls=[floor], wall_restitution=0.8, tangential_restitution=0.5)
        height, last = 0.0, energy(point)
        for step in range(700):  # 0.202 s to the floor, 0.323 s up and down
            point.advance(5e-4, packing)
            assert energy(point) <= last * (1 + 1e-9)
            last = energy(point)
            if 0.22 < 5e-4 * step < 0.5:
                height = max(height, point.comm.allreduce(float(point.position[:, dimension - 1].sum())))
        assert height == pytest.approx(0.64 * 0.2, rel=0.01)
        assert point.comm.allreduce(float(point.velocity[:, 0].sum())) == pytest.approx(0.15, rel=1e-9)


@pytest.mark.ranks
def test_points_leave_where_no_wall_is():
    mesh, tags = fe_el.box((0.1, 0.1), (4, 4))
    dust = fe_el.Particles(mesh, RHO)
    dust.insert_at([[0.05, 0.05]], 1e-4, velocity=(1.0, 1.3))
    packing = fe_el.MultiphasePIC(dust, walls=(tags, (3, 4)), wall_restitution=1.0)
    dust.remove_at(tags, 2)
    for _ in range(30):
        dust.advance(5e-3, packing)
    assert dust.left == 1 and dust.total_number == 0


@pytest.mark.ranks
def test_dilute_particles_keep_the_path_of_their_relaxation(by_id):
    """Where no stress is, a step is that of free flight, to the last digit."""
    paths = []
    for packed in (False, True):
        mesh, tags = fe_el.box((0.1, 0.1, 0.1), (2, 2, 2))
        dust = fe_el.Particles(mesh, RHO, (0, 0, -GRAVITY))
        dust.insert_at([[0.05, 0.05, 0.05], [0.02, 0.03, 0.08]], 1e-6, velocity=(0.1, 0, 0))
        packing = fe_el.MultiphasePIC(dust, walls=(tags, (1, 2, 3, 4, 5, 6)), restitution=1.0) if packed else None
        dust.force[:, 1], dust.relaxation_rate[:] = 1e-15, 300.0
        for _ in range(5):
            dust.advance(5e-3, packing)
        paths.append(by_id(dust, dust.position))
    assert np.abs(paths[0] - paths[1]).max() < 1e-15


@pytest.mark.ranks
def test_a_run_goes_on_from_a_checkpoint(folder, by_id):
    grains, packing = column(2, 4, 800)
    for _ in range(100):
        grains.advance(1e-3, packing)
    fe_el.save_checkpoint(folder + "/state.h5", grains, packing)
    again, other = column(2, 4, 800)
    fe_el.load_checkpoint(folder + "/state.h5", again, other)
    for _ in range(5):
        grains.advance(1e-3, packing)
        again.advance(1e-3, other)
    assert np.abs(by_id(grains, grains.position) - by_id(again, again.position)).max() < 1e-10


def test_a_bed_in_gas_keeps_its_ledger():
    """In the place of contacts under a coupling with the fluid: pressure drop and floor carry the bed."""
    mesh, tags = fe_el.box((0.05, 0.2), (4, 16))
    down = (0, -GRAVITY, 0)
    grains = fe_el.Particles(mesh, RHO, down, thickness=0.05)
    diameter = (0.25 * 0.05 ** 2 * 0.2 / 1500 * 6 / np.pi) ** (1 / 3)
    grains.insert_in_box((0, 0), (0.05, 0.1), 1500, diameter, seed=1, coarse_graining=diameter / 1e-3)
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, 1.2, 1.8e-5, down)
    air.set_velocity(3, (0.0, 0.8))
    air.set_pressure(4)
    air.set_no_slip((1, 2))
    coupling = fe_el.Coupling.of(air, grains, [fe_el.Drag("gidaspow"), fe_el.PressureGradient()])
    packing, carried = fe_el.MultiphasePIC(grains, walls=(tags, (1, 2, 3))), []
    for step in range(300):
        if step == 100:
            start = grains.momentum()
        coupling.to_fluid(1e-3)
        air.advance(1e-3, coupling.fields)
        coupling.to_particles(1e-3)
        grains.advance(1e-3, packing)
        assert coupling.momentum_imbalance < 1e-11 and packing.momentum_imbalance < 1e-12
        assert packing.max_solid_fraction < 0.68
        carried.append(-0.05 * air.boundary_force(3)[0][1] - packing.walls[0].force[1])
    weight = grains.comm.allreduce(grains.mass.sum()) * GRAVITY
    gain = (grains.momentum() - start)[1] / 0.2
    gas = 1.2 * GRAVITY * 0.75 * 0.05 ** 2 * 0.2
    assert grains.total_number == 1500 and np.mean(carried[100:]) == pytest.approx(weight + gas + gain, rel=0.03)


def test_what_is_too_fast_for_parts_ends_in_a_sentence():
    mesh, tags = fe_el.box((1.0, 1.0), (2, 2))
    p = fe_el.Particles(mesh, RHO)
    p.insert_at([[0.3, 0.4]], 0.1, velocity=(1e9, 0.0))
    with pytest.raises(FloatingPointError, match="use a smaller step"):
        p.advance(1e-2, fe_el.MultiphasePIC(p, walls=(tags, (1, 2, 3, 4))))
    p.velocity[:] = 0.0
    p.force[:] = np.nan
    with pytest.raises(FloatingPointError, match="cross inf cells"):
        p.advance(1e-2, fe_el.MultiphasePIC(p, walls=(tags, (1, 2, 3, 4))))


def test_bad_input_is_refused():
    mesh, tags = fe_el.box((1.0, 1.0), (2, 2))
    p = fe_el.Particles(mesh, RHO)
    for words, make in (("restitution is 1.5", lambda: fe_el.MultiphasePIC(p, restitution=1.5)),
                        ("group 9", lambda: fe_el.MultiphasePIC(p, walls=(tags, 9))),
                        ("no wall of MultiphasePIC",
                         lambda: fe_el.MultiphasePIC(p, walls=fe_el.CylinderWall((0, 0, 0), (0, 0, 1), 1.0))),
                        ("pass an object of SolidsStress", lambda: fe_el.MultiphasePIC(p, stress=10.0)),
                        ("exponent", lambda: fe_el.SolidsStress(exponent=1.0)),
                        ("close packing", lambda: fe_el.SolidsStress(close_packing=1.2)),
                        ("strength", lambda: fe_el.SolidsStress(strength=-1.0))):
        with pytest.raises(ValueError, match=words):
            make()


def test_the_stress_and_its_implicit_solution():
    """tau by the formula, zero without particles, steep at close packing; s + step tau/s = total at any of them."""
    from fe_el.particles.solids_stress import implicit_fraction, stress_over_fraction
    law = fe_el.SolidsStress(10.0, 3.0, 0.63)
    assert law(0.5) == pytest.approx(10 * 0.125 / 0.13) and law(0.0) == 0 and law(0.63) > 1e6
    for total in (1e-3, 0.3, 0.63, 0.9, 5.0):
        for step in (1e-12, 1e-6, 1e-2):
            for guess in (0.0, 0.6):
                s = implicit_fraction(total, step, guess, law.numbers)
                stress, slope = stress_over_fraction(s, law.numbers)
                assert abs(s + step * stress - total) < 1e-12 + 1e-13 * step * slope
    h = 1e-6
    for s in (0.2, 0.5, 0.62, 0.7):
        below, above = (stress_over_fraction(s + way, law.numbers)[0] for way in (-h, h))
        assert stress_over_fraction(s, law.numbers) == pytest.approx((law(s) / s, (above - below) / (2 * h)), rel=1e-4)
