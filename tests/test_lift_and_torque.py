"""Lift and torque: their laws, what the fluid gets of them, and a sphere that follows a shear."""
import numpy as np
import pytest

import fe_el
from fe_el.coupling.fluid_at_particles import FluidAtParticles
from fe_el.coupling.lift_and_torque import Spin

RHO, MU = 1000.0, 1e-3


def one_bead(diameter, density, forces, size=1e-2, spin=(0.0, 0.0, 0.0), flow=None, place=0.5, cells=6, **kwargs):
    """A bead in the middle of a closed box of water."""
    mesh, _ = fe_el.box((size,) * 3, (cells,) * 3)
    water = fe_el.VolumeAveragedNavierStokes(mesh, None, RHO, MU, tolerance=1e-12)
    if flow is not None:
        water.set_initial_velocity(flow)
    bead = fe_el.Particles(mesh, density)
    bead.insert_at([[place * size, 0.51 * size, 0.52 * size]], diameter)
    bead.angular_velocity[:] = spin
    return water, bead, fe_el.Coupling(bead, water.velocity, water.pressure, RHO, MU, forces, **kwargs)


def seen_by(bead, **quantities):
    return FluidAtParticles(bead, 1e-3, RHO, MU, bead.volume, {k: np.array([v], float) for k, v in quantities.items()})


@pytest.mark.parametrize("dt_over_tau", [0.01, 1.0, 100.0])
def test_spin_in_still_water_fades_as_that_of_stokes(dt_over_tau):
    """tau = rho_p d^2 / (60 mu), at any step."""
    tau = 2500.0 * 1e-4 ** 2 / (60 * MU)
    water, bead, coupling = one_bead(1e-4, 2500.0, [fe_el.Torque()], spin=(0.0, 3.0, 1.0))
    for _ in range(4):
        coupling.to_fluid(dt_over_tau * tau)
        coupling.to_particles(dt_over_tau * tau)
        bead.advance(dt_over_tau * tau)
    assert bead.angular_velocity[0] == pytest.approx(np.array([0.0, 3.0, 1.0]) * np.exp(-4 * dt_over_tau), abs=1e-12)


def test_torque_at_high_reynolds_number():
    """At Re_R = 1000 Dennis et al. have 2.67 times the torque of Stokes; the two laws meet at 32."""
    _, bead, _ = one_bead(1e-3, 2500.0, [fe_el.Torque()])
    slow = 60 * MU / (2500.0 * 1e-6)
    for re, factor in ((1000.0, 2.6676), (32.01, 1.0), (31.9, 1.0)):
        rate, _ = fe_el.Torque().spin(seen_by(bead, vorticity=[2 * re * MU / (RHO * 1e-6), 0.0, 0.0]))
        assert rate[0] / slow == pytest.approx(factor, rel=2e-3)


@pytest.mark.ranks
@pytest.mark.parametrize("held", [False, True])
def test_fluid_gets_the_opposite_couple(held):
    """No net force, and the moment of its momentum source is the torque, to round-off."""
    water, bead, coupling = one_bead(2e-3, 2500.0, [fe_el.Torque(), fe_el.Drag("stokes")], spin=(1.0, -2.0, 3.0))
    if held:
        bead.hold()
        bead.angular_velocity[:] = 0.0
        water.set_initial_velocity(lambda t, x: np.cross([1.0, 2.0, -1.0], x))
    coupling.to_fluid(1e-3)
    change = 0.1 * bead.mass[:, None] * bead.diameter[:, None] ** 2 * coupling.turn
    total = bead.comm.allreduce(change.sum(0))
    source = coupling._reaction() * water.volume[:, None]
    centre = water.corner.mean(1)
    moment = bead.comm.allreduce(np.cross(centre, source).sum(0))
    expected = bead.comm.allreduce(coupling.torque.sum(0))
    assert np.linalg.norm(expected) > 1e-12
    sums = bead.comm.allreduce(np.array([source.sum(0), np.abs(source).sum(0)]))
    assert np.abs(sums[0]).max() < 1e-13 * sums[1].max()
    assert moment == pytest.approx(-expected, rel=1e-10)
    assert total == pytest.approx(0.0 if held else 1e-3 * expected, rel=1e-10)


def test_moment_of_a_couple_in_two_dimensions():
    mesh, _ = fe_el.box((1.0, 1.0), (5, 5))
    air = fe_el.VolumeAveragedNavierStokes(mesh, None, 1.0, 1.0)
    centre = air.corner.mean(1)
    couple = np.where(np.abs(centre - 0.5).max(1) < 0.2, 2.0, 0.0)[:, None] * [0.0, 0.0, 1.0]
    force = Spin(mesh, []).force_of(couple) * air.volume[:, None]
    moment = (centre[:, 0] * force[:, 1] - centre[:, 1] * force[:, 0]).sum()
    assert moment == pytest.approx(air.volume @ couple[:, 2], rel=1e-12)


