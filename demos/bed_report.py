"""Error against wall time of the fluidised bed: over fluid step, contact steps and cell size (``fluidised_bed.py
--report``)."""
import sys
from pathlib import Path

import numpy as np
from mpi4py import MPI

import fe_el

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from demos import fluidised_bed, reports

SETTINGS = ((1e-4, 50, 0.0075), (1e-4, 20, 0.0075), (2e-4, 20, 0.0075), (5e-4, 20, 0.0075), (1e-3, 50, 0.0075),
            (1e-3, 20, 0.0075),
            (1e-3, 12, 0.0075), (2e-3, 20, 0.0075), (1e-3, 20, 0.005), (1e-3, 20, 0.01))  # the first is the reference
QUANTITIES = ("pressure_drop", "pressure_drop_fluctuation", "mean_height_small", "mean_height_large")


def main(options, settings=SETTINGS, realisations=3):
    """Run every setting from ``realisations`` starts and return the summary; half an hour for a tenth of the bed.

    Means are over the second half of each run; their errors are standard errors over the realisations. The wall time is that
    of
    the run without its first tenth of a second of compilation: of all stages but the rest.
    """
    folder, left_out = Path(options["output"]), ("report", "output", "seed", "restart")
    options = {k: v for k, v in options.items() if k not in left_out}
    rows = []
    for dt, steps, size in settings:
        runs = []
        for seed in range(1, realisations + 1):
            chosen = options | {"time_step": dt, "steps_per_contact": steps, "cell_size": size, "seed": seed,
                                "record_every": max(round(1e-2 / dt), 1)}
            runs.append(fluidised_bed.main(**chosen, output=folder / f"{dt:g}_{steps}_{size:g}_{seed}"))
        rows.append({"time_step_s": dt, "steps_per_contact": steps, "cell_size_m": size,
                     "seconds": np.median([r["wall_time"] - r["seconds_rest"] for r in runs]),
                     "weight_Pa": runs[0]["bed_weight_per_area"], "lost": sum(r["lost_particles"] for r in runs)})
        for name in QUANTITIES:
            values = np.array([r[name] for r in runs])
            rows[-1] |= {name: values.mean(), name + "_error": values.std(ddof=1) / np.sqrt(len(values)) if len(values) > 1
                         else 0.0}
        if MPI.COMM_WORLD.rank == 0:
            reports.write(folder, rows)
    if MPI.COMM_WORLD.rank == 0:
        picture(folder, rows)
    best = recommended(rows)
    return fe_el.write_summary(folder, MPI.COMM_WORLD, recommended_time_step=best["time_step_s"], realisations=realisations,
                               recommended_steps_per_contact=best["steps_per_contact"],
                               recommended_cell_size=best["cell_size_m"],
                               recommended_seconds=best["seconds"], reference_seconds=rows[0]["seconds"])


def deviations(row, reference):
    """Each quantity's deviation from the reference, in its standard errors and relative to it (pressures: to the weight)."""
    out = {}
    for name in QUANTITIES:
        scale = reference["weight_Pa"] if name.startswith("pressure") else reference[name]
        error = np.hypot(row[name + "_error"], reference[name + "_error"])
        out[name] = (row[name] - reference[name]) / scale, error / scale
    return out


def recommended(rows):
    """The cheapest setting whose quantities all lie within two standard errors, or 3 %, of those of the reference."""
    good = [r for r in rows if all(abs(d) < max(2 * e, 0.03) for d, e in deviations(r, rows[0]).values())]
    return min(good, key=lambda r: r["seconds"])


def picture(folder, rows):
    """PNG: deviation of each quantity from the reference against wall time."""
    from matplotlib import pyplot as plt
    figure, axes = plt.subplots(2, 2, figsize=(11, 7), sharex=True, layout="constrained")
    for axis, name in zip(axes.ravel(), QUANTITIES):
        for row in rows:
            value, error = deviations(row, rows[0])[name]
            axis.errorbar(row["seconds"], 100 * value, 100 * error, fmt="o", capsize=3)
            axis.annotate(f"{1e3 * row['time_step_s']:g} ms, {row['steps_per_contact']}, {1e3 * row['cell_size_m']:g} mm",
                          (row["seconds"], 100 * value), xytext=(4, 4), textcoords="offset points", fontsize=7)
        axis.axhline(0, color="0.6", lw=0.8)
        axis.set(xscale="log", title=name.replace("_", " "), ylabel="deviation [%]"
                 + (" of the weight" if "pressure" in name else ""))
    for axis in axes[1]:
        axis.set_xlabel("wall time of a run [s]")
    figure.suptitle("fluid step, steps in a contact, cell size; error bars: standard errors over the realisations")
    figure.savefig(folder / "report.png", dpi=100)
    plt.close(figure)
