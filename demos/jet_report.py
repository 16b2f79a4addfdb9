"""Schemes of the jet in cross flow beside each other, and what the paper leaves open varied (option ``--report``)."""
import csv
from pathlib import Path

import numpy as np
from mpi4py import MPI

import fe_el
from demos import jet_in_cross_flow as jet

PAPERS, SMALL = 4.9e-5, 1e-5  # the paper's steps, of implicit schemes and of explicit coupling [s]
RUNS = {
    "schemes": (("conservative", PAPERS, {}), ("split", PAPERS, {}), ("implicit", PAPERS, {}),
                ("conservative", 5 * PAPERS, {}), ("conservative", 20 * PAPERS, {}), ("conservative", 40 * PAPERS, {}),
                ("split", 2 * PAPERS, {}), ("implicit", 2 * PAPERS, {}), ("split", 3 * PAPERS, {}),
                ("implicit", 3 * PAPERS, {}), ("explicit", 2 * SMALL, {}), ("explicit", SMALL, {}),
                ("explicit", 1.5 * SMALL, {})),
    "left-open": (("conservative", PAPERS, {}), ("conservative", PAPERS, {"slot_air": 0.0}),
                  ("conservative", PAPERS, {"slot": (0.2, 0.025)}), ("conservative", PAPERS, {"slot": (0.4, 0.05)}),
                  ("conservative", PAPERS, {"coarse_graining": 30.0}),
                  ("conservative", PAPERS, {"smoothing_length": 3.0}), ("conservative", PAPERS, {"closure": "vreman"}))}
LOW = 0.1  # height below which the velocity beside the floor is averaged [m]


def main(options, runs=RUNS["schemes"]):
    """Run all and return the summary; the table is ``report.csv``.

    Columns: largest imbalance of forces over their sum (mean over the second half), mean height of the particles behind 1 m,
    mean velocity of the air below 0.1 m at the stations, root mean square of the profiles' difference from the first run's.
    """
    folder, rows, first = Path(options["output"]), [], None
    options = {k: v for k, v in options.items() if k not in ("output", "coupling", "time_step", "output_every")}
    for k, (scheme, step, changes) in enumerate(runs):
        where = folder / f"{k:02d}_{scheme}_{step:g}"
        summary = jet.main(coupling=scheme, time_step=step, output=where, output_every=None, **(options | changes))
        row = {"coupling": scheme, "time_step_s": step, "changed": "; ".join(f"{a} {b}" for a, b in changes.items())}
        row |= {name: summary.get(name) for name in (
            "cells", "stable", "courant", "third_law_error", "third_law_error_of_means", "largest_third_law_error",
            "penetration", "penetration_error", "processor_milliseconds_per_step", "wall_time", "steps", "parcels",
            "mass_balance")}
        if MPI.COMM_WORLD.rank == 0:
            profile = read(where / "profiles.csv") if summary.get("penetration") is not None else None
            first = profile if first is None else first
            row |= of_profile(profile, first)
            rows.append(row)
            with open(folder / "report.csv", "w", newline="") as file:
                writer = csv.DictWriter(file, list(rows[0]))
                writer.writeheader()
                writer.writerows(rows)
    return fe_el.write_summary(folder, MPI.COMM_WORLD, runs=len(runs), stable_runs=sum(bool(r["stable"]) for r in rows))


def read(path):
    """Heights (n,), and velocities and their errors (n, stations), of a table of profiles."""
    rows = np.genfromtxt(path, delimiter=",", skip_header=1)
    return rows[:, 0], rows[:, 1::2], rows[:, 2::2]


def of_profile(profile, first):
    """What the table says of profiles; nothing of a run that was not stable."""
    names = [f"{what}_below_{LOW:g}_m_at_{x:g}_m" for x in jet.STATIONS for what in ("velocity", "velocity_error")]
    if profile is None:
        return dict.fromkeys([*names, "profile_difference_m_s"])
    height, velocity, error = profile
    low = height < LOW
    numbers = [a for pair in zip(velocity[low].mean(0), error[low].mean(0)) for a in pair]
    difference = float(np.sqrt(((velocity - first[1]) ** 2).mean())) if first is not None else np.nan
    return dict(zip(names, numbers)) | {"profile_difference_m_s": difference}
