"""The fluid against published benchmarks, and layered beds."""
import csv
from pathlib import Path

import numpy as np
import pytest
from dolfinx import fem

import fe_el
from demos import flow_past_cylinder
from fe_el.dolfinx_api import scalar_space, vector_space

REFERENCE = Path(__file__).parent / "reference"


def test_steady_flow_past_a_cylinder(tmp_path):
    """Drag and pressure difference of 2D-1 within 0.5 % of Nabh (1998), lift within 5e-4."""
    summary = flow_past_cylinder.main(20.0, 128, 0.03, 0.04, 0.01, 6.0, output=tmp_path, progress=False)
    assert abs(summary["drag_error"]) < 5e-3 and abs(summary["pressure_difference_error"]) < 5e-3
    assert abs(summary["lift"] - flow_past_cylinder.STEADY["lift"]) < 5e-4


def test_vortex_shedding_behind_a_cylinder(tmp_path):
    """Strouhal number of 2D-2 within 2 % of the middle of the accepted interval; drag within 3 %."""
    summary = flow_past_cylinder.main(100.0, time_step=0.005, end_time=6.0, output=tmp_path, progress=False)
    assert summary["strouhal"] == pytest.approx(0.30, rel=0.02)
    assert summary["largest_drag"] == pytest.approx(3.23, rel=0.03)


def cavity_deviation(n, dt, end, order=1, stretch=0.0):
    """Largest deviations from Ghia et al. (1982) at Re 1000 of u and v on the middle lines; ``stretch`` draws nodes to the
    walls."""
    mesh, tags = fe_el.box((1.0, 1.0), (n, n))
    mesh.geometry.x[:, :2] -= stretch * np.sin(2 * np.pi * mesh.geometry.x[:, :2]) / (2 * np.pi)
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, 1.0, 1e-3, tolerance=1e-6, time_order=order)
    air.set_velocity(4, (1.0, 0.0))
    for side in (1, 2, 3):
        air.set_no_slip(side)
    with open(REFERENCE / "ghia1982_cavity.csv") as file:
        rows = [r for r in csv.DictReader(file) if r["Re"] == "1000"]
    component = np.array([0 if r["line"][0] == "u" else 1 for r in rows])
    points = [(0.5, float(r["coord"])) if k == 0 else (float(r["coord"]), 0.5) for r, k in zip(rows, component)]
    nodal = fem.Function(vector_space(mesh, "P", 1))
    for _ in range(round(end / dt)):
        air.advance(dt)
    nodal.x.array.reshape(-1, 2)[:] = air.nodal_velocity
    found = fe_el.Probe([nodal], points).values()[0][np.arange(len(rows)), component]
    off = np.abs(found - [float(r["value_as_printed"]) for r in rows])
    return off[component == 0].max(), off[component == 1].max()


def test_lid_driven_cavity_at_reynolds_1000():
    """64 x 64 crossed squares within 0.02 of Ghia et al. at Courant number 9."""
    assert max(cavity_deviation(64, 0.1, 60.0)) < 0.02


def test_lid_driven_cavity_on_stretched_squares():
    """64 x 64 squares, at the walls half as wide: the default scheme at a Courant number below 3."""
    assert max(cavity_deviation(64, 0.02, 40.0, 2, 0.5)) < 0.02


@pytest.mark.parametrize("order, kept", [(1, 0.98), (2, 0.985)])
def test_gresho_vortex(order, kept):
    """A steady vortex without viscosity keeps its energy; it never grows, and momentum stays zero."""
    mesh, _ = fe_el.periodic_box((1.0, 1.0), (40, 40))
    air = fe_el.VolumeAveragedNavierStokes(mesh, None, 1.0, 0.0, tolerance=1e-9, time_order=order)

    def vortex(time, x):
        a, b = x[:, 0] - 0.5, x[:, 1] - 0.5
        r = np.hypot(a, b)
        w = np.where(r < 0.2, 5.0, np.where(r < 0.4, 2 / np.maximum(r, 1e-9) - 5, 0.0))
        return np.column_stack([-w * b, w * a])
    air.set_initial_velocity(vortex)
    energy = [air.volume @ (air.velocity.x.array.reshape(-1, 2) ** 2).sum(1)]
    dt = 0.5 * air.h.min()
    for _ in range(int(3.0 / dt)):
        air.advance(dt)
        energy.append(air.volume @ (air.velocity.x.array.reshape(-1, 2) ** 2).sum(1))
    assert energy[-1] > kept * energy[0] and np.diff(energy).max() < 1e-8 * energy[0]
    assert np.abs(air.momentum()).max() < 1e-14


@pytest.mark.ranks
@pytest.mark.parametrize("stiffness", [1.0, 1e6])
def test_pressure_drop_of_layered_beds_is_exact(stiffness):
    """Plug flow through layers of other void fraction and drag: sum of A u / phi times the layers' heights."""
    mesh, tags = fe_el.box((0.5, 1.0), (4, 8))
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, 1e-9, 0.0, tolerance=1e-13, time_order=1)
    flow = 0.7
    air.set_velocity(3, (0.0, flow))
    air.set_pressure(4, 0.0)
    scalar, vector = scalar_space(mesh, "DG", 0), vector_space(mesh, "DG", 0)
    void, drag, source = fem.Function(scalar), fem.Function(scalar), fem.Function(vector)
    layer = (air.corner.mean(1)[:, 1] * 4).astype(int)
    phi, beta = np.array([1.0, 0.4, 0.36, 0.8]), stiffness * np.array([0.01, 1.0, 50.0, 3.0])
    void.x.array[:air.num_cells], drag.x.array[:air.num_cells] = phi[layer], beta[layer]
    for _ in range(20):
        air.advance(10.0, (void, drag, source))
    drop = (beta * flow / phi ** 2).sum() / 4
    bottom = air.node_position[:, 1] < 1e-9
    assert np.abs(air.pressure.x.array[bottom] - drop).max(initial=0.0) < 1e-8 * drop
