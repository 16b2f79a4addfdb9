"""Coupling schemes against the analytic relaxation of two bodies, and the conservation of momentum and energy."""
import numpy as np
import pytest

import fe_el
from demos.sedimenting_suspension import Suspension, main

D, RHO_P, RHO, MU = 150e-6, 1500.0, 1.3, 1.8e-5


def two_bodies(scheme, solid=0.1, u0=0.0, v0=1.0, beta=None):
    """Well-mixed particles and fluid without gravity; drag linear in the slip."""
    mesh, _ = fe_el.periodic_box((1e-3,) * 3, (3, 3, 3))
    air = fe_el.VolumeAveragedNavierStokes(mesh, None, RHO, MU, tolerance=1e-12)
    beads = fe_el.Particles(mesh, RHO_P)
    count = 20
    size = (solid * 1e-9 / count * 6 / np.pi) ** (1 / 3)
    beads.insert_in_box((0, 0, 0), (1e-3,) * 3, count, size, velocity=(0, 0, v0), seed=1)
    air.set_initial_velocity((0, 0, u0))
    coupling = fe_el.Coupling(beads, air.velocity, air.pressure, RHO, MU, [fe_el.Drag("stokes")], scheme, "well_mixed")
    tau_p = float(fe_el.time_scales.particle_relaxation_time(size, RHO_P, MU, solid))
    return air, beads, coupling, tau_p


def step(air, beads, coupling, dt):
    coupling.to_fluid(dt)
    air.advance(dt, coupling.fields)
    coupling.to_particles(dt)
    beads.advance(dt)


def state(air, beads):
    v = beads.comm.allreduce(beads.velocity[:, 2].sum()) / beads.total_number
    mass = air.density * air.void_fraction * air.volume
    total = beads.comm.allreduce(np.array([mass.sum(), mass @ air.velocity.x.array.reshape(-1, 3)[:air.num_cells, 2]]))
    return total[1] / total[0], v


def two_bodies_at(scheme, ratio):
    """Two bodies at mass loading 128.205 and the step that is ``ratio`` fluid relaxation times."""
    solid = 128.205128205 * RHO / (RHO_P + 128.205128205 * RHO)
    air, beads, coupling, tau_p = two_bodies(scheme, solid)
    return air, beads, coupling, ratio * tau_p * RHO * (1 - solid) / (RHO_P * solid)


@pytest.mark.parametrize("scheme, column", [("implicit", "amp_seed_eq8 (explicit v then implicit u)"),
                                            ("implicit_from_force", "amp_seed_eq8 (explicit v then implicit u)"),
                                            ("explicit", "amp_forward_euler")])
def test_amplification_of_the_papers_schemes(reference, scheme, column):
    """Slip after one step over slip before."""
    for row in reference("integrator_amplification_0d.csv"):
        air, beads, coupling, dt = two_bodies_at(scheme, row["dt/tau_f (mu=128.205)"])
        step(air, beads, coupling, dt)
        u, v = state(air, beads)
        assert v - u == pytest.approx(row[column], abs=1e-8)


@pytest.mark.parametrize("scheme", ["implicit", "conservative"])
@pytest.mark.parametrize("ratio", [0.1, 1.0, 5.0])
def test_momentum_that_the_papers_implicit_scheme_loses(scheme, ratio):
    """Over a whole relaxation eq. 8 loses dt/tau_f times the initial slip momentum of the fluid; conservative drag
    nothing."""
    air, beads, coupling, dt = two_bodies_at(scheme, ratio)
    before = beads.momentum()[2]
    for _ in range(250):
        step(air, beads, coupling, dt)
    fluid_mass = (air.density * air.void_fraction * air.volume).sum()
    drift = (air.momentum()[2] + beads.momentum()[2] - before) / fluid_mass
    assert drift == pytest.approx(-ratio if scheme == "implicit" else 0.0, rel=1e-3, abs=1e-10)


@pytest.mark.parametrize("loading", [0.1, 1.0])
def test_conservative_relaxation_converges_to_the_exact_one(reference, loading):
    """The error against the exact two-body relaxation halves with the step."""
    rows = [r for r in reference("relaxation_0d_linear.csv") if r["mass_loading"] == loading and r["t_over_tau_p"] == 1.0]
    solid = loading * RHO / (RHO_P + loading * RHO)
    errors = []
    for steps in (16, 32):
        air, beads, coupling, tau_p = two_bodies("conservative", solid)
        for _ in range(steps):
            step(air, beads, coupling, tau_p / steps)
        u, v = state(air, beads)
        errors.append(max(abs(u - rows[0]["u_fluid(u0=0)"]), abs(v - rows[0]["v_particle(v0=1)"])))
    assert errors[1] < 0.62 * errors[0] and errors[1] < 0.02


