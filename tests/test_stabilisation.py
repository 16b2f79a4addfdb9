"""Stabilisations, adaptive steps, ramps and inlet fluxes."""
import numpy as np
import pytest
from test_fluid_verification import periodic_vortex

import fe_el

PI = np.pi


def shear_step(stabilisation):
    """Extreme nodal velocities of a sharp transverse step that a uniform stream carries once round a periodic box."""
    mesh, _ = fe_el.periodic_box((1.0, 0.25), (32, 8))
    air = fe_el.VolumeAveragedNavierStokes(mesh, None, 1.0, 0.0, tolerance=1e-11, stabilisation=stabilisation)
    air.set_initial_velocity(lambda t, x: np.column_stack([np.ones(len(x)), (np.abs(x[:, 0] - 0.5) < 0.2) * 1.0]))
    momentum, low, high = air.momentum(), np.inf, -np.inf
    for _ in range(100):
        air.advance(0.01)
        low, high = min(low, air.nodal_velocity[:, 1].min()), max(high, air.nodal_velocity[:, 1].max())
    assert np.abs(air.momentum() - momentum).max() < 1e-13
    return low, high


def test_upwind_all_but_suppresses_the_overshoot_of_a_step():
    """3 % where the plain scheme, which damps nothing, overshoots by 40 % in a fluid without viscosity."""
    low, high = shear_step(fe_el.Upwind())
    assert low > -0.03 and 0.9 < high < 1.03
    low, high = shear_step(None)
    assert low < -0.3 and high > 1.3


def scalar_step(stabilisation):
    """Lowest and highest value of a scalar between 0 and 1 in a shear flow, and the change of its integral."""
    mesh, _ = fe_el.periodic_box((1.0, 1.0), (16, 16))
    air = fe_el.VolumeAveragedNavierStokes(mesh, None, 1.0, 1e-3, tolerance=1e-12, stabilisation=stabilisation)
    air.set_initial_velocity(lambda t, x: np.column_stack([np.sin(2 * PI * x[:, 1]), np.sin(2 * PI * x[:, 0])]))
    dye = fe_el.Scalar(air, 1e-9, lambda x: ((x[:, 0] > 0.3) & (x[:, 0] < 0.7)) * 1.0, "dye", 1e-13)
    low, high, total = np.inf, -np.inf, None
    for _ in range(40):
        air.advance(0.02)
        dye.advance(0.02)
        low, high = min(low, dye.value.x.array.min()), max(high, dye.value.x.array.max())
        total = dye.total() if total is None else total
    assert dye.total() == pytest.approx(total, rel=1e-12)
    return low, high


def test_a_scalar_is_monotone_with_upwind():
    low, high = scalar_step(fe_el.Upwind())
    assert low > -1e-9 and 0.8 < high < 1 + 1e-9
    low, high = scalar_step(None)
    assert low < -0.05 and high > 1.05


def test_streamline_keeps_the_second_order(monkeypatch):
    errors = []
    plain = fe_el.VolumeAveragedNavierStokes
    for n in (16, 32):
        monkeypatch.setattr(fe_el, "VolumeAveragedNavierStokes",
                            lambda *a, **k: plain(*a, **k, stabilisation=fe_el.Streamline()), raising=False)
        errors.append(periodic_vortex(n, 0.4 / n, 1.0, 0.001)[1])
        monkeypatch.undo()
    assert np.log2(errors[0] / errors[1]) > 1.9


def test_streamline_damps_what_the_mesh_does_not_resolve():
    """Less overshoot than the plain scheme, momentum kept (checked in shear_step)."""
    plain, damped = shear_step(None), shear_step(fe_el.Streamline())
    assert damped[1] - damped[0] < plain[1] - plain[0]


def test_a_bad_factor_is_refused():
    with pytest.raises(ValueError, match="Streamline"):
        fe_el.Streamline(0.0)


@pytest.mark.ranks
def test_adaptive_steps_hold_the_courant_number():
    mesh, _ = fe_el.periodic_box((2 * PI, 2 * PI), (8, 8))
    air = fe_el.VolumeAveragedNavierStokes(mesh, None, 1.0, 0.1)
    air.set_initial_velocity(lambda t, x: np.column_stack([np.sin(x[:, 0]) * np.cos(x[:, 1]),
                                                           -np.cos(x[:, 0]) * np.sin(x[:, 1])]))
    steps = []
    for time, dt in fe_el.adaptive_steps(air, 2.0, courant=0.4, growth=1.1, progress=False):
        assert air.courant(dt) < 0.4 + 1e-12
        air.advance(dt)
        steps.append(dt)
        assert air.time == pytest.approx(time)
    assert air.time == pytest.approx(2.0, abs=1e-12) and steps[-3] > 1.1 * steps[0]  # the flow decays, so steps grow
    assert (np.array(steps[1:]) / steps[:-1]).max() < 1.1 + 1e-9


def test_adaptive_steps_refuse_what_gives_no_step():
    mesh, _ = fe_el.box((1.0, 1.0), (2, 2))
    air = fe_el.VolumeAveragedNavierStokes(mesh)
    for words, options in (("at rest", {}), ("courant", {"courant": 0.0}), ("growth", {"growth": 0.5}),
                           ("largest", {"largest": -1})):
        with pytest.raises(ValueError, match=words):
            next(fe_el.adaptive_steps(air, 1.0, progress=False, **options))
    assert next(fe_el.adaptive_steps(air, 1.0, first=0.1, progress=False))[1] == 0.1


@pytest.mark.ranks
def test_a_ramped_parabolic_inlet_lets_in_exactly_its_volume():
    """Mean velocity 2/3 of the peak, exact on any mesh; a third of the way up the ramp it is 7/27 of that."""
    mesh, tags = fe_el.box((2.0, 1.0), (6, 3))
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, 1.0, 0.1, tolerance=1e-12)
    air.set_velocity(1, fe_el.ramp(lambda t, x: np.column_stack([4 * x[:, 1] * (1 - x[:, 1]), 0 * x[:, 1]]), 0.3))
    air.set_pressure(2)
    for time, flow in ((0.1, 7 / 27 * 2 / 3), (0.2, 20 / 27 * 2 / 3), (0.3, 2 / 3), (0.4, 2 / 3)):
        air.advance(0.1)
        assert mesh.comm.allreduce(air.last_step.inflow.sum()) == pytest.approx(flow, rel=1e-12)
        q = air.velocity.x.array.reshape(-1, 2)[:air.num_cells, 0]
        through = mesh.comm.allreduce(float(air.volume @ q)) / 2.0  # the stream passes every section
        assert through == pytest.approx(flow, rel=1e-8)
    with pytest.raises(ValueError, match="ramp"):
        fe_el.ramp((1.0, 0.0), 0.0)
