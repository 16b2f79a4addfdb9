"""Error of the Salzman jet's penetration against its cost, over coarse graining, mesh, step and smoothing (``salzman_jet.py
--report``)."""
import csv
from pathlib import Path

import numpy as np
from mpi4py import MPI

import fe_el
from demos import salzman_jet as jet

# edges across the nozzle, coarse graining, step [s], whether smoothed; the first, with the finest mesh, is the reference
SETTINGS = ((4, 25, 7.5e-5, True), (4, 25, 1.5e-4, True), (4, 25, 3e-4, True),
            (3, 25, 1e-4, True), (3, 25, 2e-4, True), (3, 25, 4e-4, True), (2, 25, 1.5e-4, True), (2, 25, 3e-4, True),
            (3, 5, 1e-4, True), (3, 10, 1e-4, True), (3, 40, 1e-4, True), (3, 60, 1e-4, True),
            (4, 60, 7.5e-5, True),
            (3, 25, 1e-4, False), (3, 40, 1e-4, False), (3, 60, 1e-4, False), (4, 25, 7.5e-5, False))
PLACES = [f"at_{1e3 * way:g}_mm" for way in jet.STATIONS]
WITHIN = 0.03  # of the reference: what counts as its answer


def main(options, settings=SETTINGS):
    """Run every setting and return the summary; the table is ``report.csv``, the picture ``report.png``.

    Penetration is the mean height over that of Stokes' drag at the stations, its error the standard error of blocks of time.
    Cost is the processor time of all ranks for the steps, without the mesh; wall time stands beside it, for what it is worth
    on a machine that does other work.
    """
    folder, rows = Path(options["output"]), []
    left_out = "output", "coarse_graining", "cells", "time_step", "restart"
    length, options = options["smoothing_length"], {k: v for k, v in options.items() if k not in left_out}
    for cells, ratio, dt, smoothed in settings:
        name = f"{cells:g}_{ratio:g}_{dt:g}_{'smoothed' if smoothed else 'none'}"
        chosen = options | {"smoothing_length": length if smoothed else 0.0}
        summary = jet.main((ratio,), cells=cells, time_step=dt, output=folder / name, **chosen)
        rows.append(row_of({k.removeprefix(f"coarse_graining_{ratio:g}_"): v for k, v in summary.items()}, cells, ratio))
        if MPI.COMM_WORLD.rank == 0:
            write(folder, rows)
    if MPI.COMM_WORLD.rank == 0:
        picture(folder, rows)
    return fe_el.write_summary(folder, MPI.COMM_WORLD, runs=len(rows), in_words=in_words(rows))


def row_of(numbers, cells, ratio):
    """What the table says of a run."""
    row = {"edges_across_nozzle": cells, "coarse_graining": ratio, "time_step_s": numbers["time_step"],
           "smoothing_length_m": numbers["smoothing_length"], "cells": numbers["cells"], "parcels": numbers["parcels"],
           "courant": numbers["courant"]}
    for way, place in zip(jet.STATIONS, PLACES):
        stokes = float(jet.stokes_height(way))
        row |= {f"over_stokes_{place}": numbers[f"over_stokes_{place}"],
                f"error_{place}": numbers[f"height_error_{place}"] / stokes}
    return row | {"processor_s": numbers["processor_time"], "wall_s": numbers["wall_time"],
                  "share_of_smoothing": numbers.get("seconds_smoothing", 0.0) / numbers["wall_time"]}


def deviation(row, reference):
    """Root mean square over the stations of the relative deviation from the reference, and its standard error."""
    values = np.array([[r[f"{what}_{place}"] for place in PLACES] for r in (row, reference)
                       for what in ("over_stokes", "error")])
    relative = values[0] / values[2] - 1
    size = float(np.sqrt((relative ** 2).mean()))
    error = np.hypot(values[1], values[3]) / values[2]
    return size, float(np.sqrt((error ** 2).mean()))


def recommended(rows):
    """The cheapest run that deviates from the reference by no more than 3 %, or two standard errors."""
    def good(row):
        size, error = deviation(row, rows[0])
        return size <= max(WITHIN, 2 * error)
    return min(filter(good, rows), key=lambda r: r["processor_s"])


