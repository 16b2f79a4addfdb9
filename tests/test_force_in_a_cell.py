"""A force that acts in one cell of a viscous fluid moves it as viscosity lets it, in steps of any length."""
import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

import fe_el
from fe_el.dolfinx_api import scalar_space, vector_space
from fe_el.fluid import coupled_pressure


def mobility(number, steps, cells=6, drag_coefficient=0.0, iterations=None):
    """Velocity of the cell times 6 pi mu h / F in a closed box; h: edge of the cubes, ``number``: nu dt / h^2.

    ``iterations``: list that gets those of the pressure in each step.
    """
    mesh, tags = fe_el.box((1.0, 1.0, 1.0), (cells,) * 3)
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, density=1.0, viscosity=1.0, tolerance=1e-9)
    for side in range(1, 7):
        air.set_no_slip(side)
    scalar, vector = scalar_space(mesh, "DG", 0), vector_space(mesh, "DG", 0)
    void, drag, source = fem.Function(scalar), fem.Function(scalar), fem.Function(vector)
    void.x.array[:] = 1.0
    one = int(np.argmin(np.abs(air.corner.mean(1) - 0.5).max(1)))
    drag.x.array[one] = drag_coefficient / air.volume[one]
    # without drag the force, with drag A times the velocity of the body
    source.x.array[3 * one + 2] = 1e-6 / air.volume[one]
    for _ in range(steps):
        air.advance(number / cells ** 2, (void, drag, source))
        if iterations is not None:
            iterations.append(air.last_step.pressure_iterations)
    velocity = air.velocity.x.array[3 * one + 2]
    return 6 * np.pi / cells * velocity / (1e-6 - drag_coefficient * velocity)


@pytest.fixture(scope="module")
def steady():
    """Of short steps; Taylor-Hood elements on meshes of such cubes have 2.15 to 2.32."""
    return mobility(0.05, 250)


def test_velocity_does_not_depend_on_the_step(steady):
    """From short steps to those that are far longer than viscosity needs across the box."""
    found = np.array([steady, mobility(0.5, 40), mobility(5.0, 20), mobility(500.0, 10), mobility(1e4, 10)])
    assert found.min() > 2.1 and found.max() < 1.03 * found.min()


@pytest.mark.parametrize("drag_coefficient", [0.0, np.pi, 100 * np.pi])
@pytest.mark.parametrize("number", [5.0, 500.0, 1e4])
def test_a_force_or_a_drag_that_sets_in_is_answered_by_viscosity_in_the_first_step(steady, number, drag_coefficient):
    """Not by the fluid's inertia alone, which would give 500 to a million, nor without the pressure that belongs to it."""
    for steps in (1, 2, 10):
        assert mobility(number, steps, 6, drag_coefficient) == pytest.approx(steady, rel=0.06)


def test_viscosity_may_change_between_steps():
    """A fluid at rest that gets another viscosity moves as one that has had it before."""
    found = []
    for first in (50.0, 1.0):
        mesh, tags = fe_el.box((1.0, 1.0, 1.0), (4, 4, 4))
        air = fe_el.VolumeAveragedNavierStokes(mesh, tags, density=1.0, viscosity=first)
        air.set_no_slip(tuple(range(1, 7)))
        air.advance(0.05)
        air.viscosity = 50.0
        scalar, vector = scalar_space(mesh, "DG", 0), vector_space(mesh, "DG", 0)
        void, drag, source = fem.Function(scalar), fem.Function(scalar), fem.Function(vector)
        void.x.array[:], source.x.array[2] = 1.0, 1.0
        for _ in range(3):
            air.advance(0.05, (void, drag, source))
        found.append(air.velocity.x.array.copy())
    assert np.abs(found[0]).max() > 0 and np.allclose(*found, rtol=1e-6, atol=1e-9 * np.abs(found[0]).max())


def test_a_force_that_fits_takes_no_iteration_of_the_pressure():
    """But the step in which it sets in, which is solved so far that the next have nothing to do."""
    iterations = []
    mobility(50.0, 10, iterations=iterations)
    assert 1 <= iterations[0] <= 12 and not any(iterations[1:])


@pytest.mark.parametrize("number, steps", [(0.05, 250), (5.0, 60)])
@pytest.mark.parametrize("strength", [1.0, 100.0])
def test_body_held_by_drag_feels_the_same_velocity(steady, strength, number, steps):
    """Drag that is weak and strong against what the fluid resists."""
    assert mobility(number, steps, 6, strength * np.pi) == pytest.approx(steady, rel=0.01 if number < 1 else 0.03)


