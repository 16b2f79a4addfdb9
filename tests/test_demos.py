"""Every demo, small."""
import csv
import json
import os
import re

import numpy as np
import pytest

import fe_el
from demos import (
    bed_report,
    bed_runs,
    contacts_only,
    flow_past_cylinder,
    fluidised_bed,
    jet_in_cross_flow,
    jet_report,
    minimum_fluidisation,
    mri_bed,
    own_weak_form,
    salzman_jet,
    salzman_report,
    sedimenting_suspension,
    time_scales,
    turbulent_channel,
)
from demos.benchmarks import (
    broken_runs,
    contact_speed,
    coupled_map,
    error_against_run_time,
    fluid_error,
    fluid_speed,
    kill_and_restart,
    leaving_out,
    leaving_out_by_hand,
    long_run,
    mp_pic_against_contacts,
    parcel_speed,
    platforms,
    round_off,
    stability_map,
)
from demos.peers import (
    bed_against_dpmfoam,
    contacts_against_peers,
    forces_in_cells,
    ico_foam,
    suspension_against_dpmfoam,
)


@pytest.mark.ranks
def test_fluidised_bed(tmp_path_factory):
    from mpi4py import MPI
    folder = MPI.COMM_WORLD.bcast(str(tmp_path_factory.mktemp("bed")) if MPI.COMM_WORLD.rank == 0 else None)
    fluidised_bed.main(slice=0.1, end_time=2e-3, time_step=1e-4, output=folder, progress=False)
    MPI.COMM_WORLD.barrier()
    with open(folder + "/summary.json") as file:
        summary = json.load(file)
    assert summary["particles"] == 2772 + 1794 and summary["lost_particles"] == 0
    assert summary["solid_volume_error"] < 1e-12 and summary["momentum_imbalance"] < 1e-10
    assert summary["mass_residual"] < 1e-7
    assert abs(summary["bed_weight_per_area"] - 2154) < 3


def test_pressure_drop_of_a_falling_bed_is_what_the_balance_of_its_momentum_says(folder):
    """It falls from a loose lattice, so the drop is a third of its weight."""
    summary = fluidised_bed.main(1.8, 0.06, slice=0.05, record_every=1, output=folder, progress=False)
    weight = summary["bed_weight_per_area"]
    assert summary["momentum_gained_per_area"] < -0.5 * weight
    assert abs(summary["pressure_drop"] - summary["pressure_drop_expected"]) < 0.006 * weight


def test_fluidised_bed_goes_on_from_a_checkpoint(folder):
    """The second half from the file of the first is the second half of the whole."""
    common = {"slice": 0.1, "progress": False}
    whole = fluidised_bed.main(end_time=2e-3, checkpoint_every=1e-3, output=folder + "/a", **common)
    fluidised_bed.main(end_time=1e-3, checkpoint_every=1e-3, output=folder + "/b", **common)
    rest = fluidised_bed.main(end_time=2e-3, restart=folder + "/b/checkpoint.h5", output=folder + "/c", **common)
    for key in ("mean_height_small", "mean_height_large", "kinetic_energy"):
        assert rest[key] == pytest.approx(whole[key], rel=1e-10)
    with pytest.raises(ValueError, match="checkpoint-every"):
        fluidised_bed.main(checkpoint_every=-1.0, output=folder, **common)


