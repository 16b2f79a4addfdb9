"""Satellite points, void fraction and the conservation of momentum and solid volume."""
import numpy as np
import pytest

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


def fluidised(seed=1, steps=20, order=None):
    mesh, tags = fe_el.box((0.02, 0.02, 0.06), (3, 3, 9))
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, density=1.2, viscosity=1.8e-5, gravity=(0, 0, -9.81), tolerance=1e-12)
    air.set_velocity(5, (0, 0, 0.8))
    air.set_pressure(6, 0.0)
    for side in (1, 2, 3, 4):
        air.set_no_slip(side)
    beads = fe_el.Particles(mesh, density=2500.0, gravity=(0, 0, -9.81))
    d = np.repeat([1e-3, 2e-3], [600, 300])
    rng = np.random.default_rng(seed)
    x = fe_el.particles.insertion.lattice_positions((0, 0, 0), (0.02, 0.02, 0.055), rng.permutation(d), seed)
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
    from mpi4py import MPI
    def heights(beads, order):
        z = np.zeros(900)
        z[order[beads.id]] = beads.position[:, 2]
        return beads.comm.allreduce(z)
    plain = heights(fluidised(steps=100)[0], np.arange(900))
    order = np.random.default_rng(5).permutation(900)
    mixed = heights(fluidised(steps=100, order=order)[0], order)
    assert np.abs(plain - mixed).max() < 1e-10
    if MPI.COMM_WORLD.size > 1:
        from pathlib import Path
        stored = Path(__file__).parent / "__pycache__" / "heights.npy"
        MPI.COMM_WORLD.barrier()
        assert np.abs(plain - np.load(stored)).max() < 1e-10
    else:
        from pathlib import Path
        stored = Path(__file__).parent / "__pycache__" / "heights.npy"
        stored.parent.mkdir(exist_ok=True)
        np.save(stored, plain)