def sphere_error(ratio, places=3, cells=8, reynolds=0.08):
    """How much too fast one sphere of diameter ``ratio`` cells falls in a periodic box of liquid, two-way, mean over
    places."""
    h, rho, rho_p, g, found = 1e-3, 1000.0, 2500.0, 9.81, []
    d, length, down = ratio * h, np.full(3, cells * h), np.array([0, 0, -g])
    mu = np.sqrt((rho_p - rho) * g * d ** 3 * rho / (18 * reynolds))
    terminal = (rho_p - rho) * g * d ** 2 / (18 * mu)
    dt, solid = min(0.5 * h * h * rho / mu, 0.02 * h / terminal), np.pi / 6 * d ** 3 / length.prod()
    balance = -(solid * rho_p + (1 - solid) * rho) * down
    for seed in range(places):
        mesh, _ = fe_el.periodic_box(length, (cells,) * 3)
        water = fe_el.VolumeAveragedNavierStokes(mesh, None, rho, mu, down, 1e-11, mean_pressure_gradient=balance)
        bead = fe_el.Particles(mesh, rho_p, down)
        bead.insert_at(np.random.default_rng(seed).uniform(0.3, 0.7, (1, 3)) * length, d)
        coupling = fe_el.Coupling(bead, water.velocity, water.pressure, rho, mu,
                                  [fe_el.Drag("stokes"), fe_el.PressureGradient(balance)])
        speed = []
        for _ in range(max(60, int(4 * h * h * rho / mu / dt))):
            coupling.to_fluid(dt)
            water.advance(dt, coupling.fields)
            coupling.to_particles(dt)
            bead.advance(dt)
            speed.append(-bead.velocity[0, 2])
        found.append(np.mean(speed[-len(speed) // 4:]) / terminal - 1)
    return float(np.mean(found))


def test_a_sphere_smaller_than_a_cell_is_carried_by_its_own_wake_as_the_cell_answers():
    """The cell's answer of 2.2 F/(6 pi mu h) to the sphere's weight is 1.1 d/h of its terminal velocity."""
    assert sphere_error(0.1) == pytest.approx(0.11, abs=0.02)


def strongest_flow(d, ends, number, strength, redrawn, steps=40):
    """Largest kinetic energy, by that of a flow of speed 1, of fluid in a box or a duct with no-slip walls and random drag.

    Drag is against bodies that move with speed 1 in the box, and are at rest in the duct, which fluid enters with speed 1.
    """
    n = 10 if d == 2 else 5
    mesh, tags = fe_el.box((1.0,) * d, (n,) * d)
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, density=1.0, viscosity=1.0, tolerance=1e-9)
    air.set_no_slip(tuple(range(1, 2 * d - 1 if ends == "duct" else 2 * d + 1)))
    if ends == "duct":
        air.set_velocity(2 * d - 1, (0.0,) * (d - 1) + (1.0,))
        air.set_pressure(2 * d, 0.0)
    scalar, vector = scalar_space(mesh, "DG", 0), vector_space(mesh, "DG", 0)
    void, drag, source = fem.Function(scalar), fem.Function(scalar), fem.Function(vector)
    void.x.array[:], cells, rng, energy = 1.0, air.num_cells, np.random.default_rng(0), []
    for step in range(steps):
        if redrawn or step == 0:
            drag.x.array[:] = strength * n ** 2 * rng.random(cells) ** 4 * (rng.random(cells) < 0.3)
            source.x.array[d - 1::d] = drag.x.array * (ends == "box")
        air.advance(number / n ** 2, (void, drag, source))
        energy.append(air.volume @ (air.velocity.x.array.reshape(-1, d) ** 2).sum(1))
    return max(energy)


@pytest.mark.parametrize("redrawn", [False, True])
@pytest.mark.parametrize("number, strength", [(0.3, 1e5), (30.0, 1e5), (1e3, 1e2), (1e4, 1e5)])
@pytest.mark.parametrize("d, ends", [(2, "box"), (2, "duct"), (3, "box"), (3, "duct")])
def test_flow_among_random_drag_stays_bounded_beside_walls(d, ends, number, strength, redrawn):
    """At Courant numbers up to 1000, in steps up to 10,000 times what viscosity needs across a cell; in the box bodies give
    it no more than their own speed has."""
    assert strongest_flow(d, ends, number, strength, redrawn) < (2.0 if ends == "duct" else 1.0)


def jumping_drag(comm, steps=6):
    """Places and velocities of the cells of a box, in which bodies that move with speed 1 drag other cells at each step."""
    mesh, tags = fe_el.box((1.0, 1.0, 1.0), (5, 5, 5), comm=comm)
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, density=1.0, viscosity=1.0, tolerance=1e-10)
    air.set_no_slip(tuple(range(1, 7)))
    scalar, vector = scalar_space(mesh, "DG", 0), vector_space(mesh, "DG", 0)
    void, drag, source = fem.Function(scalar), fem.Function(scalar), fem.Function(vector)
    place, n = np.round(air.corner.mean(1), 9), air.num_cells
    void.x.array[:n] = 0.6 + 0.3 * np.sin(place @ [50.0, 70.0, 90.0])
    for step in range(steps):
        drag.x.array[:n] = 1e3 * np.maximum(np.sin(place @ [127.0, 311.0, 74.0] * (1 + step)), 0.0) ** 8
        source.x.array[2:3 * n:3] = drag.x.array[:n]
        air.advance(0.2, (void, drag, source))
        assert air.last_step.pressure_iterations > 0
    velocity = np.concatenate(comm.allgather(air.velocity.x.array[:3 * n].reshape(-1, 3)))
    return velocity[np.lexsort(np.concatenate(comm.allgather(place)).T)]


def test_the_step_is_solved_as_a_whole(monkeypatch):
    """What is left of the divergence moves the velocity by less than a hundredth, where drag jumps in every step, too."""
    found = jumping_drag(MPI.COMM_SELF)
    for name, value in (("FITS", 1e-5), ("ENOUGH", 1e-5), ("LEAST", 1e-6), ("LOOSE", 1e-8), ("MOST", 40)):
        monkeypatch.setattr(coupled_pressure, name, value)
    assert np.linalg.norm(found - jumping_drag(MPI.COMM_SELF)) < 0.01 * np.linalg.norm(found)


@pytest.mark.ranks
def test_the_step_does_not_depend_on_the_ranks():
    """Nor on the order of nodes: iterations are few, but the same ones."""
    alone = jumping_drag(MPI.COMM_SELF)
    assert np.linalg.norm(jumping_drag(MPI.COMM_WORLD) - alone) < 1e-7 * np.linalg.norm(alone)
