"""Added mass and light particles: terminal velocities at any step, momentum, contacts, and what is refused."""
import numpy as np
import pytest

import fe_el

D, RHO, MU, DOWN = 1e-3, 1000.0, 1e-3, np.array([0, 0, -9.81])


def swarm(ratio, number=40, mapping="well_mixed", cells=(3, 3, 4), forces=None, gravity=DOWN, **kwargs):
    """Light spheres in a periodic box of water; also their solid fraction."""
    length = np.array(cells) * 2 * D
    mesh, _ = fe_el.periodic_box(length, cells)
    solid = number * np.pi / 6 * D ** 3 / length.prod()
    balance = -(solid * ratio * RHO + (1 - solid) * RHO) * gravity
    water = fe_el.VolumeAveragedNavierStokes(mesh, None, RHO, MU, gravity, 1e-11, mean_pressure_gradient=balance)
    beads = fe_el.Particles(mesh, ratio * RHO, gravity)
    beads.insert_in_box((0, 0, 0), length, number, D, seed=4, without_overlap=True)
    forces = [fe_el.Drag("schiller_naumann")] if forces is None else forces
    coupling = fe_el.Coupling(beads, water.velocity, water.pressure, RHO, MU, [*forces, fe_el.PressureGradient(balance)],
                              mapping=mapping, **kwargs)
    return water, beads, coupling, solid


def step(water, beads, coupling, dt, contacts=None):
    coupling.to_fluid(dt)
    water.advance(dt, coupling.fields)
    coupling.to_particles(dt)
    beads.advance(dt, contacts)


def rise(ratio, solid):
    """Speed relative to the fluid, and the relaxation times of a particle alone, and with its added mass."""
    law, speed = fe_el.drag_laws.schiller_naumann, 0.1
    for _ in range(200):
        drag = float(law(np.array([solid]), np.array([RHO * (1 - solid) * speed * D / MU]))[0])
        speed = 0.5 * (speed + (1 - ratio) * RHO * 9.81 * D ** 2 / (18 * MU * drag))
    beta = 18 * MU * (1 - solid) * drag / D ** 2
    return speed, ratio * RHO / beta, (ratio + 0.5 * (1 + 2 * solid) / (1 - solid)) * RHO / beta


@pytest.mark.parametrize("ratio", [0.5, 0.1, 0.001])
@pytest.mark.parametrize("steps_per_tau", [100, 10, 1])
def test_light_particles_rise_at_their_terminal_velocity(ratio, steps_per_tau):
    """Within 1 % at steps of 0.01 to 1 relaxation times (at the first from that speed on: from rest it takes long)."""
    water, beads, coupling, solid = swarm(ratio)
    speed, own, whole = rise(ratio, solid)
    dt = own / steps_per_tau
    start = speed if 8 * whole / dt > 400 else 0.0
    beads.velocity[:, 2] = (1 - solid) * start
    water.set_initial_velocity((0.0, 0.0, -solid * start))
    for _ in range(min(int(8 * whole / dt), 400)):
        step(water, beads, coupling, dt)
        assert coupling.momentum_imbalance < 1e-12
    fluid = water.momentum()[2] / (RHO * (water.void_fraction @ water.volume))
    assert beads.velocity[:, 2].mean() - fluid == pytest.approx(speed, rel=0.01)


@pytest.mark.parametrize("coefficient", [0.5, None])
def test_first_acceleration_of_a_bubble(coefficient):
    """Without drag and at rest: (rho - rho_p) g / (rho_p + C rho) relative to the fluid's."""
    water, beads, coupling, solid = swarm(0.001, forces=[fe_el.AddedMass(coefficient)])
    c = 0.5 if coefficient else 0.5 * (1 + 2 * solid) / (1 - solid)
    dt = 1e-5
    for _ in range(3):
        step(water, beads, coupling, dt)
    fluid = water.momentum()[2] / (RHO * (water.void_fraction @ water.volume))
    # per volume over rho, with the given mean pressure gradient: rho_p v' = f - grad p - ..., f = C rho (u' - v')
    pressure = 0.001 * solid + 1 - solid
    system = np.array([[0.001 + c, -c], [-solid * c, 1 - solid + solid * c]])
    answer = 9.81 * np.linalg.solve(system, [pressure - 0.001, (1 - solid) * (pressure - 1)])
    assert beads.velocity[:, 2].mean() == pytest.approx(3 * dt * answer[0], rel=1e-6)
    assert fluid == pytest.approx(3 * dt * answer[1], rel=1e-6)


