"""Paths of particles: second order in the step at any relaxation time, with contacts in sub-steps too, momentum exact."""
import numpy as np
import pytest
from dolfinx import fem

import fe_el
from demos.sedimenting_suspension import Suspension
from fe_el.dolfinx_api import scalar_space, vector_space


def stokes(s, re):
    return np.ones_like(s + re)


def one_way(particles, velocity, **settings):
    """Coupling to a fluid of viscosity 1 that particles do not change."""
    pressure = fem.Function(scalar_space(particles.mesh, "P", 1))
    return fe_el.Coupling(particles, velocity, pressure, 1e-12, 1.0, [fe_el.Drag(stokes)], fluid_velocity="linear",
                          mapping="particle_centred", **settings)


def touchless(particles, dt, steps):
    """Contacts that make ``steps`` sub-steps of a step."""
    return fe_el.Contacts(particles, fe_el.LinearSpringDashpot(particles.mass.min() * (np.pi * steps / (10 * dt)) ** 2, 1.0,
                                                               0.0),
                          steps_per_contact=10)


def turned(stokes_number, steps, sub_steps):
    """Distance from the axis after one turn, over the exact one."""
    mesh, _ = fe_el.box((16.0, 16.0), (8, 8))
    mesh.geometry.x[:, :2] -= 8.0
    u = fem.Function(vector_space(mesh, "P", 1))
    u.interpolate(lambda x: np.vstack([-x[1], x[0]]))
    bead, dt = fe_el.Particles(mesh, density=1.0, thickness=1e12), 2 * np.pi / steps
    bead.insert_at([[1.0, 0.0]], np.sqrt(18 * stokes_number), velocity=(0.0, 1.0, 0.0))
    coupling, contacts = one_way(bead, u), touchless(bead, dt, sub_steps) if sub_steps else None
    for _ in range(steps):
        coupling.to_fluid(dt)
        coupling.to_particles(dt)
        bead.advance(dt, contacts)
    root = np.roots([stokes_number, 1, -1j])  # of Z" St + Z' = i Z
    exact = abs(np.linalg.solve([[1, 1], root], [1, 1j]) @ np.exp(2 * np.pi * root))
    return np.hypot(*bead.position[0, :2]) / exact - 1


@pytest.mark.parametrize("sub_steps", [0, 2, 20])
@pytest.mark.parametrize("stokes_number", [0.01, 0.1, 0.5])
def test_solid_body_rotation(stokes_number, sub_steps):
    """Second order from tracers to what is thrown out, with the default settings, whatever the number of sub-steps."""
    coarse, fine = (abs(turned(stokes_number, steps, sub_steps)) for steps in (252, 504))
    assert coarse < 1e-4
    assert np.log2(coarse / fine) > 1.8


def returned(steps, sub_steps):
    """Largest distance of tracers from where they started, after a vortex has turned back."""
    mesh, _ = fe_el.box((1.0, 1.0), (64, 64))
    u, angle, dt = fem.Function(vector_space(mesh, "P", 1)), np.arange(8) * np.pi / 4, 2.0 / steps
    start = np.column_stack([0.5 + 0.15 * np.cos(angle), 0.75 + 0.15 * np.sin(angle)])
    u.interpolate(lambda x: np.vstack([np.sin(np.pi * x[0]) ** 2 * np.sin(2 * np.pi * x[1]),
                                       -np.sin(2 * np.pi * x[0]) * np.sin(np.pi * x[1]) ** 2]))
    still, dust = u.x.array.copy(), fe_el.Particles(mesh, density=1.0, thickness=1e12)
    dust.insert_at(start, 1e-3)
    coupling, contacts = one_way(dust, u), touchless(dust, dt, sub_steps) if sub_steps else None
    for k in range(steps):
        u.x.array[:] = np.cos(np.pi * (k + 0.5) * dt / 2) * still
        coupling.to_fluid(dt)
        coupling.to_particles(dt)
        dust.advance(dt, contacts)
    return np.hypot(*(dust.position[np.argsort(dust.id), :2] - start).T).max()


@pytest.mark.parametrize("sub_steps", [0, 20])
def test_tracers_return(sub_steps):
    """The relaxation time is 1e-8 of the step."""
    coarse, fine = returned(400, sub_steps), returned(800, sub_steps)
    assert fine < 2e-5
    assert np.log2(coarse / fine) > 1.8