def in_words(rows):
    """Which setting buys most accuracy per second."""
    best, reference = recommended(rows), rows[0]
    size, error = deviation(best, reference)
    cells, ratio, step, seconds = (best[k] for k in ("edges_across_nozzle", "coarse_graining", "time_step_s", "processor_s"))
    smoothing = "with" if best["smoothing_length_m"] else "without"
    return (f"{cells:g} edges across the nozzle, coarse graining {ratio:g} and steps of {1e3 * step:g} ms {smoothing} "
            f"smoothing buy most: {100 * size:.1f} +- {100 * error:.1f} % from the reference in {seconds:.0f} s of "
            f"processor time, where that took {reference['processor_s']:.0f} s.")


def write(folder, rows):
    """CSV of all settings so far, with their deviation from the first."""
    with open(folder / "report.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, [*rows[0], "deviation", "deviation_error"], restval="")
        writer.writeheader()
        for row in rows:
            size, error = deviation(row, rows[0])
            writer.writerow({k: f"{v:.6g}" for k, v in {**row, "deviation": size, "deviation_error": error}.items()})


def picture(folder, rows):
    """PNG: deviation from the reference against processor time, and the penetration over coarse graining."""
    from matplotlib import pyplot as plt
    figure, (left, right) = plt.subplots(1, 2, figsize=(13, 5.5), layout="constrained")
    markers, colours = dict(zip(sorted({r["edges_across_nozzle"] for r in rows}), "v^os*")), {}
    for k, ratio in enumerate(sorted({r["coarse_graining"] for r in rows})):
        colours[ratio] = f"C{k}"
    for row in rows[1:]:
        size, error = deviation(row, rows[0])
        colour, smoothed = colours[row["coarse_graining"]], row["smoothing_length_m"] > 0
        left.errorbar(row["processor_s"], 100 * size, 100 * error, color=colour, capsize=2, ms=7,
                      fmt=markers[row["edges_across_nozzle"]], mfc=colour if smoothed else "none")
        if row["coarse_graining"] == 25 and smoothed:
            left.annotate(f"{1e3 * row['time_step_s']:g} ms", (row["processor_s"], 100 * size), xytext=(5, 5),
                          textcoords="offset points", fontsize=7)
    for cells, marker in markers.items():
        left.plot([], [], marker, color="0.4", label=f"{cells:g} edges across the nozzle")
    for ratio, colour in colours.items():
        left.plot([], [], "s", color=colour, label=f"coarse graining {ratio:g}")
    left.plot([], [], "o", color="0.4", mfc="none", label="not smoothed")
    left.axhline(100 * WITHIN, color="0.6", lw=0.8)
    left.set(xscale="log", yscale="log", ylim=(0.5, 100), xlabel="processor time [s]",
             ylabel="deviation of the penetration [%]",
             title="from the finest run, root mean square of three stations")
    left.legend(fontsize=7)
    for place, colour in zip(PLACES, ("C0", "C1", "C2")):
        for cells, marker in markers.items():
            for smoothed in (True, False):
                some = sorted((r["coarse_graining"], r["time_step_s"], r[f"over_stokes_{place}"], r[f"error_{place}"])
                              for r in rows
                              if r["edges_across_nozzle"] == cells and smoothed == (r["smoothing_length_m"] > 0))
                finest = {a: (b, c) for a, _, b, c in reversed(some)}
                if finest:
                    right.errorbar(list(finest), *np.array(list(finest.values())).T, color=colour, marker=marker, capsize=2,
                                   ls="-" if smoothed else ":", mfc=colour if smoothed else "none",
                                   label=f"{place.replace('_', ' ')}, {cells:g} edges{'' if smoothed else ', not smoothed'}")
    right.set(xscale="log", xlabel="parcel over particle diameter", ylabel="mean height over Stokes' drag", ylim=(1, None))
    right.set_xticks(list(colours), [f"{ratio:g}" for ratio in colours])
    right.minorticks_off()
    right.legend(fontsize=6, ncols=2)
    figure.savefig(folder / "report.png", dpi=110)
    plt.close(figure)
