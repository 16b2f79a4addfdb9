"""Error of the slip velocity against run time: coupling schemes x time steps x meshes, against a fine reference."""
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
from demos.sedimenting_suspension import Suspension

matplotlib.use("Agg")
SUB_CYCLED = {"sub_cycled": ("conservative", 4), "by_courant": ("conservative", None)}  # scheme, steps of the fluid in one
LEAST_STEPS = 40  # to call a step stable; those beyond the end time are not timed and not in the error


def arguments():
    """Command line of the demo."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    p.add_argument("--schemes", nargs="+", default=["conservative", *SUB_CYCLED, "explicit", "implicit", "split"],
                   help="coupling schemes; sub_cycled: conservative with four steps of the fluid in one, by_courant: with "
                   "as many as its Courant number asks for")
    p.add_argument("--dt-star", type=float, nargs="+", default=[0.02, 0.05, 0.1, 0.2, 0.4375, 1.0, 2.0, 4.0, 8.0, 17.5,
                                                                1000.0],
                   help="time steps in fluid relaxation times of eq. 10")
    p.add_argument("--cells", type=int, nargs="+", default=[4], help="cubes across the box, each value one mesh")
    p.add_argument("--box", type=float, default=32.0, help="edge of the cubic box in particle diameters")
    p.add_argument("--smoothing-length", type=float, help="in particle diameters; absent: no smoothing")
    p.add_argument("--end-time", type=float, default=0.06, help="simulated time of every run [s]")
    p.add_argument("--seeds", type=int, default=2, help="realisations; the error is their root mean square")
    p.add_argument("--reference-dt-star", type=float, default=0.02, help="step of the reference, conservative scheme")
    p.add_argument("--output", default="out/error_against_run_time", help="folder for results")
    return p


def suspension(scheme, box, cells, seed, drag="beetstra", smoothing_length=None, coarse_graining=1.0):
    """A suspension of 150 um particles for a scheme or one of SUB_CYCLED; box and cells have three values."""
    scheme, fluid_steps = SUB_CYCLED.get(scheme, (scheme, 1))
    return Suspension(150e-6, 1500.0, 0.1, box, cells, scheme, drag, "overlap_volume", "cell",
                      smoothing_length, coarse_graining, False, seed, fluid_steps)


def slip_history(scene, dt_star, end_time):
    """Times, slip velocities, drift over weight, stability and processor time of one run."""
    tau_f = float(fe_el.time_scales.fluid_relaxation_time(150e-6, 1.3, 1.8e-5, scene.solid))
    steps = max(round(end_time / (dt_star * tau_f)), 1)
    dt = end_time / steps
    scene.coupling.to_fluid(dt)
    before, history, start = scene.momentum(), [(0.0, scene.mean_slip())], time.process_time()
    for k in range(max(steps, LEAST_STEPS)):
        if k == steps:
            cost = time.process_time() - start
        try:
            scene.advance(dt)
        except (FloatingPointError, fe_el.SolverDiverged, fe_el.LostParticle):
            return np.array(history), np.nan, False, time.process_time() - start
        history.append(((k + 1) * dt, scene.mean_slip()))
        if not abs(history[-1][1]) < 10 * scene.slip:
            return np.array(history), np.nan, False, time.process_time() - start
    cost = cost if steps < LEAST_STEPS else time.process_time() - start
    drift = np.abs(scene.momentum() - before).max() / (scene.weight * history[-1][0])
    return np.array(history[:steps + 1]), drift, True, cost


def main(schemes=("conservative", *SUB_CYCLED, "explicit", "implicit", "split"),
         dt_star=(0.02, 0.05, 0.1, 0.2, 0.4375, 1.0, 2.0, 4.0, 8.0, 17.5, 1000.0),
         cells=(4,), box=32.0, smoothing_length=None, end_time=0.06, seeds=2, reference_dt_star=0.02,
         output="out/error_against_run_time", progress=True):
    """Run all combinations and return the summary."""
    logging.getLogger().setLevel(logging.WARNING)
    comm, start = MPI.COMM_WORLD, time.perf_counter()

    def history_of(scheme, step, n, seed, time=end_time):
        return slip_history(suspension(scheme, (box,) * 3, (n,) * 3, seed, smoothing_length=smoothing_length), step, time)
    history_of("conservative", 1.0, cells[0], 1, end_time / 50)  # compile before anything is timed
    jobs = [(n, seed) for n in cells for seed in range(1, seeds + 1)]
    bar = tqdm(total=len(jobs) * (1 + len(schemes) * len(dt_star)), disable=not progress or comm.rank > 0, unit="run")
    errors, means, costs, drifts, stables = {}, {}, {}, {}, {}
    for n, seed in jobs:
        reference = history_of("conservative", reference_dt_star, n, seed)[0]
        bar.update()
        for scheme in schemes:
            for step in dt_star:
                history, drift, stable, cost = history_of(scheme, step, n, seed)
                exact = np.interp(history[:, 0], reference[:, 0], reference[:, 1])
                error = np.sqrt(np.mean((history[1:, 1] / exact[1:] - 1) ** 2)) if stable else np.inf
                late, later = history[:, 0] >= 0.5 * end_time, reference[:, 0] >= 0.5 * end_time
                mean = history[late, 1].mean() / reference[later, 1].mean() - 1 if stable else np.inf
                for store, value in ((errors, error), (means, mean), (costs, cost), (drifts, drift), (stables, stable)):
                    store.setdefault((n, scheme, step), []).append(value)
                bar.update()
    bar.close()
    rows = [{"cells": n, "scheme": scheme, "dt_star": step, "stable": all(stables[key]),
             **dict(zip(("slip_error", "standard_error"), root_mean_square(errors[key]))),
             "mean_slip_error": float(np.mean(means[key])),
             "drift_over_weight": float(np.mean(drifts[key])),
             "seconds": float(np.median(costs[key]))} for key in errors for n, scheme, step in [key]]
    numbers = {"wall_time": time.perf_counter() - start, "seeds": seeds, "end_time": end_time}
    for scheme in schemes:
        good = [r for r in rows if r["scheme"] == scheme and r["stable"]]
        numbers[f"largest_stable_dt_star_{scheme}"] = max([r["dt_star"] for r in good], default=0.0)
        close = []  # up to the first step whose error is larger
        for r in sorted(good, key=lambda r: (r["dt_star"], r["cells"])):
            if abs(r["mean_slip_error"]) >= 0.05:
                break
            close.append(r)
        numbers[f"largest_dt_star_within_5_percent_{scheme}"] = max([r["dt_star"] for r in close], default=0.0)
        numbers[f"seconds_within_5_percent_{scheme}"] = min([r["seconds"] for r in close], default=float("nan"))
        numbers[f"drift_over_weight_{scheme}"] = max([r["drift_over_weight"] for r in good], default=float("nan"))
    if comm.rank == 0:
        Path(output).mkdir(parents=True, exist_ok=True)
        table(output, rows)
        picture(output, rows)
    return fe_el.write_summary(output, comm, **numbers)


def root_mean_square(values):
    """Root mean square over the realisations and its standard error; that of one is not known."""
    squares = np.square(values)
    rms = float(np.sqrt(squares.mean()))
    if len(squares) < 2 or not np.isfinite(rms):
        return rms, float("nan")
    return rms, float(squares.std(ddof=1) / np.sqrt(len(squares)) / (2 * rms or 1.0))


def table(output, rows):
    """CSV, and the same as a table on the screen."""
    with open(Path(output) / "error_against_run_time.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)
    print(f"{'cells':>5} {'scheme':<20} {'dt*':>8} {'stable':>6} {'slip error':>11} {'+-':>8} {'of its mean':>11} "
          f"{'drift/weight':>12} {'seconds':>8}")
    for r in rows:
        print(f"{r['cells']:5d} {r['scheme']:<20} {r['dt_star']:8.4g} {r['stable']!s:>6} {r['slip_error']:11.2e} "
              f"{r['standard_error']:8.1e} {r['mean_slip_error']:+11.2e} "
              f"{r['drift_over_weight']:12.1e} {r['seconds']:8.2f}")


def picture(output, rows):
    """PNG: error against processor time, log-log, one curve per scheme and mesh."""
    from matplotlib import pyplot as plt
    figure, axis = plt.subplots(figsize=(7, 5))
    for key in dict.fromkeys((r["scheme"], r["cells"]) for r in rows):
        curve = sorted((r["seconds"], r["slip_error"]) for r in rows if (r["scheme"], r["cells"]) == key and r["stable"]
                       and r["slip_error"] > 0)  # zero: the reference itself
        if curve:
            axis.loglog(*zip(*curve), marker="o", label=f"{key[0]}, {key[1]} cubes across")
    axis.axhline(0.05, color="k", lw=0.6, ls=":")
    axis.set(xlabel="processor time [s]", ylabel="error of the slip velocity")
    axis.grid(alpha=0.3, which="both")
    axis.legend()
    figure.tight_layout()
    figure.savefig(Path(output) / "error_against_run_time.png", dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    summary = main(**vars(arguments().parse_args()))
    if MPI.COMM_WORLD.rank == 0:
        for key, value in summary.items():
            print(f"{key:48s} {value}")
