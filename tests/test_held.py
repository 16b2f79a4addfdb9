"""Particles that are held: exact forces at any step, obstacles for others, no motion and no cost of motion."""
import numpy as np
import pytest
from dolfinx import fem

import fe_el
from fe_el.dolfinx_api import scalar_space, vector_space

D, SPEED, SOLID = 1e-3, 0.02, 0.5
DENSITY, VISCOSITY = 10.0, 1.5e-3


def bed(scheme="conservative", mapping="well_mixed", cells=(4, 4, 8)):
    """A fixed bed in a stream: fluid, beads and coupling."""
    lengths = np.array((0.01, 0.01, 0.02))
    mesh, tags = fe_el.box(lengths, cells)
    fluid = fe_el.VolumeAveragedNavierStokes(mesh, tags, density=DENSITY, viscosity=VISCOSITY)
    fluid.set_velocity(5, (0, 0, SPEED))
    fluid.set_pressure(6, 0.0)
    beads = fe_el.Particles(mesh, 2000.0, gravity=(0, 0, -9.81))
    beads.insert_in_box((0, 0, 0), lengths, int(SOLID * lengths.prod() / (np.pi / 6 * D ** 3)), D, seed=1)
    coupling = fe_el.Coupling(beads, fluid.velocity, fluid.pressure, DENSITY, VISCOSITY,
                              [fe_el.Drag("ergun"), fe_el.PressureGradient()],
                              scheme=scheme, mapping=mapping)
    return fluid, beads, coupling


def run(fluid, beads, coupling, dt, steps, contacts=None):
    for _ in range(steps):
        coupling.to_fluid(dt)
        fluid.advance(dt, coupling.fields)
        coupling.to_particles(dt)
        beads.advance(dt, contacts)


@pytest.mark.parametrize("scheme", ["conservative", "implicit"])
@pytest.mark.parametrize("dt", [5e-3, 5e-4, 5e-5])
def test_pressure_drop_of_a_fixed_bed_is_ergun_s(scheme, dt):
    """At every step, with beads of an ordinary density; fluid and beads agree on the force."""
    fluid, beads, coupling = bed(scheme)
    beads.hold()
    run(fluid, beads, coupling, dt, 40)
    void = 1 - SOLID
    ergun = 150 * SOLID ** 2 / void ** 3 * VISCOSITY * SPEED / D ** 2 + 1.75 * SOLID / void ** 3 * DENSITY * SPEED ** 2 / D
    assert np.ptp(fluid.pressure.x.array) / 0.02 == pytest.approx(ergun, rel=5e-3)
    drag = beads.force - beads.volume[:, None] * np.array([0, 0, ergun])
    assert drag[:, 2].sum() == pytest.approx(void * ergun * 0.01 * 0.01 * 0.02, rel=5e-3)
    if scheme == "conservative":
        assert coupling.momentum_imbalance < 1e-12
    assert not beads.velocity.any()


