"""Injected particles in a uniform cross flow that does not feel them follow single particles' trajectories at any step."""
import csv
from pathlib import Path

import numpy as np
import pytest

import fe_el

# mesh, cells, where particles come in, their velocity, diameter, density, velocity of the air
CASES = {"Salzman_3D_15um": ((0.24, 0.06, 0.02), (12, 3, 1), (0.0, 0.0, 0.01), (0.0, 1.57 * 16.8, 0.0), 15e-6, 2638.0, 16.8),
         "seed_2D_5um": ((1.1, 0.05), (40, 2), (0.0, 0.0), (0.0, 0.591 * 25.4), 5e-6, 2500.0, 25.4),
         "seed_2D_20um": ((1.1, 0.05), (40, 2), (0.0, 0.0), (0.0, 0.591 * 25.4), 20e-6, 2500.0, 25.4)}
VISCOSITY, GAS_DENSITY = 1.91e-5, 1.1


def trajectory(case, drag, steps_in_tau):
    """Heights (stations,) at the stations of the reference, of particles that come in all the time; and the reference's."""
    size, cells, start, velocity, diameter, density, air = CASES[case]
    with open(Path(__file__).parent / "reference" / "jicf_single_particle_trajectories.csv") as file:
        rows = [r for r in csv.DictReader(file) if r["case"] == case]
    mesh, tags = fe_el.box(size, cells)
    gas = fe_el.VolumeAveragedNavierStokes(mesh, tags, GAS_DENSITY, VISCOSITY)
    gas.set_initial_velocity((air, *[0.0] * (len(size) - 1)))
    p = fe_el.Particles(mesh, density)
    p.remove_at(tags, 2)
    tau = density * diameter ** 2 / (18 * VISCOSITY)
    points = fe_el.Injector(p, fe_el.PointSource([start]), velocity, diameter, number_rate=40 / tau)
    coupling = fe_el.Coupling(p, gas.velocity, gas.pressure, GAS_DENSITY, VISCOSITY, [drag])
    stations = np.array([float(r["x_m"]) for r in rows])
    dt = tau / steps_in_tau
    for _ in range(int(np.ceil((stations[-1] / air + 2 * tau) / dt))):
        points.advance(dt)
        coupling.to_fluid(dt)
        coupling.to_particles(dt)
        p.advance(dt)
    order = np.argsort(p.position[:, 0])
    heights = np.interp(stations, p.position[order, 0], p.position[order, 1])
    return heights, *(np.array([float(r[c]) for r in rows]) for c in ("y_Stokes_m", "y_SchillerNaumann_m"))


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("steps_in_tau", [0.5, 2.0])
def test_stokes_drag(case, steps_in_tau):
    found, exact, _ = trajectory(case, fe_el.Drag("stokes"), steps_in_tau)
    assert np.abs(found / exact - 1).max() < 1e-3


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("steps_in_tau", [0.5, 2.0])
def test_drag_that_is_not_linear(case, steps_in_tau):
    """Schiller and Naumann's, which falls to less than half within a step."""
    found, _, exact = trajectory(case, fe_el.Drag("schiller_naumann", relaxing=True), steps_in_tau)
    assert np.abs(found / exact - 1).max() < 1e-3


def test_relaxing_drag_changes_nothing_for_a_linear_law():
    """Nor is it taken by schemes whose drag does not relax."""
    plain, _, _ = trajectory("Salzman_3D_15um", fe_el.Drag("stokes"), 0.5)
    assert trajectory("Salzman_3D_15um", fe_el.Drag("stokes", relaxing=True), 0.5)[0] == pytest.approx(plain, rel=1e-6)
    with pytest.raises(ValueError, match="relaxing=True"):
        mesh, _ = fe_el.box((1.0, 1.0), (2, 2))
        gas = fe_el.VolumeAveragedNavierStokes(mesh)
        fe_el.Coupling.of(gas, fe_el.Particles(mesh, 1e3), [fe_el.Drag("beetstra", relaxing=True)], scheme="split")
