"""Turbulent inlets: profiles, synthetic eddies and the dispersion by what is not resolved."""
import numpy as np
import pytest
from mpi4py import MPI

import fe_el

FLOOR = [((0, 0, 0), (0, 1, 0))]


def channel(dimension=3, comm=MPI.COMM_WORLD, **options):
    mesh, tags = fe_el.box((0.4, 0.2, 0.2)[:dimension], (4, 8, 8)[:dimension], comm=comm)
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, 1.2, 1.8e-5, **options)
    return air, tags


def test_profiles_over_a_wall():
    y = np.column_stack([np.zeros(4), [-1e-9, 0.01, 0.05, 0.3], np.zeros(4)])
    power = fe_el.PowerLaw((10.0, 0.0, 0.0), 0.1, FLOOR)(0.0, y)
    assert power[:, 0] == pytest.approx([0.0, 10 * 0.1 ** (1 / 7), 10 * 0.5 ** (1 / 7), 10.0]) and not power[:, 1:].any()
    law = fe_el.LogLaw((10.0, 0.0), 0.1, 1.5e-5, FLOOR)
    u, speed = law.friction_velocity, law(0.0, y)[:, 0]
    assert speed[3] == pytest.approx(10.0) and speed[0] == 0.0
    assert speed[1] == pytest.approx(u * (np.log(0.01 * u / 1.5e-5) / 0.41 + 5.2), rel=1e-12)
    between = fe_el.PowerLaw((1.0, 0.0), 0.1, [*FLOOR, ((0, 0.2, 0), (0, -1, 0))])
    assert between.distance(np.array([[0, 0.15, 0]])) == pytest.approx(0.05)


@pytest.mark.parametrize("dimension", [2, 3])
def test_eddies_have_their_intensity_and_no_flux(dimension):
    """Over many times the rms is the intensity in each direction; points a length apart differ, near ones do not; the flux
    is the mean's at every instant."""
    air, _ = channel(dimension)
    mean, intensity = np.array([5.0, 0.0, 0.0])[:dimension], [0.1, 0.05, 0.2][:dimension]
    eddies = fe_el.SyntheticEddies(air, 1, mean, intensity, 0.03, seed=4)
    facets, at = air.boundary(1), np.array([[0, 0.1, 0.1], [0, 0.101, 0.1], [0, 0.17, 0.1]])
    rows = []
    for time in np.linspace(0, 60.0, 3000):
        rows.append(eddies(time, at))
        if len(rows) % 500 == 0:
            flux = sum((eddies(time, x) * facets.area_normal).sum() for x in facets.points) / dimension
            expected = (mean * facets.area_normal).sum()
            assert air.comm.allreduce(flux) == pytest.approx(air.comm.allreduce(expected), rel=1e-12)
    change = np.array(rows) - mean
    # normal to the inlet the mean over the inlet is taken off
    assert change[:, 0, 1:].std(0) == pytest.approx(5 * np.array(intensity)[1:], rel=0.06)
    assert 0.7 < change[:, 0, 0].std() / (5 * intensity[0]) < 1.06
    together = np.corrcoef(change[:, :, 1].T)
    assert together[0, 1] > 0.95 and abs(together[0, 2]) < 0.1
    assert np.abs(change.mean(0)).max() < 0.1 * 5 * max(intensity)


@pytest.mark.ranks
def test_a_turbulent_inlet_closes_its_balance_of_mass():
    flows = []
    for comm in (MPI.COMM_SELF, MPI.COMM_WORLD):
        air, _ = channel(2, comm, tolerance=1e-11, turbulence=fe_el.Wale())
        profile = fe_el.PowerLaw((5.0, 0.0), 0.05, FLOOR)
        air.set_velocity(1, fe_el.SyntheticEddies(air, 1, profile, 0.2, 0.05))
        air.set_pressure(2)
        air.set_no_slip(3)
        air.set_initial_velocity((5.0, 0.0))
        for _ in range(10):
            air.advance(5e-3)
            assert air.mass_residual() < 1e-8
        flows.append(air.comm.allreduce(air.volume @ (air.velocity.x.array.reshape(-1, 2)[:air.num_cells] ** 2)))
    assert flows[0] == pytest.approx(flows[1], rel=1e-8) and flows[0][1] > 1e-6


@pytest.mark.ranks
def test_dispersion_walks_with_the_variance_of_the_closure(by_id):
    """Velocities seen have variance 2 k/3 from the first step on, forget each other at the rate of the closure, do not
    depend on ranks, and the pair keeps its momentum."""
    def uniform(fluid, u):
        return np.full(fluid.num_cells, 1e-3)
    seen = []
    for comm in (MPI.COMM_SELF, MPI.COMM_WORLD):
        mesh, _ = fe_el.periodic_box((0.1, 0.1, 0.1), (4, 4, 4), comm=comm)
        air = fe_el.VolumeAveragedNavierStokes(mesh, None, 1.2, 1.8e-5, turbulence=uniform)
        dust = fe_el.Particles(mesh, 2500.0)
        dust.insert_in_box((0, 0, 0), (0.1, 0.1, 0.1), 3000, 2e-5, seed=1)
        drag = fe_el.Drag("schiller_naumann")
        forces = [drag, fe_el.TurbulentDispersion(air, drag, seed=5)]
        coupling = fe_el.Coupling(dust, air.velocity, air.pressure, 1.2, 1.8e-5, forces)
        rows = []
        for _ in range(5):
            coupling.to_fluid(1e-3)
            air.advance(1e-3, coupling.fields)
            coupling.to_particles(1e-3)
            dust.advance(1e-3)
            assert coupling.momentum_imbalance < 1e-9
            rows.append(by_id(dust, dust.properties["_unresolved_velocity"]))
        seen.append(rows)
    assert np.abs(seen[0][-1] - seen[1][-1]).max() < 1e-10
    width = air.comm.allreduce((air.volume ** (4 / 3)).sum()) / 1e-3  # all cells are alike
    energy = (1e-3 / (0.094 * width)) ** 2
    assert seen[0][1].var() == pytest.approx(2 / 3 * energy, rel=0.05)
    kept = np.exp(-3e-3 * (0.5 + 0.75 * 2.1) * np.sqrt(energy) / width)
    assert np.mean(seen[0][1] * seen[0][4]) / seen[0][1].var() == pytest.approx(kept, abs=0.03)


def test_bad_input_is_refused():
    air, tags = channel(2)
    drag = fe_el.Drag("stokes")
    for words, make in (("thickness", lambda: fe_el.PowerLaw((1.0, 0.0), 0.0, FLOOR)),
                        ("needs a wall", lambda: fe_el.PowerLaw((1.0, 0.0), 0.1, [])),
                        ("not all zero", lambda: fe_el.LogLaw((0.0, 0.0), 0.1, 1e-5, FLOOR)),
                        ("length of the eddies", lambda: fe_el.SyntheticEddies(air, 1, (1.0, 0.0), 0.1, -1.0)),
                        ("intensity", lambda: fe_el.SyntheticEddies(air, 1, (1.0, 0.0), -0.1, 0.1)),
                        ("flows in", lambda: fe_el.SyntheticEddies(air, 1, (-1.0, 0.0), 0.1, 0.1)),
                        ("turbulence closure", lambda: fe_el.TurbulentDispersion(air, drag))):
        with pytest.raises(ValueError, match=words):
            make()