def test_saffman_and_magnus_lift():
    """A sphere that lags behind the fluid (slip along x) is driven to where the fluid is faster; one that turns is driven
    to where its surface moves with the fluid. Sizes are those of the papers at low Reynolds numbers."""
    _, bead, _ = one_bead(1e-4, 2500.0, [])
    slip, shear, turn = 1e-6, 1e-2, 1e-2
    fluid = seen_by(bead, slip=[slip, 0.0, 0.0], vorticity=[0.0, 0.0, -shear])  # u_x = shear y
    lift = fe_el.SaffmanLift().force(fluid)[0]
    assert lift[1] == pytest.approx(1.615 * 1e-8 * np.sqrt(MU * RHO * shear) * slip, rel=1e-3)
    bead.angular_velocity[0, 2] = turn
    lift = fe_el.MagnusLift().force(seen_by(bead, slip=[slip, 0.0, 0.0], vorticity=[0.0, 0.0, 0.0]))[0]
    assert lift[1] == pytest.approx(-np.pi / 8 * RHO * 1e-12 * turn * slip, rel=5e-3)
    for law in (fe_el.SaffmanLift(), fe_el.MagnusLift()):
        still = law.force(seen_by(bead, slip=[0.0, 0.0, 0.0], vorticity=[0.0, 0.0, 2 * turn]))
        assert np.array_equal(still, np.zeros((1, 3)))


def test_lift_at_high_reynolds_numbers():
    """Mei's factor at Re = 100, b = 0.4: 0.0524 sqrt 40; Oesterle and Bui Dinh at Re = 100, Re_R = 200."""
    _, bead, _ = one_bead(1e-3, 2500.0, [])
    slip = 100 * MU / (RHO * 1e-3)
    shear = 2 * 0.4 * slip / 1e-3
    lift = fe_el.SaffmanLift().force(seen_by(bead, slip=[slip, 0.0, 0.0], vorticity=[0.0, 0.0, -shear]))[0]
    assert lift[1] == pytest.approx(0.0524 * np.sqrt(40) * 1.615 * 1e-6 * np.sqrt(MU * RHO * shear) * slip, rel=1e-12)
    turn = 2 * slip / 1e-3
    lift = fe_el.MagnusLift().force(seen_by(bead, slip=[slip, 0.0, 0.0], vorticity=[0.0, 0.0, 2 * turn]))[0]
    coefficient = 0.45 + 1.55 * np.exp(-0.05684 * 200 ** 0.4 * 100 ** 0.3)
    assert lift[1] == pytest.approx(np.pi / 8 * RHO * 1e-6 * coefficient * slip ** 2, rel=1e-12)


def test_neutrally_buoyant_sphere_in_shear():
    """It goes with the fluid, turns at half the shear rate, and no lift drives it across."""
    forces = [fe_el.Drag("stokes"), fe_el.Torque(), fe_el.SaffmanLift(), fe_el.MagnusLift()]

    def shear(time, x):
        return np.column_stack([2 * (x[:, 1] - 5e-3), 0 * x[:, :2]])

    _, bead, coupling = one_bead(4e-4, RHO, forces, flow=shear, place=0.3, fluid_velocity="linear")
    dt, height = 0.25 * RHO * 4e-4 ** 2 / (18 * MU), bead.position[0, 1]
    bead.velocity[0] = shear(0.0, bead.position)
    for _ in range(200):
        coupling.to_fluid(dt)
        coupling.to_particles(dt)
        bead.advance(dt)
    assert bead.angular_velocity[0] == pytest.approx([0.0, 0.0, -1.0], abs=1e-10)
    assert bead.velocity[0] == pytest.approx([2 * (height - 5e-3), 0.0, 0.0], abs=1e-10)
    assert bead.position[0, 1] == pytest.approx(height, abs=1e-12)


@pytest.mark.ranks
def test_all_of_them_conserve_momentum():
    """Spinning beads of random velocity in a turning gas."""
    from tests.test_forces import step, suspension
    forces = [fe_el.Drag("beetstra"), fe_el.PressureGradient(), fe_el.Torque(), fe_el.SaffmanLift(), fe_el.MagnusLift()]
    air, beads, coupling = suspension(forces)
    beads.angular_velocity[:] = 1e4 * np.random.default_rng(4).normal(size=(300, 3))[beads.id]
    for _ in range(4):
        step(air, beads, coupling, 1e-3)
        assert coupling.momentum_imbalance < 1e-12
    assert beads.comm.allreduce(float(np.abs(coupling.explicit_reaction).sum())) > 0