@pytest.mark.ranks
def test_a_bed_that_is_held_costs_no_motion(monkeypatch):
    """Shares are found once, nothing is located, contacts make no sub-steps; what is released is mapped again."""
    fluid, beads, coupling = bed(mapping="satellite_points", cells=(3, 3, 6))
    contacts = fe_el.Contacts(beads, fe_el.LinearSpringDashpot(100.0, 0.9, 0.1))
    calls = []
    prepare, locate = type(coupling.mapping).prepare, fe_el.Particles.locate
    monkeypatch.setattr(type(coupling.mapping), "prepare", lambda *a: calls.append("prepare") or prepare(*a))
    monkeypatch.setattr(fe_el.Particles, "locate", lambda p, **k: calls.append("locate") or locate(p, **k))
    beads.hold()
    run(fluid, beads, coupling, 1e-4, 3)
    run(fluid, beads, coupling, 1e-4, 2, contacts)
    assert calls == ["prepare"] and contacts.steps_last == 0
    assert coupling.solid_volume_error < 1e-12 and coupling.momentum_imbalance < 1e-11
    beads.position[:len(beads) // 2, 2] += 1e-9  # who moves them by hand gets a new map
    run(fluid, beads, coupling, 1e-4, 1)
    assert calls == ["prepare"] * 2
    first = beads.comm.rank == 0
    beads.release(np.arange(len(beads)) < (3 if first else 0))
    assert beads.total_number - beads.comm.allreduce(int(beads.held.sum())) == beads.comm.bcast(3)
    run(fluid, beads, coupling, 1e-6, 2)
    assert calls == ["prepare"] * 2 + ["prepare", "locate"] * 2
    assert np.array_equal((beads.velocity != 0).any(1), ~beads.held)


@pytest.mark.ranks
def test_rebound_from_a_held_bead_is_that_from_a_body_that_nothing_moves():
    """It does not move, and the other comes back with its restitution; momentum of those that move is changed by the holder
    alone."""
    mesh, _ = fe_el.box((0.02, 0.02, 0.02), (2, 2, 2))
    p = fe_el.Particles(mesh, density=2500.0)
    p.insert_at([[0.01, 0.01, 0.01], [0.0115, 0.01, 0.01], [0.01, 0.0109, 0.01]], 1e-3,
                velocity=[[0, 0, 0], [-0.5, 0, 0], [0, 0, 0]])
    p.hold(p.id != 1)  # the third overlaps with the first
    contacts = fe_el.Contacts(p, fe_el.LinearSpringDashpot(1000.0, 0.7, 0.3), steps_per_contact=400)
    for _ in range(30):
        p.advance(1e-4, contacts)
    v, place = np.zeros(3), np.zeros((3, 3))
    v[p.id], place[p.id] = p.velocity[:, 0], p.position
    v, place = p.comm.allreduce(v), p.comm.allreduce(place)
    assert v[[0, 2]].tolist() == [0, 0]
    assert np.array_equal(place[[0, 2]], [[0.01, 0.01, 0.01], [0.01, 0.0109, 0.01]])
    assert v[1] == pytest.approx(0.7 * 0.5, abs=2e-3)


@pytest.mark.ranks
def test_some_are_held_and_others_move_through_them():
    """With the fluid's force and gravity, on any number of ranks; the fluid gives what it loses."""
    fluid, beads, coupling = bed(mapping="satellite_points", cells=(3, 3, 6))
    beads.hold(beads.id % 3 > 0)
    where = {int(i): x.copy() for i, x in zip(beads.id[beads.held], beads.position[beads.held])}
    imbalance = 0.0
    for _ in range(10):
        run(fluid, beads, coupling, 1e-4, 1)
        imbalance = max(imbalance, coupling.momentum_imbalance)
    assert imbalance < 1e-11
    assert np.array_equal(beads.held, beads.id % 3 > 0)
    assert all(np.array_equal(where[int(i)], x) for i, x in zip(beads.id[beads.held], beads.position[beads.held]))
    assert (np.abs(beads.velocity[~beads.held]).max(1) > 0).all()


def test_a_checkpoint_keeps_who_is_held(tmp_path):
    mesh, _ = fe_el.box((1.0, 1.0, 1.0), (2, 2, 2))
    one, two = (fe_el.Particles(mesh, 1000.0) for _ in range(2))
    one.insert_in_box((0, 0, 0), (1, 1, 1), 20, 0.01)
    one.hold(one.id < 7)
    fe_el.save_checkpoint(tmp_path / "state.h5", one)
    fe_el.load_checkpoint(tmp_path / "state.h5", two)
    assert np.array_equal(two.held[np.argsort(two.id)], np.arange(20) < 7)
    two.release()
    assert not two.held.any()


def test_one_held_bead_in_a_stream_feels_its_drag_at_any_step():
    """V beta u, where a free bead of a short relaxation time would have run off within the step."""
    mesh, _ = fe_el.box((1.0, 1.0, 1.0), (2, 2, 2))
    u = fem.Function(vector_space(mesh, "P", 1))
    u.interpolate(lambda x: np.vstack([0 * x[0] + 2.0, 0 * x[0], 0 * x[0]]))
    p = fem.Function(scalar_space(mesh, "P", 1))
    for dt in (1e-6, 1.0, 1e6):
        bead = fe_el.Particles(mesh, 1000.0, gravity=(0, 0, -9.81))
        bead.insert_at([[0.6, 0.5, 0.4]], 1e-4)
        bead.hold()
        coupling = fe_el.Coupling(bead, u, p, 1.2, 1e-3, [fe_el.Drag(lambda s, re: np.ones_like(s + re))])
        coupling.to_fluid(dt)
        coupling.to_particles(dt)
        bead.advance(dt)
        assert bead.force[0] == pytest.approx([3 * np.pi * 1e-3 * 1e-4 * 2.0, 0, 0], rel=1e-9, abs=1e-20)
        assert np.array_equal(bead.position, [[0.6, 0.5, 0.4]])