@pytest.mark.parametrize("ratio", [0.7, 1.3])
def test_explicit_drag_is_stable_up_to_the_limit_and_no_further(ratio):
    """Two bodies: the slip decays below 2 tau_f tau_p / (tau_p + tau_f), and grows beyond."""
    solid = 0.4
    air, beads, coupling, tau_p = two_bodies("explicit", solid)
    tau_f = tau_p * RHO * (1 - solid) / (RHO_P * solid)
    limit = fe_el.time_scales.explicit_limit(beads.diameter[0], RHO, MU, solid) if len(beads) else 2 * tau_f
    assert limit == pytest.approx(2 * tau_f)
    for _ in range(40):
        step(air, beads, coupling, ratio * limit)
    u, v = state(air, beads)
    assert (abs(v - u) < 1e-3) if ratio < 1 else (abs(v - u) > 1e3)


@pytest.mark.ranks
@pytest.mark.parametrize("smoothing_length", [None, 3.0])
@pytest.mark.parametrize("dt_star", [0.025, 1.0, 17.5, 1000.0])
def test_conservative_drag_keeps_momentum_at_any_step(dt_star, smoothing_length):
    scene = Suspension(D, RHO_P, 0.1, (24, 24, 24), (4, 4, 4), "conservative", "beetstra", "satellite_points", "cell",
                       smoothing_length, 1.0, False, 1)
    check_momentum(scene, dt_star)


@pytest.mark.ranks
@pytest.mark.parametrize("mapping", ["hat", "particle_centred", "cfdem_points"])
def test_momentum_is_kept_with_linear_interpolation_and_any_mapping(mapping):
    scene = Suspension(D, RHO_P, 0.1, (24, 24, 24), (4, 4, 4), "conservative", "tang", mapping, "linear", 2.0, 1.0, False, 1)
    check_momentum(scene, 5.0)


@pytest.mark.ranks
def test_momentum_is_kept_with_contacts_and_over_filled_cells():
    """Cells smaller than the particles: some are over-filled, hand on their excess, and nothing is lost."""
    scene = Suspension(D, RHO_P, 0.3, (9, 9, 9), (8, 8, 8), "conservative", "beetstra", "satellite_points", "cell", None,
                       1.0,
                       True, 1)
    check_momentum(scene, 2.0)
    assert scene.coupling.over_filled_total > 0


def check_momentum(scene, dt_star, steps=6):
    dt = dt_star * float(fe_el.time_scales.fluid_relaxation_time(D, 1.3, MU, scene.solid))
    scene.coupling.to_fluid(dt)
    before = scene.momentum()
    for _ in range(steps):
        scene.advance(dt)
        assert scene.coupling.momentum_imbalance < 1e-12
        assert scene.coupling.solid_volume_error < 1e-12
    assert np.abs(scene.momentum() - before).max() / (scene.weight * steps * dt) < 1e-10
    assert scene.beads.total_number == scene.count


@pytest.mark.ranks
@pytest.mark.parametrize("dt_star", [0.1, 10.0, 1000.0])
def test_energy_of_a_closed_system_never_grows(dt_star):
    """No gravity, random velocities of both phases: kinetic energy decays at every step, however large."""
    scene = Suspension(D, RHO_P, 0.1, (24, 24, 24), (4, 4, 4), "conservative", "beetstra", "satellite_points", "cell", None,
                       1.0,
                       False, 1)
    air, beads = scene.air, scene.beads
    air.gravity[:] = air.mean_pressure_gradient[:] = beads.gravity[:] = 0.0
    scene.coupling.pressure_force = None  # drag alone: what the pressure does to moving particles is no dissipation
    beads.velocity[:] = np.random.default_rng(2).normal(size=(scene.count, 3))[beads.id]
    dt = dt_star * float(fe_el.time_scales.fluid_relaxation_time(D, 1.3, MU, scene.solid))
    scene.coupling.to_fluid(dt)
    energy = [scene.energy()]
    for _ in range(8):
        scene.advance(dt)
        energy.append(scene.energy())
    assert (np.diff(energy) <= 1e-12 * energy[0]).all()


@pytest.mark.parametrize("law, column", [("beetstra", "slip_Beetstra"), ("wen_yu", "slip_WenYu"),
                                         ("gidaspow", "slip_Gidaspow"),
                                         ("tang", "slip_Tang"), ("tenneti", "slip_Tenneti(x eps)"),
                                         ("koch_hill", "slip_KochHill(x eps)")])
