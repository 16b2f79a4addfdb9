"""Satellite points, void fraction and the conservation of momentum and solid volume."""
import numpy as np
import pytest
from mpi4py import MPI

import fe_el
from fe_el.coupling import mapping


def test_satellite_points_are_isotropic():
    x = mapping.isotropic_points()
    assert len(x) == 29 and np.allclose(x.sum(0), 0, atol=1e-15)
    moments = x.T @ x / 29
    assert np.allclose(moments, 0.196 * np.eye(3), atol=1e-3)


@pytest.mark.ranks
def test_shares_sum_to_one_at_walls_and_edges():
    """Particles that reach beyond the walls still give all their volume to cells."""
    mesh, _ = fe_el.box((0.02, 0.02, 0.02), (4, 4, 4))
    p = fe_el.Particles(mesh, density=1000.0)
    p.insert_in_box((0, 0, 0), (0.02, 0.02, 0.02), 400, diameter=np.linspace(1e-4, 3e-3, 400), seed=2)
    s = mapping.SatellitePoints()
    s.prepare(p.cells, p.cell, p.position, p.diameter / 2)
    assert np.allclose(np.add.reduceat(s.weight, s.start[:-1]), 1.0, atol=1e-14)
    air = fe_el.VolumeAveragedNavierStokes(mesh)
    c = fe_el.Coupling(p, air.velocity, air.pressure, 1.2, 1.8e-5, [fe_el.Drag("beetstra")], largest_solid_fraction=0.6)
    c.to_fluid(1e-4)
    assert c.over_filled > 0 and c.max_solid_fraction <= 0.6 * (1 + 1e-9)
    assert c.solid_volume_error < 1e-12


def fluidised(seed=1, steps=20, order=None, comm=MPI.COMM_WORLD):
    mesh, tags = fe_el.box((0.02, 0.02, 0.06), (3, 3, 9), comm=comm)
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, density=1.2, viscosity=1.8e-5, gravity=(0, 0, -9.81), tolerance=1e-12)
    air.set_velocity(5, (0, 0, 0.8))
    air.set_pressure(6, 0.0)
    for side in (1, 2, 3, 4):
        air.set_no_slip(side)
    beads = fe_el.Particles(mesh, density=2500.0, gravity=(0, 0, -9.81))
    d = np.repeat([1e-3, 2e-3], [600, 300])
    rng = np.random.default_rng(seed)
    x = fe_el.particles.insertion.lattice_positions((3e-4, 2e-4, 1e-4), (0.0193, 0.0192, 0.055), rng.permutation(d), seed)
    # no bead touches a wall at the start: rounding would decide on contact
    order = np.arange(900) if order is None else order
    beads.insert_at(x[order], np.random.default_rng(seed).permutation(d)[order])
    contacts = fe_el.Contacts(beads, fe_el.LinearSpringDashpot(500.0, 0.9, 0.1), walls=(tags, (1, 2, 3, 4, 5)))
    coupling = fe_el.Coupling(beads, air.velocity, air.pressure, 1.2, 1.8e-5,
                              [fe_el.Drag("beetstra"), fe_el.PressureGradient()])
    ledger = []
    for _ in range(steps):
        coupling.to_fluid(2e-4)
        air.advance(2e-4, coupling.fields)
        coupling.to_particles(2e-4)
        beads.advance(2e-4, contacts)
        ledger.append((coupling.solid_volume_error, coupling.momentum_imbalance, air.mass_residual()))
    return beads, air, np.array(ledger)


@pytest.mark.ranks
def test_ledger_of_a_fluidised_box():
    beads, _, ledger = fluidised()
    assert ledger[:, 0].max() < 1e-12
    assert ledger[:, 1].max() < 1e-10
    assert ledger[:, 2].max() < 1e-9
    assert beads.total_number == 900


@pytest.mark.ranks
def test_result_does_not_depend_on_ranks_or_order():
    """100 steps agree with the same run in another particle order, and with one rank alone."""
    def heights(beads, order):
        z = np.zeros(900)
        z[order[beads.id]] = beads.position[:, 2]
        return beads.comm.allreduce(z)
    plain = heights(fluidised(steps=100)[0], np.arange(900))
    order = np.random.default_rng(5).permutation(900)
    mixed = heights(fluidised(steps=100, order=order)[0], order)
    assert np.abs(plain - mixed).max() < 1e-10
    if MPI.COMM_WORLD.size > 1:
        alone = heights(fluidised(steps=100, comm=MPI.COMM_SELF)[0], np.arange(900))
        assert np.abs(plain - alone).max() < 1e-10


@pytest.mark.ranks
def test_a_sphere_falls_as_the_ordinary_differential_equation_says():
    """One-way drag of Schiller and Naumann in a fluid at rest, with buoyancy: velocity and height against a fine
    integration."""
    from scipy.integrate import solve_ivp
    d, rho_p, rho, mu, g = 2e-4, 2500.0, 1000.0, 1e-3, 9.81
    mesh, _ = fe_el.box((0.01, 0.01, 0.05), (2, 2, 10))
    air = fe_el.VolumeAveragedNavierStokes(mesh, None, rho, mu)
    p = fe_el.Particles(mesh, rho_p, (0, 0, -g))
    p.insert_at([[0.005, 0.005, 0.045]], d)
    c = fe_el.Coupling(p, air.velocity, air.pressure, rho, mu, [fe_el.Drag("schiller_naumann"), fe_el.Buoyancy()])

    def slope(t, y):
        f = 1 + 0.15 * (rho * abs(y[1]) * d / mu) ** 0.687
        return y[1], -g * (1 - rho / rho_p) - 18 * mu * f / (rho_p * d ** 2) * y[1]
    exact = solve_ivp(slope, (0, 0.1), (0.045, 0.0), rtol=1e-10, atol=1e-14).y[:, -1]
    for _ in range(500):
        c.to_fluid(2e-4)
        c.to_particles(2e-4)
        p.advance(2e-4)
    z, v = p.comm.allreduce(p.position[:, 2].sum()), p.comm.allreduce(p.velocity[:, 2].sum())
    assert v == pytest.approx(exact[1], rel=1e-3)  # the particle's own solid fraction counts a little in its cell
    assert z == pytest.approx(exact[0], abs=2e-5)


def test_a_dry_bed_only_loses_energy():
    """Beads that settle: kinetic plus potential energy never grows from one record to the next, nothing of a fluid
    exists."""
    mesh, tags = fe_el.box((0.02, 0.02, 0.04), (2, 2, 4))
    p = fe_el.Particles(mesh, 2500.0, (0, 0, -9.81))
    p.insert_on_lattice((0, 0, 0), (0.02, 0.02, 0.04), np.full(300, 2e-3), seed=2)
    p.velocity[:] = np.random.default_rng(1).normal(size=(300, 3)) * 0.3
    start = p.kinetic_energy()
    friction = fe_el.RollingFriction(0.05, elastic_plastic=True, torsion=True)  # without it a bead may roll on for long
    c = fe_el.Contacts(p, fe_el.LinearSpringDashpot(2000.0, 0.7, 0.3, rolling=friction), (tags, (1, 2, 3, 4, 5, 6)))
    energy = []
    for _ in range(150):
        p.advance(2e-3, c)
        energy.append(p.kinetic_energy() + float(p.mass @ p.position[:, 2]) * 9.81)
    rises = np.diff(energy)
    assert rises.max() < 1e-3 * start  # springs give back at most what they hold
    assert energy[-1] < 0.7 * energy[0] and p.kinetic_energy() < 1e-6 * start