@pytest.mark.ranks
@pytest.mark.parametrize("smoothing", [None, 2e-3])
def test_momentum_with_added_mass_and_contacts(smoothing):
    """Fluid and particles keep their sum to round-off while bubbles collide, but for what the fluid receives in the next
    step; and none moves faster than at the start."""
    mesh, _ = fe_el.periodic_box((8e-3,) * 3, (4, 4, 4))
    water, beads = fe_el.VolumeAveragedNavierStokes(mesh, None, RHO, MU, tolerance=1e-12), fe_el.Particles(mesh, 0.01 * RHO)
    beads.insert_in_box((0, 0, 0), (8e-3,) * 3, 150, D, seed=2, without_overlap=True)
    beads.velocity[:] = 0.1 * np.random.default_rng(1).normal(size=(150, 3))[beads.id]
    fastest = beads.comm.allreduce(beads.speed(), op=fe_el_max())
    contacts = fe_el.Contacts(beads, fe_el.LinearSpringDashpot(stiffness=100.0, restitution=0.9, friction=0.1))
    coupling = fe_el.Coupling(beads, water.velocity, water.pressure, RHO, MU,
                              [fe_el.Drag("schiller_naumann"), fe_el.PressureGradient()],
                              smoothing=smoothing and fe_el.HelmholtzSmoothing(mesh, smoothing))
    coupling.to_fluid(1e-3)
    water.void_fraction = coupling.fields[0].x.array[:water.num_cells].copy()
    before = water.momentum() + beads.momentum()
    size = beads.comm.allreduce(float((beads.inertia * np.abs(beads.velocity[:, 0])).sum()))
    touched = 0
    for _ in range(12):
        step(water, beads, coupling, 1e-3, contacts)
        assert coupling.momentum_imbalance < 1e-12
        waiting = beads.comm.allreduce(coupling.added.waiting(beads, 3).sum(0))
        assert np.abs(water.momentum() + beads.momentum() + waiting - before).max() < 1e-12 * size
        touched = max(touched, float(np.abs(waiting).max()))
    assert touched > 1e-9 * size
    assert beads.comm.allreduce(beads.speed(), op=fe_el_max()) < fastest


def fe_el_max():
    from mpi4py import MPI
    return MPI.MAX


@pytest.mark.ranks
def test_bubbles_below_a_lid_come_to_rest():
    """Pressed by their buoyancy against the top of a closed box; what holds them is their weight less that of the water."""
    mesh, tags = fe_el.box((6e-3, 6e-3, 6e-3), (3, 3, 3))
    oil = fe_el.VolumeAveragedNavierStokes(mesh, tags, RHO, 0.05, DOWN, 1e-11)
    oil.set_no_slip(tuple(range(1, 7)))
    beads = fe_el.Particles(mesh, 0.001 * RHO, DOWN)
    beads.insert_in_box((0.6e-3, 0.6e-3, 3e-3), (5.4e-3, 5.4e-3, 5.4e-3), 12, D, seed=2, without_overlap=True)
    law = fe_el.LinearSpringDashpot(stiffness=50.0, restitution=0.5, friction=0.1)
    contacts = fe_el.Contacts(beads, law, walls=(tags, tuple(range(1, 7))))
    coupling = fe_el.Coupling(beads, oil.velocity, oil.pressure, RHO, 0.05,
                              [fe_el.Drag("schiller_naumann"), fe_el.PressureGradient()])
    for _ in range(70):  # steps of eighteen relaxation times
        step(oil, beads, coupling, 1e-2, contacts)
    assert beads.comm.allreduce(beads.speed(), op=fe_el_max()) < 1e-3
    held = beads.comm.allreduce(beads.mean_contact_force[:, 2].sum())
    assert held == pytest.approx(-12 * 0.999 * RHO * np.pi / 6 * D ** 3 * 9.81, rel=0.01)


def test_what_explodes_is_refused():
    with pytest.raises(ValueError, match="conservative"):
        swarm(0.1, scheme="explicit")
    with pytest.raises(ValueError, match="not negative"):
        fe_el.AddedMass(-0.5)
    water, beads, coupling, _ = swarm(2.5)
    assert coupling.added is None and len(coupling.fields) == 3
    beads.insert_at([[D, D, D]], D, density=1.0)
    with pytest.raises(ValueError, match="AddedMass"):
        coupling.to_fluid(1e-3)


def test_one_way_and_held_spheres_feel_an_accelerated_fluid():
    """A held sphere in water that speeds up: (1 + C) rho V du/dt, no drag given."""
    mesh, _ = fe_el.box((6e-3,) * 3, (3, 3, 3))
    water = fe_el.VolumeAveragedNavierStokes(mesh, None, RHO, MU)
    bead = fe_el.Particles(mesh, 2500.0)
    bead.insert_at([[3.1e-3, 3.2e-3, 3.3e-3]], D)
    bead.hold()
    water.pressure.interpolate(lambda x: -RHO * 2.0 * x[0])
    forces = [fe_el.AddedMass(0.5), fe_el.PressureGradient()]
    coupling = fe_el.Coupling(bead, water.velocity, water.pressure, RHO, MU, forces)
    for k in range(3):
        coupling.to_fluid(1e-3)
        water.set_initial_velocity((2.0 * 1e-3 * (k + 1), 0.0, 0.0))
        coupling.to_particles(1e-3)
    assert bead.force[0] == pytest.approx([1.5 * 2.0 * RHO * np.pi / 6 * D ** 3, 0, 0], abs=1e-12)