@pytest.mark.parametrize("relaxations", [1e-6, 0.01, 1.0, 30.0, 1e4])
@pytest.mark.parametrize("sub_steps", [0, 1, 7])
def test_fall_in_still_fluid_is_exact(relaxations, sub_steps):
    """Velocity and position, at any number of relaxation times in a step."""
    mesh, _ = fe_el.box((1e4, 1e4, 1e3), (1, 1, 1))  # so large that the bead leaves the void fraction alone
    bead, dt = fe_el.Particles(mesh, density=1.0, gravity=(0.0, 0.0, -0.01)), 0.5
    tau = dt / relaxations
    bead.insert_at([[0.5, 0.5, 5e2]], 0.1, density=18 * tau / 0.01, velocity=(0.0, 0.0, 0.02))
    u = fem.Function(vector_space(mesh, "P", 1))
    coupling, contacts = one_way(bead, u), touchless(bead, dt, sub_steps) if sub_steps else None
    for _ in range(3):
        coupling.to_fluid(dt)
        coupling.to_particles(dt)
        bead.advance(dt, contacts)
    if tau > 1e3:
        speed, way = 0.5, 2 * 1.5 - 0.5 * 1.5 ** 2
    else:
        speed, way = -tau + (2 + tau) * np.exp(-1.5 / tau), -1.5 * tau - (2 + tau) * tau * np.expm1(-1.5 / tau)
    assert bead.velocity[0, 2] == pytest.approx(0.01 * speed, abs=1e-7 if tau > 1e3 else 1e-11)
    assert bead.position[0, 2] - 5e2 == pytest.approx(0.01 * way, abs=1e-7 if tau > 1e3 else 1e-11)


@pytest.mark.parametrize("relaxations", [0.01, 1.0, 10.0, 30.0])
def test_a_bead_on_the_floor_has_the_drag_of_rest(relaxations):
    """The floor carries the weight less V beta u, the side wall what the flow presses against it, and the bead does not
    creep, however long the step is."""
    mesh, tags = fe_el.box((1e3, 1e3, 1e3), (2, 2, 2))
    beads, dt = fe_el.Particles(mesh, density=1.0, gravity=(0.0, 0.0, -9.81)), 0.01
    density = 18 * dt / relaxations / 0.01
    beads.insert_at([[999.95, 510.0, 0.05]], 0.1, density=density)
    mass = density * np.pi / 6 * 1e-3
    u = fem.Function(vector_space(mesh, "P", 1))
    speed = 0.2 * 9.81 * dt / relaxations
    u.interpolate(lambda x: np.vstack([0 * x[0] + 0.5 * speed, 0 * x[0], 0 * x[0] + speed]))
    contacts = fe_el.Contacts(beads, fe_el.LinearSpringDashpot(mass * 1e5, 0.3, 0.9), walls=(tags, (2, 5)))
    coupling = one_way(beads, u)
    for k in range(600):
        coupling.to_fluid(dt)
        coupling.to_particles(dt)
        beads.advance(dt, contacts)
        if k == 500:
            before = beads.position.copy()
    beta = mass * relaxations / dt
    assert beads.contact_force[0, 2] == pytest.approx(mass * 9.81 - beta * speed, rel=1e-6)
    assert beads.force[0] == pytest.approx(beta * np.array([0.5 * speed, 0, speed]), rel=1e-6, abs=1e-9 * mass)
    assert np.abs(beads.position - before).max() < 1e-9


def crowd(restitution=0.9):
    """A dense suspension whose particles collide in every step."""
    scene = Suspension(150e-6, 1500.0, 0.3, (12, 12, 12), (3, 3, 3), "conservative", "beetstra", "satellite_points", "cell",
                       None, 1.0,
                       True, 1)
    scene.beads.velocity += np.random.default_rng(2).normal(size=(scene.count, 3))[scene.beads.id]
    return scene


@pytest.mark.ranks
@pytest.mark.parametrize("dt_star", [0.4, 4.0, 40.0])
def test_momentum_is_exact_with_collisions(dt_star):
    scene = crowd()
    dt = dt_star * float(fe_el.time_scales.fluid_relaxation_time(150e-6, 1.3, 1.8e-5, scene.solid))
    scene.coupling.to_fluid(dt)
    before = scene.momentum()
    scale = scene.air.comm.allreduce(np.abs(scene.beads.mass[:, None] * scene.beads.velocity).sum())
    for _ in range(6):
        scene.advance(dt)
        assert scene.coupling.momentum_imbalance < 1e-11
        assert np.abs(scene.momentum() - before).max() < 1e-12 * (scale + scene.weight * dt)


@pytest.mark.ranks
@pytest.mark.parametrize("dt_star", [0.4, 4.0, 40.0])
def test_energy_does_not_grow_with_contacts(dt_star):
    """No gravity: drag and collisions only take energy of both phases."""
    scene = crowd()
    air, beads = scene.air, scene.beads
    air.gravity[:] = air.mean_pressure_gradient[:] = beads.gravity[:] = 0.0
    scene.coupling.pressure_force = None
    dt = dt_star * float(fe_el.time_scales.fluid_relaxation_time(150e-6, 1.3, 1.8e-5, scene.solid))
    scene.coupling.to_fluid(dt)
    energy = [scene.energy()]
    for _ in range(10):
        scene.advance(dt)
        energy.append(scene.energy())
    assert max(np.diff(energy)) <= 1e-3 * energy[0]