def test_slip_of_a_uniform_suspension(reference, law, column):
    """Started at twice the slip, a suspension without clusters finds the analytic slip within 0.1 %."""
    row = next(r for r in reference("homogeneous_sedimentation_slip.csv") if r["phi"] == 0.1)
    scene = Suspension(D, RHO_P, 0.1, (24, 24, 24), (3, 3, 3), "conservative", law, "well_mixed", "cell", None, 1.0, False,
                       1)
    fall = scene.beads.velocity[0, 2]
    scene.air.set_initial_velocity((0, 0, fall + 2 * scene.slip))
    for _ in range(60):
        scene.advance(0.5 * row["tau_f_Stokes_eq10_s"])
    expected = row[column] * (0.1 / 0.1)
    assert scene.slip == pytest.approx(expected, rel=2e-4)  # the count of particles is whole: 0.1 within 1e-4
    assert scene.mean_slip() == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("scheme", ["implicit", "implicit_from_force", "split", "void_cells_explicit"])
def test_the_papers_schemes_drift(folder, scheme):
    """Eq. 8 and its variants lose momentum where the conservative scheme keeps it to round-off (paper, S9)."""
    common = {"box": (24.0, 24.0, 24.0), "cells": (4, 4, 4), "dt_star": 0.4375, "end_time": 0.01, "output": folder,
              "progress": False}
    kept = main(coupling="conservative", **common)
    lost = main(coupling=scheme, **common)
    assert kept["drift_over_weight"] < 1e-12 and lost["drift_over_weight"] > 1e-6
    assert lost["stable"] and kept["stable"]


def test_the_papers_correction_force(folder):
    """With interpolated velocities eq. 8 needs a correction of more than 5 % of the weight, split a fraction of that (paper,
    S9); under the correction the total momentum stays within what one step drifts."""
    common = {"box": (24.0, 24.0, 24.0), "cells": (4, 4, 4), "dt_star": 0.4375, "end_time": 0.05, "output": folder,
              "progress": False,
              "fluid_velocity": "linear", "correct_momentum": True}
    implicit, split = (main(coupling=c, **common) for c in ("implicit_from_force", "split"))
    assert implicit["correction_over_weight"] > max(0.05, 4 * abs(split["correction_over_weight"]))
    one_step = implicit["correction_over_weight"] * implicit["time_step"] / implicit["end_time"]
    assert implicit["drift_over_weight"] < 3 * one_step
    kept = main(coupling="conservative", **common)
    assert abs(kept["correction_over_weight"]) < 1e-10


def test_parcels_feel_the_drag_of_their_particles():
    """A parcel of 27 particles relaxes like one particle, at the same solid fraction."""
    velocities = []
    for coarse, count in ((1.0, 27), (3.0, 1)):
        mesh, _ = fe_el.periodic_box((2e-3,) * 3, (3, 3, 3))
        air = fe_el.VolumeAveragedNavierStokes(mesh, None, RHO, MU)
        beads = fe_el.Particles(mesh, RHO_P)
        beads.insert_in_box((0, 0, 0), (2e-3,) * 3, count, coarse * D, velocity=(0, 0, 1.0), coarse_graining=coarse)
        coupling = fe_el.Coupling(beads, air.velocity, air.pressure, RHO, MU, [fe_el.Drag("beetstra")], mapping="well_mixed")
        for _ in range(5):
            step(air, beads, coupling, 5e-3)
        velocities.append(beads.velocity[0, 2])
    assert velocities[0] == pytest.approx(velocities[1], rel=1e-12) and velocities[0] < 0.9


def test_bad_choices_are_refused():
    mesh, _ = fe_el.periodic_box((1.0, 1.0), (3, 3))
    air, beads = fe_el.VolumeAveragedNavierStokes(mesh), fe_el.Particles(mesh, 1000.0)
    arguments = (beads, air.velocity, air.pressure, 1.0, 1e-3, [fe_el.Drag("stokes")])
    for words, kwargs in (("coupling scheme", {"scheme": "magic"}), ("mapping", {"mapping": "magic"}),
                          ("fluid_velocity", {"fluid_velocity": "cubic"}), ("largest", {"largest_solid_fraction": 1.5})):
        with pytest.raises(ValueError, match=words):
            fe_el.Coupling(*arguments, **kwargs)
    with pytest.raises(ValueError, match="no force"):
        fe_el.Coupling(*arguments[:5], [lambda: 0])
    with pytest.raises(ValueError, match="at least 3"):
        fe_el.periodic_box((1.0, 1.0), (2, 3))