def first_half_and_rest(folder, run, half, end, every):
    """Summaries of a run that wrote checkpoints, and of one that was broken off in the middle and went on in its folder."""
    whole = run(end_time=end, output=folder + "/a", checkpoint_every=every)
    run(end_time=half, output=folder + "/b", checkpoint_every=every)
    rest = run(end_time=end, output=folder + "/b", checkpoint_every=every, restart=True)
    frames = [re.findall('timestep="([^"]+)"', open(f"{folder}/{k}/{name}.pvd").read()) for k in "ab"
              for name in ("particles", "fluid") if os.path.isfile(f"{folder}/{k}/{name}.pvd")]
    assert frames[:len(frames) // 2] == frames[len(frames) // 2:] and len(frames[0]) > 2
    return whole, rest


def test_silo_goes_on_in_its_folder(folder):
    """From a moment after the outlet was opened: rates, masses and frames are those of the run without a break."""
    def run(**options):
        return contacts_only.main(diameter=4e-3, particles=300, settle_time=0.05, output_every=0.03, progress=False,
                                  **options)
    whole, rest = first_half_and_rest(folder, run, 0.1, 0.15, 0.05)
    for key in ("left_mass", "kinetic_energy", "discharge_rate", "largest_overlap_over_diameter", "lost_particles"):
        assert rest[key] == pytest.approx(whole[key], rel=1e-12) and whole["left_particles"] > 5  # times differ by round-off


def test_cylinder_goes_on_in_its_folder(folder):
    def run(**options):
        return flow_past_cylinder.main(100.0, 24, 0.08, 0.3, 0.02, output_every=0.05, progress=False, **options)
    whole, rest = first_half_and_rest(folder, run, 0.1, 0.2, 0.1)
    assert all(rest[key] == pytest.approx(whole[key], rel=1e-9) for key in ("largest_drag", "lift", "pressure_difference"))


@pytest.mark.parametrize("options", [{"correct_momentum": True, "coupling": "implicit"},
                                     {"contacts": True, "fluid_steps": 2}])
def test_suspension_goes_on_in_its_folder(folder, options):
    """The pressure gradient that corrects the momentum goes on, too."""
    def run(**more):
        return sedimenting_suspension.main(box=(24.0,) * 3, cells=(4, 4, 4), output_every=2e-3, progress=False, dt_star=0.5,
                                           **options, **more)
    whole, rest = first_half_and_rest(folder, run, 4.1e-3, 8.2e-3, 4e-3)
    for key in ("slip_velocity", "momentum_imbalance", "correction_over_weight", "steps"):
        assert rest.get(key, 0.0) == pytest.approx(whole.get(key, 0.0), rel=1e-9, abs=1e-13)


def test_measured_bed_and_ramp_go_on_in_their_folders(folder):
    """Means and the ledger go on; a run that is over is not made again; a name for checkpoints of many runs is refused."""
    def bed(**options):
        return mri_bed.main((0.9,), ("beetstra",), average_from=0.0, time_step=1e-3, progress=False, **options)
    half = bed(end_time=0.02, output=folder + "/a", checkpoint_every=0.01)
    again = bed(end_time=0.02, output=folder + "/a", checkpoint_every=0.01, restart=True)
    assert again["wall_time"] < 0.3 * half["wall_time"]
    assert all(again[k] == half[k] for k in half if "deviation" in k or "imbalance" in k or "overlap" in k)
    with pytest.raises(ValueError, match="without a name"):
        bed(end_time=0.02, output=folder, restart="a.h5")

    def ramp(**options):
        return minimum_fluidisation.main(ramp_time=0.02, settle_time=0.01, number=1000, output=folder + "/b", progress=False,
                                         **options)
    first, again = ramp(checkpoint_every=0.02), ramp(restart=True)
    assert again["pressure_drop_fluidised_over_weight"] == first["pressure_drop_fluidised_over_weight"]


def test_report_of_the_bed(folder):
    """Two settings, two realisations, a moment each: CSV, picture, and a recommended setting that is one of them."""
    options = {"slice": 0.1, "end_time": 2e-2, "output": folder, "progress": False, "superficial_velocity": 1.7}
    out = bed_report.main(options, ((1e-3, 20, 0.0075), (2e-3, 12, 0.0075)), 2)
    rows = np.genfromtxt(folder + "/report.csv", delimiter=",", names=True)
    assert len(rows) == 2 and (rows["lost"] == 0).all() and np.isfinite(rows["pressure_drop_error"]).all()
    assert out["recommended_steps_per_contact"] in (12, 20)


@pytest.mark.ranks
def test_mri_bed(tmp_path_factory):
    """A short run writes profiles for every measured one, its ledger closed, all of its time in stages."""
    from mpi4py import MPI
    folder = MPI.COMM_WORLD.bcast(str(tmp_path_factory.mktemp("mri")) if MPI.COMM_WORLD.rank == 0 else None)
    out = mri_bed.main((0.9,), ("beetstra",), end_time=0.02, average_from=0.0, time_step=1e-3, output=folder, progress=False)
    deviations = [v for k, v in out.items() if "deviation" in k]
    assert len(deviations) == 5 and np.isfinite(deviations).all()
    assert out["beetstra_0.9_momentum_imbalance"] < 1e-12 and out["beetstra_0.9_solid_volume_error"] < 1e-12
    assert out["beetstra_0.9_lost_particles"] == 0 and out["beetstra_0.9_seconds_rest"] < out["wall_time"]
    with pytest.raises(ValueError, match="measurements at 0.9 and 0.6"):
        mri_bed.main((0.7,), output=folder, progress=False)
    with pytest.raises(ValueError, match="average-from"):
        mri_bed.main((0.9,), end_time=0.5, average_from=1.0, output=folder, progress=False)


def test_averages_of_a_uniform_lattice():
    """Time means in boxes: the solid fraction of a regular lattice and its velocity."""
    mesh, _ = fe_el.box((0.04, 0.01, 0.04), (4, 1, 4))
    beads = fe_el.Particles(mesh, 1000.0)
    side = np.arange(0.0005, 0.04, 1e-3)
    beads.insert_at(np.array(np.meshgrid(side, side[:10], side)).reshape(3, -1).T, 1e-3, velocity=(0.0, 0.0, 0.3))
    averages = bed_runs.Averages(beads, np.linspace(0, 0.04, 5), np.array([0.01, 0.02]), 0.01)
    averages.add()
    averages.add()
    void, upward = averages.means()
    assert void == pytest.approx(1 - np.pi / 6, abs=2e-3) and upward == pytest.approx(0.3)


def test_ergun_of_the_column():
    """The published numbers of CFDEM's test: 230.5 Pa at 0.02 m/s, minimum fluidisation at 0.01451 m/s, at 0.4513."""
    height = 10_000 * np.pi / 6 * 1e-9 / (1 - 0.4513) / (np.pi * 0.01385 ** 2)
    assert minimum_fluidisation.minimum_velocity(0.4513) == pytest.approx(0.01451, rel=2e-3)
    assert minimum_fluidisation.ergun(0.4513, 0.02, height) == pytest.approx(230.5, rel=0.03)


def test_minimum_fluidisation(folder):
    """A short ramp of a shallow bed writes curve, picture and summary."""
    out = minimum_fluidisation.main(ramp_time=0.03, settle_time=0.02, number=1500, output=folder, progress=False)
    assert out["lost_particles"] == 0 and out["momentum_imbalance"] < 1e-12 and out["solid_volume_error"] < 1e-12
    rows = np.genfromtxt(folder + "/curve.csv", delimiter=",", names=True)
    assert len(rows) == 6 and rows["superficial_velocity_m_s"].max() == pytest.approx(0.024)


@pytest.mark.ranks
def test_dry_bed_imports_no_fluid(tmp_path_factory):
    import subprocess
    import sys
    code = ("import sys; sys.argv = ['x']; sys.path.insert(0, '.'); from demos import fluidised_bed as f; "
            f"f.main(0.0, 2e-3, slice=0.1, output={str(tmp_path_factory.mktemp('dry'))!r}, progress=False); "
            "assert not any(m.startswith(('fe_el.fluid', 'fe_el.coupling')) for m in sys.modules)")
    from mpi4py import MPI

    from fe_el.parallel.failures import environment_outside_mpirun
    if MPI.COMM_WORLD.rank == 0:
        from pathlib import Path
        subprocess.run([sys.executable, "-c", code], check=True, env=environment_outside_mpirun(),
                       cwd=Path(__file__).parent.parent)


@pytest.mark.ranks
@pytest.mark.parametrize("options", [{}, {"contacts": True}, {"smoothing_length": 3.0, "mapping": "hat",
                                                              "fluid_velocity": "linear"},
                                     {"coarse_graining": 3.0, "box": (48.0,) * 3}])
def test_sedimenting_suspension(folder, options):
    """The ledger of the small demo, and a slip near that of the uniform suspension so early on."""
    common = {"box": (24.0,) * 3, "cells": (4, 4, 4), "end_time": 0.005, "output": folder, "progress": False}
    summary = sedimenting_suspension.main(**{**common, **options})
    assert summary["stable"] and summary["lost_particles"] == 0
    assert summary["drift_over_weight"] < 1e-10 and summary["solid_volume_error"] < 1e-12
    if options.get("coarse_graining"):  # few parcels to a cell: the fluid finds channels, the slip can only be larger
        assert 0.9 < summary["slip_velocity"] / summary["homogeneous_slip"] < 2
    else:
        assert summary["slip_velocity"] == pytest.approx(summary["homogeneous_slip"], rel=0.25)
    assert summary["tau_f"] == pytest.approx(8.125e-4, rel=2e-3) and summary["tau_p"] == pytest.approx(0.1041667, rel=1e-4)


def test_unstable_explicit_run_says_so(folder):
    summary = sedimenting_suspension.main(coupling="explicit", dt_star=1.0, box=(24.0,) * 3, cells=(4, 4, 4), end_time=0.05,
                                          output=folder, progress=False)
    assert not summary["stable"]


def test_time_scales_of_the_papers_figure(folder):
    """Solid fraction 0.1: tau_f limits below about 200 um; 0.001: relaxation below about 20 um; 20 um needs 1e-6 to 1e-5
    s."""
    summary = time_scales.main(output=folder)
    assert summary["largest_diameter_limited_by_tau_f_at_0.1"] == pytest.approx(200e-6, rel=0.1)
    assert summary["largest_diameter_limited_by_tau_p_at_0.001"] == pytest.approx(18e-6, rel=0.3)
    assert 1e-6 < summary["time_step_at_20_um_at_0.1"] < 1e-5
    assert "conservative" in summary["advice"]


def test_error_against_run_time(folder):
    summary = error_against_run_time.main(schemes=("conservative", "explicit"), dt_star=(0.1, 2.0), cells=(3,), box=18.0,
                                          end_time=0.01, seeds=1, reference_dt_star=0.05, output=folder, progress=False)
    assert summary["largest_stable_dt_star_conservative"] == 2.0 and summary["largest_stable_dt_star_explicit"] == 0.1
    assert summary["drift_over_weight_conservative"] < 1e-12
    with open(folder + "/error_against_run_time.csv") as file:
        assert len(file.readlines()) == 5


@pytest.mark.ranks
def test_silo(folder):
    """The silo loses beads through its slot only, and their mass is accounted for."""
    summary = contacts_only.main(diameter=4e-3, particles=500, settle_time=0.1, end_time=0.25, output=folder, progress=False)
    assert summary["lost_particles"] == 0 and summary["left_particles"] > 20 and summary["mass_balance"] < 1e-12
    assert summary["largest_overlap_over_diameter"] < 0.1


def test_contact_speed(folder):
    summary = contact_speed.main(tiles=(1,), steps=20, settle_steps=200, output=folder, progress=False)
    assert summary["nanoseconds_per_particle_step_1000"] > 0 and summary["neighbours_per_particle_1000"] > 1
    assert 0 < summary["share_of_integration_1000"] < 1


def test_copies_of_a_periodic_tile_move_alike():
    """Sixty-four copies, so many beads that rows are asked for ahead of their use, against the one tile."""
    import numpy as np
    tile, moved = contact_speed.settled_tile(200), []
    for tiles in (1, 8):
        beads, contacts = contact_speed.bed(tiles, *tile)
        start = beads.position[np.argsort(beads.id)]
        beads.advance(20 * contact_speed.CONTACT_STEP, contacts)
        moved.append((beads.position[np.argsort(beads.id)] - start).reshape(-1, 1000, 3))
    size = np.abs(moved[0]).max()
    assert size > 1e-7 and np.abs(moved[1] - moved[0]).max() < 1e-9 * size


def test_platforms(folder, capsys, monkeypatch):
    """One run beside itself has the same figures; beside one with a figure that is off by a millionth it has not."""
    monkeypatch.setattr(platforms, "SCENES", {"own_weak_form": (own_weak_form.main, {"end_time": 2e-3}, ("mean_velocity",))})
    first = platforms.main(("own_weak_form",), folder + "/a", progress=False)
    os.makedirs(folder + "/b")
    with open(folder + "/b/summary.json", "w") as file:
        json.dump(first | {"own_weak_form_mean_velocity": 1.000001 * first["own_weak_form_mean_velocity"]}, file)
    assert platforms.compare([folder + "/a", folder + "/a"]) == 0.0
    assert platforms.compare([folder + "/a", folder + "/b"]) == pytest.approx(1e-6)
    said = capsys.readouterr().out
    assert ": the same within" in said and "NOT the same within" in said
    assert f"{first['own_weak_form_processor_time']:.2f} s" in said and f"dolfinx {first['version_dolfinx']}" in said


@pytest.mark.ranks
@pytest.mark.parametrize("dimension", [2, 3])
def test_own_weak_form(folder, dimension):
    """A fluid of the user's own exchanges momentum with the beads to round-off as well."""
    summary = own_weak_form.main(dimension, cells=3, particles=60, end_time=4e-3, output=folder, progress=False)
    assert summary["momentum_imbalance"] < 1e-12 and summary["solid_volume_error"] < 1e-12
    assert -9.81 * 4e-3 < summary["mean_velocity"] < 0  # held up by the gas, but falling


@pytest.mark.ranks
def test_flow_past_cylinder(folder):
    """A short, coarse run: the mass balance closes and both forces are recorded."""
    summary = flow_past_cylinder.main(100.0, 24, 0.08, 0.3, 0.02, 0.2, 0.1, folder, progress=False)
    assert summary["mass_residual"] < 1e-6 and summary["largest_drag"] > 1
    assert summary["strouhal_interval"] == [0.295, 0.305]


def test_fluid_speed(folder, monkeypatch):
    """Without icoFoam it says so and goes on."""
    monkeypatch.setattr(fluid_speed.ico_foam, "installed", lambda: False)
    summary = fluid_speed.main([3], 5, 1, folder, progress=False)
    assert summary["cube_fe_el_3_cells"] == 162 and summary["cube_fe_el_3_seconds"] > 0


def test_fluid_error(folder, monkeypatch, capfd):
    """The vortex' error falls at second order, and faster with Taylor-Hood; the cavity runs; without icoFoam it says so."""
    from pathlib import Path
    monkeypatch.setattr(fluid_error.ico_foam, "installed", lambda: False)
    summary = fluid_error.main([16, 32], [16], [8, 16], [8], [8], [4], 4.0, 1, folder, progress=False)
    assert "icoFoam is not installed" in capfd.readouterr().out and not any("icoFoam" in key for key in summary)
    assert summary["vortex_fe_el_16_error"] > 3.2 * summary["vortex_fe_el_32_error"]
    assert summary["vortex_Taylor_Hood_16_error"] < summary["vortex_fe_el_16_error"]
    assert summary["vortex_Taylor_Hood_8_error"] > 5 * summary["vortex_Taylor_Hood_16_error"]
    assert 10 * summary["vortex_Taylor_Hood_explicit_16_error"] < summary["vortex_fe_el_16_error"]
    assert 0 < summary["cavity_fe_el_8_error"] < 1 and 0 < summary["cavity_Taylor_Hood_4_error"] < 1
    assert summary["cavity_fe_el_8_cells"] == 256 and summary["cavity_fe_el_8_deviation_from_ghia"] < 1
    with open(folder + "/fluid_error.csv") as file:
        assert len(file.readlines()) == 9
    assert (Path(folder) / "fluid_error.png").is_file()


def test_cases_for_ico_foam_are_complete(folder):
    """All files of a case, with its mesh, patches and step."""
    from pathlib import Path
    ico_foam.write_case(folder + "/case", (1, 1, 1), (2, 3, 4),
                        {"walls": ("wall", "", "x- x+ y- y+ z- z+", "type noSlip;", "type zeroGradient;")},
                        1e-3, 0.25, 8, ico_foam.vectors([(1.0, 2.0)]))
    text = {p.name: p.read_text() for p in Path(folder + "/case").rglob("*") if p.is_file()}
    assert set(text) == {"blockMeshDict", "controlDict", "fvSchemes", "fvSolution", "decomposeParDict",
                         "transportProperties", "U", "p"}
    assert "(2 3 4)" in text["blockMeshDict"] and "endTime 2;" in text["controlDict"] and "(1 2 0)" in text["U"]


def test_stability_map(folder):
    """Energy never exceeds that of the start; the table, the picture and the summary are there."""
    from pathlib import Path
    summary = stability_map.main(["drag", "courant"], 5, 6, folder, progress=False)
    assert summary["bounded"] == summary["cases"] > 10 and summary["max_energy_drag"] <= 1 + 1e-8
    assert (Path(folder) / "stability_map.csv").is_file() and (Path(folder) / "stability_map.png").is_file()


def test_contacts_against_peers_without_peers(folder, monkeypatch, capfd):
    """Without LIGGGHTS and LAMMPS it says so, names the packages, and times fe_el alone."""
    monkeypatch.setattr(contacts_against_peers.shutil, "which", lambda name: None)
    summary = contacts_against_peers.main(["mixture"], [1000], 1, 1, 20, 10, 0.01, output=folder, progress=False)
    speeds = [v for k, v in summary.items() if k.startswith("million_particle_steps_per_second_mixture")]
    assert len(speeds) == 1 and speeds[0] > 0.1
    assert "apt-get install liggghts" in capfd.readouterr().out


def test_suspension_against_dpmfoam_without_it(folder, monkeypatch, capfd):
    """Without DPMFoam it names the package and compares fe_el's schemes alone; momentum is kept; an unknown scheme is
    named."""
    monkeypatch.setattr(suspension_against_dpmfoam.dpm_foam, "installed", lambda: False)
    small = {"box": (24.0,) * 3, "cells": (3,) * 3, "coarse_graining": 2.0, "end_time": 0.01, "seeds": 2, "output": folder,
             "progress": False}
    summary = suspension_against_dpmfoam.main(["conservative:0.5,1", "dpmfoam_explicit:0.1"], **small)
    assert "apt-get install openfoam" in capfd.readouterr().out and not any("dpmfoam" in key for key in summary)
    assert summary["drift_over_weight_conservative_1"] < 1e-12 and summary["against_small_step_conservative_0.5"] == 0
    assert 0 < abs(summary["against_small_step_conservative_1"]) < 0.05
    with pytest.raises(ValueError, match="'concervative:1'"):
        suspension_against_dpmfoam.main(["concervative:1"], **small)


def test_bed_against_dpmfoam_without_it(folder, monkeypatch, capfd):
    """Without DPMFoam it names the package and times fe_el alone."""
    monkeypatch.setattr(bed_against_dpmfoam.dpm_foam, "installed", lambda: False)
    summary = bed_against_dpmfoam.main(slice=0.1, settle_time=2e-3, steps=3, output=folder, progress=False)
    assert "apt-get install openfoam" in capfd.readouterr().out and "seconds_per_step_dpmfoam" not in summary
    assert summary["seconds_per_step_fe_el"] > 0 and summary["particles"] == 2772 + 1794


PEER_LOG = """Time = 1
Current number of parcels = 2
Current mass in system = 4
Linear momentum = (0 0 -2)
   3 move-collide subCycles
ExecutionTime = 0.1 s  ClockTime = 0 s
"""


def test_cases_for_dpm_foam_and_its_log(folder, monkeypatch):
    """All files of both cases; a log is read, and a run is stopped when it blows up or fails."""
    from pathlib import Path

    import numpy as np
    position = np.array([[1e-3, 2e-3, 3e-3], [1e-2, 5e-3, 4e-3]])
    bed_against_dpmfoam.write_peer(folder + "/bed", position, np.array([1.5e-3, 2.5e-3]), 1.3, 0.2, 1e-4, 5, 0.005, 20)
    text = {p.name: p.read_text() for p in Path(folder + "/bed").rglob("*") if p.is_file()}
    assert set(text) == {"blockMeshDict", "controlDict", "fvSchemes", "fvSolution", "g", "transportProperties",
                         "turbulenceProperties.air",
                         "kinematicCloudProperties", "small", "large", "U.air", "p", "HdotGradH"}
    assert "(6 3 90)" in text["blockMeshDict"] and "(0.01 0.005 0.004)" in text["large"] \
        and "endTime 0.0005;" in text["controlDict"]
    assert "value 0.0025;" in text["kinematicCloudProperties"] and "(0 0 -9.81)" in text["g"]
    scene = error_against_run_time.suspension("conservative", (24.0,) * 3, (3,) * 3, 1, coarse_graining=2.0)
    monkeypatch.setattr(suspension_against_dpmfoam.dpm_foam, "call", lambda command, where: "")
    (Path(folder) / "DPMFoam").write_text(f"#!/bin/sh\nprintf '%s' '{PEER_LOG}'\nmkdir -p postProcessing/velocity/0\n"
                                          "printf '# Time\\n1 (0 0 0.25)\\n' > "
                                          "postProcessing/velocity/0/volFieldValue.dat\n")
    (Path(folder) / "DPMFoam").chmod(0o755)
    import os
    monkeypatch.setenv("PATH", folder + os.pathsep + os.environ["PATH"])
    history, drift, stable, _ = suspension_against_dpmfoam.peer_history("explicit", 1.0, scene, (4, 4, 4), 2.0, 1e-3,
                                                                        folder + "/suspension")
    solid, rho = scene.solid, suspension_against_dpmfoam.GAS_DENSITY
    assert stable and history[-1].tolist() == [1.0, 0.75]  # of 0.25 less -2 / 4
    assert drift == pytest.approx(abs(solid * 1500 * -0.5 + (1 - solid) * rho * 0.25) / (solid * 1500 * 9.81 * 1e-3))
    assert "nParticle 8;" in Path(folder + "/suspension/constant/kinematicCloudProperties").read_text()
    out = bed_against_dpmfoam.dpm_foam.run(folder + "/bed")
    assert out["stopped"] is None and out["sub_steps"] == [3] and out["parcels"] == [2]
    assert "above 0.4 m/s" in bed_against_dpmfoam.dpm_foam.run(folder + "/bed", fastest=0.4)["stopped"]
    assert "above 0 s" in bed_against_dpmfoam.dpm_foam.run(folder + "/bed", limit=0.0)["stopped"]
    (Path(folder) / "DPMFoam").write_text("#!/bin/sh\nexit 1\n")
    assert "DPMFoam failed" in bed_against_dpmfoam.dpm_foam.run(folder + "/bed")["stopped"]


def test_turbulent_channel(folder):
    """A start by the logarithmic law keeps its mean velocity near Dean's only where the friction is that of the law."""
    means = []
    for law in (True, False):
        numbers = turbulent_channel.main(across=4, end_time=2.0, wall_law=law, output=folder, progress=False)
        means.append(numbers["mean_velocity"])
        assert numbers["mass_residual"] < 1e-8 and numbers["cells"] == 12 * 4 * 6 * 6
    assert abs(means[0] / np.sqrt(2 / numbers["friction_coefficient_dean"]) - 1) < 0.1
    assert means[1] > means[0] + 0.5


def test_forces_in_cells_beside_taylor_hood(folder):
    numbers = forces_in_cells.main(cubes=6, numbers=(0.5,), output=folder, progress=False)
    for name in ("one", "another", "ten_scattered", "ten_of_a_hundred"):
        assert numbers["largest_deviation_" + name] < 0.1, name


@pytest.mark.ranks
def test_jet_in_cross_flow(folder):
    """Coarse and short: parcels rise out of the slot, and what came in is held or has left."""
    summary = jet_in_cross_flow.main(cells=(18, 7), end_time=0.02, time_step=2e-4, coarse_graining=60.0, output=folder,
                                     progress=False)
    assert summary["stable"] and summary["parcels"] > 100 and summary["mass_balance"] < 1e-12
    assert summary["largest_third_law_error"] < 1e-12
    rows = np.genfromtxt(folder + "/heights.csv", delimiter=",", names=True)
    assert 0.01 < np.nanmax(rows["height_all_m"]) < 0.2
    with pytest.raises(ValueError, match="--slot is"):
        jet_in_cross_flow.main(slot=(1.7, 0.2), output=folder, progress=False)


def test_jet_report(folder):
    """Two schemes beside each other; explicit coupling at a large step is reported as unstable."""
    small = {"cells": (18, 7), "end_time": 0.01, "coarse_graining": 60.0, "output": folder, "progress": False}
    summary = jet_report.main(small, (("conservative", 2e-4, {}), ("explicit", 1e-3, {"slot_air": 0.0})))
    assert summary["runs"] == 2 and summary["stable_runs"] == 1
    with open(folder + "/report.csv") as file:
        assert len(file.readlines()) == 3


def test_salzman_jet(folder):
    """Coarse and short: the jet goes higher than Stokes' drag in undisturbed flow takes it; balances close."""
    summary = salzman_jet.main(coarse_graining=(40.0,), cells=1.5, end_time=0.016, average_from=0.01, time_step=2e-4,
                               output=folder, progress=False)
    assert summary["coarse_graining_40_mass_error"] < 1e-12 and summary["coarse_graining_40_momentum_imbalance"] < 1e-10
    assert 1.1 < summary["coarse_graining_40_over_stokes_at_50_mm"] < 2.5
    way = np.array([0.005, 0.05, 0.2])  # of the table in jicf_single_particle_trajectories.csv
    assert salzman_jet.stokes_height(way) == pytest.approx([0.0217815, 0.0423305, 0.0455196], rel=1e-5)
    assert os.path.getsize(folder + "/heights.png") > 0 and os.path.getsize(folder + "/coarse_graining_40/fields.png") > 0
    with pytest.raises(ValueError, match="--average-from"):
        salzman_jet.main(average_from=1.0, output=folder)


def test_salzman_report(folder):
    """Two settings: the second stands beside the first, which is the reference, with what it cost."""
    options = {"coarse_graining": [25.0], "cells": 3.0, "time_step": 1e-4, "smoothing_length": 1.125e-3, "end_time": 0.026,
               "average_from": 0.018, "output": folder, "progress": False}
    summary = salzman_report.main(options, ((1.5, 40, 2e-4, True), (1.5, 40, 4e-4, False)))
    rows = np.genfromtxt(folder + "/report.csv", delimiter=",", names=True)
    assert summary["runs"] == 2 and "edges across the nozzle" in summary["in_words"]
    assert rows["deviation"][0] == 0 and 0 < rows["deviation"][1] < 1 and (rows["processor_s"] > 0).all()
    assert rows["share_of_smoothing"][0] > 0 == rows["share_of_smoothing"][1]
    assert os.path.getsize(folder + "/report.png") > 0


def test_salzman_jet_goes_on_from_a_checkpoint(folder):
    def jet(end, name, restart=None):
        return salzman_jet.main((60.0,), cells=1.5, average_from=1e-3, time_step=2e-4, end_time=end, checkpoint_every=1e-3,
                                restart=restart, output=folder + name, progress=False)
    whole, _, rest = jet(4e-3, "/a"), jet(2e-3, "/b"), jet(4e-3, "/b", True)
    for name in ("mass_error", "momentum_imbalance", "largest_solid_fraction", "parcels", "courant"):
        key = "coarse_graining_60_" + name
        assert rest[key] == pytest.approx(whole[key], rel=1e-9, abs=1e-11), name


def test_mp_pic_beside_contacts(folder):
    summary = mp_pic_against_contacts.main(parcels=500, cells=2, time_step=(2e-3,), end_time=0.3, output=folder,
                                           progress=False)
    for kind in ("mp_pic", "contacts"):
        assert 0.5 < summary[f"{kind}_0.002_packing_at_rest"] < 0.67
    assert summary["mp_pic_0.002_largest_solid_fraction"] < 0.7


def test_parcel_speed(folder):
    summary = parcel_speed.main(numbers=(500, 2000), steps=2, cells=(18, 7), output=folder, progress=False)
    assert summary["bytes_per_parcel_2000"] < 300 and summary["million_parcel_steps_per_second_2000"] > 0
    assert np.isfinite(summary["exponent_all"])


def test_long_run(folder):
    """Sixty steps of the scene with everything in it: the table, memory and handles."""
    summary = long_run.main(60, 20, 30, folder, progress=False)
    assert summary["particles"] > 30 and summary["files"] <= summary["files_first"] + 2
    assert len(np.genfromtxt(folder + "/long_run.csv", delimiter=",")) == 3


def test_killed_runs_go_on(folder):
    """Nothing before the last checkpoint is lost, and the series of frames is whole."""
    summary = kill_and_restart.main(2, output=folder)
    assert summary["same_frames"] and summary["frames"] > 10 and summary["exit_codes"] == [-9]
    assert summary["kinetic_energy_difference"] < 1e-10 and summary["left_mass_difference"] == 0


def test_broken_runs_go_on(folder):
    """A run that is told to stop ends soon with the promised code, and goes on with all its beads."""
    found = broken_runs.main([("SIGTERM", 1)], output=folder)["SIGTERM_1"]
    assert found["exit_code"] == fe_el.run.stopping.STOPPED and found["seconds"] < 10 and not found["stray_files"]
    assert found["goes_on"] and found["same_frames"] and found["lost_particles"] == 0


def test_round_off_grows_in_collisions(folder):
    """A last digit stays one before beads meet, and is a part of the diameter a few collisions later."""
    numbers = round_off.main(50, output=folder)["distance_over_diameter"]
    assert numbers["10_ms"] < 1e-10 < numbers["50_ms"]


def test_leaving_out(folder):
    """Every variant runs, and what is left out is in no stage."""
    numbers = leaving_out.main(slice=0.1, settle_time=0.02, steps=3, output=folder, progress=False)
    rows = {row["scene"]: row for row in csv.DictReader(open(folder + "/leaving_out.csv"))}
    assert len(rows) == len(leaving_out.VARIANTS) and numbers["particles"] == 2772 + 1794
    assert rows["everything"]["smoothing"] and not rows["no smoothing"]["smoothing"]
    assert not rows["dry"]["fluid"] and not rows["dry"]["drag"] and not rows["gas alone"]["contacts"]
    assert not rows["fixed bed"]["neighbours"] and not rows["frozen flow"]["fluid"]


def test_leaving_out_by_hand(folder):
    """What a scene leaves out is in none of its kernels, and a step takes at least what is inside of them."""
    numbers = leaving_out_by_hand.main(slice=0.1, settle_time=0.01, steps=2, output=folder, progress=False)
    kernels = {}
    for row in csv.DictReader(open(folder + "/kernels.csv")):
        kernels.setdefault(row["scene"], set()).add(row["kernel"])
    for scene, absent in (("fixed bed", {"sub_steps", "overlap_shares", "free_flight"}),
                          ("dry", {"_gather", "solve pressure"}), ("frozen flow", {"solve pressure", "solve transport"}),
                          ("point particles", {"overlap_shares"}),
                          ("no smoothing", {"chebyshev"}), ("no pressure gradient", {"_slopes"}),
                          ("no contacts", {"sub_steps", "forces_in_step"}), ("gas alone", {"_gather", "relax", "volumes"}),
                          ("periodic without walls", {"wall_gaps", "add_friction"})):
        assert not absent & kernels[scene] and len(kernels[scene]) > 5
    assert {"sub_steps", "overlap_shares", "chebyshev", "_slopes", "solve pressure", "relax"} <= kernels["everything"]
    assert all(value > 1 for name, value in numbers.items() if name.startswith("ratio_"))


def test_coupled_map(folder):
    """Without particles, with all in one cell, at any step: the energy never grows and the ledger closes."""
    numbers = coupled_map.main(("places", "dt_star"), 5, folder, progress=False)
    assert numbers["cases"] == numbers["stable"] == numbers["ledger_exact"] == 13
    assert numbers["lost"] == 0 and numbers["stopped"] == 0 and numbers["warned"] > 0
