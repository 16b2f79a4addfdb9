"""Slip velocity and momentum drift of a sedimenting suspension of parcels, at small and large steps, beside OpenFOAM's
DPMFoam.

Both codes start from the same parcels in the same periodic box, at the velocities of a uniform suspension. Forces and
elements differ a little between the codes, so each step is compared with the smallest of the same code and the same start.
"""
import argparse
import csv
import logging
import sys
import time
from pathlib import Path

import matplotlib
import numpy as np
from mpi4py import MPI
from tqdm import tqdm

import fe_el

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from demos.benchmarks.error_against_run_time import slip_history, suspension
from demos.peers import dpm_foam
from demos.sedimenting_suspension import GAS_DENSITY, GAS_VISCOSITY, GRAVITY

matplotlib.use("Agg")
DIAMETER, DENSITY, PERMEABILITY = 150e-6, 1500.0, 4e-7 * np.pi
PEER = {"dpmfoam_explicit": "explicit", "dpmfoam_semi_implicit": "semiImplicit"}
RUNS = ("conservative:0.1,1,4,8,17.5", "sub_cycled:0.1,1,4,8,17.5", "implicit:0.1,4", "split:0.1,4",
        "dpmfoam_explicit:0.1,0.4",
        "dpmfoam_semi_implicit:0.1,1,4,8,17.5")


def arguments():
    """Command line of the demo."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    p.add_argument("--runs", nargs="+", default=list(RUNS),
                   help="SCHEME:STEP,STEP,..., the first step is the reference; steps in fluid relaxation times of eq. 10; "
                        "schemes of "
                        "fe_el, sub_cycled (conservative, four steps of the fluid in one), " + ", ".join(PEER))
    p.add_argument("--box", type=float, nargs=3, default=(80.0, 80.0, 160.0), help="box in particle diameters")
    p.add_argument("--cells", type=int, nargs=3, default=(5, 5, 10),
                   help="cubes per direction in fe_el, six tetrahedra each")
    p.add_argument("--peer-cells", type=int, nargs=3, default=(8, 8, 16), help="cubes per direction in DPMFoam")
    p.add_argument("--coarse-graining", type=float, default=3.0, help="parcel diameter over particle diameter")
    p.add_argument("--end-time", type=float, default=0.15,
                   help="simulated time of every run [s]; the second half is averaged")
    p.add_argument("--seeds", type=int, default=3, help="realisations")
    p.add_argument("--output", default="out/suspension_against_dpmfoam", help="folder for results")
    return p


def peer_history(scheme, dt_star, scene, cells, coarse_graining, end_time, folder):
    """As ``slip_history``, of DPMFoam with the parcels of a suspension that was not advanced.

    DPMFoam has one gravity for both phases. Here it carries the gas upwards and the paramagnetic force on a uniform field
    pulls the particles down with their weight less buoyancy, so that the momentum of both together stays that of the start.
    """
    beads, lengths = scene.beads, np.ptp(scene.mesh.geometry.x, axis=0)
    cyclic = "type cyclic;"
    patches = {f"{axis}_{name}": ("cyclic", f"neighbourPatch {axis}_{other};", f"{axis}{sign}", cyclic, cyclic)
               for axis in "xyz" for name, other, sign in (("low", "high", "-"), ("high", "low", "+"))}
    tau_f = float(fe_el.time_scales.fluid_relaxation_time(DIAMETER, GAS_DENSITY, GAS_VISCOSITY, scene.solid))
    steps = max(round(end_time / (dt_star * tau_f)), 1)
    fall = beads.velocity[0, 2]
    pull = -GRAVITY * (1 - GAS_DENSITY / DENSITY) * DENSITY / PERMEABILITY
    dpm_foam.write_case(folder, lengths, cells, patches, end_time / steps, steps, (GAS_DENSITY, GAS_VISCOSITY),
                        GRAVITY * scene.solid * (DENSITY - GAS_DENSITY) / GAS_DENSITY, DENSITY,
                        {"parcels": (beads.position, DIAMETER, coarse_graining ** 3, fall)}, scheme,
                        "paramagnetic { HdotGradH HdotGradH; magneticSusceptibility 1.5; }", fall + scene.slip, uniform=pull)
    out = dpm_foam.run(folder, 20 * scene.slip)
    history = np.column_stack((out["time"], out["gas"] - out["particles"]))
    momentum = scene.solid * DENSITY * out["particles"] + (1 - scene.solid) * GAS_DENSITY * out["gas"]
    drift = np.abs(momentum[-1]) / (scene.solid * DENSITY * GRAVITY * end_time) if len(momentum) else np.nan
    seconds = out["seconds"][1:].sum() * steps / max(steps - 1, 1)  # the first step reads and injects the parcels
    return np.vstack(((0.0, scene.slip), history)), drift, out["stopped"] is None, seconds


def mean_and_error(values):
    """Mean and its standard error."""
    return float(np.mean(values)), float(np.std(values, ddof=1) / np.sqrt(len(values))) if len(values) > 1 else float("nan")


def rows_of(scheme, steps, runs):
    """A row of the table for each step of a scheme; runs: step -> list of (history, drift, stable, seconds)."""
    late = {step: np.array([h[h[:, 0] > 0.5 * h[-1, 0], 1].mean() for h, *_ in runs[step]]) for step in steps}
    rows = []
    for step in steps:
        stable = all(run[2] for run in runs[step])
        slip, error = mean_and_error(late[step]) if stable else (np.nan, np.nan)
        ratio, ratio_error = mean_and_error(late[step] / late[steps[0]] - 1) if stable else (np.nan, np.nan)
        rows.append({"scheme": scheme, "dt_star": step, "stable": stable, "slip": slip, "slip_standard_error": error,
                     "against_small_step": ratio, "against_small_step_standard_error": ratio_error,
                     "drift_over_weight": float(np.mean([run[1] for run in runs[step]])) if stable else np.nan,
                     "seconds": float(np.median([run[3] for run in runs[step]])) if stable else np.nan})
    return rows


def main(runs=RUNS, box=(80.0, 80.0, 160.0), cells=(5, 5, 10), peer_cells=(8, 8, 16), coarse_graining=3.0, end_time=0.15,
         seeds=3,
         output="out/suspension_against_dpmfoam", progress=True):
    """Run everything and return the summary; on one rank."""
    logging.getLogger().setLevel(logging.WARNING)
    start, rows, chosen = time.perf_counter(), [], {}
    for text in runs:
        scheme, _, steps = text.partition(":")
        if scheme not in (*PEER, "sub_cycled", *fe_el.schemes.SCHEMES) or not steps:
            raise ValueError(f"--runs has {text!r}; give SCHEME:STEP,STEP,... with one of {', '.join(PEER)}, sub_cycled, "
                             f"{', '.join(sorted(fe_el.schemes.SCHEMES))}.")
        chosen[scheme] = [float(step) for step in steps.split(",")]
    if not dpm_foam.installed() and PEER.keys() & chosen.keys():
        print("DPMFoam is not installed; on Debian: apt-get install openfoam.", flush=True)
        chosen = {scheme: steps for scheme, steps in chosen.items() if scheme not in PEER}

    def fresh(scheme, seed):
        return suspension("conservative" if scheme in PEER else scheme, box, cells, seed, "gidaspow", None, coarse_graining)
    for scheme in chosen.keys() - PEER.keys():
        slip_history(fresh(scheme, 1), 1.0, end_time / 50)  # compile before anything is timed
    Path(output).mkdir(parents=True, exist_ok=True)
    with tqdm(total=seeds * sum(map(len, chosen.values())), disable=not progress, unit="run") as bar:
        for scheme, steps in chosen.items():
            done = {step: [] for step in steps}
            for seed in range(1, seeds + 1):
                for step in steps:
                    scene = fresh(scheme, seed)
                    done[step].append(slip_history(scene, step, end_time) if scheme not in PEER else peer_history(
                        PEER[scheme], step, scene, peer_cells, coarse_graining, end_time,
                        Path(output).resolve() / f"{scheme}_{step:g}_{seed}"))
                    bar.update()
            rows += rows_of(scheme, steps, done)
    table(output, rows)
    numbers = {f"{key}_{r['scheme']}_{r['dt_star']:g}": r[key] for r in rows for key in
               ("stable", "slip", "against_small_step", "against_small_step_standard_error", "drift_over_weight", "seconds")}
    return fe_el.write_summary(output, MPI.COMM_SELF, parcels=scene.count, seeds=seeds, end_time=end_time,
                               wall_time=time.perf_counter() - start, **numbers)


def table(output, rows):
    """CSV, the same as a table on the screen, and a picture of slip and drift against the step."""
    from matplotlib import pyplot as plt
    with open(Path(output) / "suspension_against_dpmfoam.csv", "w", newline="") as file:
        csv.writer(file).writerows([rows[0].keys(), *(r.values() for r in rows)])
    print(f"{'scheme':<22} {'dt*':>6}  slip [m/s]        against small step  drift/weight  seconds")
    for r in rows:
        print(f"{r['scheme']:<22} {r['dt_star']:6g}  " + (
            f"{r['slip']:.3f} +- {r['slip_standard_error']:.3f}    {r['against_small_step']:+7.1%} +- "
            f"{r['against_small_step_standard_error']:.1%}    {r['drift_over_weight']:9.1e} {r['seconds']:8.2f}"
                                                          if r["stable"] else "unstable"))
    figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    for scheme in dict.fromkeys(r["scheme"] for r in rows):
        good = [r for r in rows if r["scheme"] == scheme and r["stable"]]
        axes[0].errorbar([r["dt_star"] for r in good], [100 * r["against_small_step"] for r in good],
                         [100 * np.nan_to_num(r["against_small_step_standard_error"]) for r in good], marker="o", capsize=3,
                         label=scheme)
        axes[1].loglog([r["dt_star"] for r in good], [r["drift_over_weight"] for r in good], marker="o", label=scheme)
    axes[0].set(xscale="log", xlabel="step / tau_f", ylabel="slip against small step [%]")
    axes[1].set(xlabel="step / tau_f", ylabel="momentum drift / weight")
    axes[1].legend()
    figure.savefig(Path(output) / "suspension_against_dpmfoam.png", dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    main(**vars(arguments().parse_args()))
