"""Error of a demo's headline quantities against what a run costs, over steps, meshes, parcels, schemes (``--report``)."""
import csv
import inspect
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from mpi4py import MPI

import fe_el


class Report(NamedTuple):
    """What a demo's report varies, and what it is compared with.

    Attributes:
        settings: options of ``main`` that each run has for itself. One that differs from the reference in its ``seed`` alone
            shows how far chance takes a quantity.
        quantities: names in the summary, each with its right value: a number (0: the quantity is itself the error), the name
            of another value of the same summary, or ``None``: the value of the reference setting.
        same: options that all runs share.
        first: options of a run before all others, which is not counted: it compiles and loads the kernels.
        within: error that is good enough.
        reference: number of the reference setting.
    """

    settings: tuple
    quantities: dict
    same: dict = {}
    first: dict = {}
    within: float = 0.02
    reference: int = 0


def run(main, report, folder, options=None):
    """Run all settings and return the summary; writes ``report.csv`` and ``report.png`` into the folder.

    Cost is the processor time of all ranks for the steps, without mesh and compilation; wall time stands beside it.

    Args:
        main: of a demo.
        report (Report): what to vary.
        options: of all runs, in place of the report's own.

    Note:
        Collective.
    """
    folder, same = Path(folder), report.same | (options or {})
    main(**(same | report.settings[-1] | report.first), output=folder / "first")
    varied = list(dict.fromkeys(name for setting in report.settings for name in setting))
    runs = [main(**(same | setting), output=folder / f"{k:02d}") for k, setting in enumerate(report.settings)]
    rows = [row_of(main, same | setting, numbers, report, varied, runs[report.reference])
            for setting, numbers in zip(report.settings, runs)]
    words, best = in_words(rows, report, varied)
    if MPI.COMM_WORLD.rank == 0:
        write(folder, rows)
        picture(folder, rows, report, varied, words)
    return fe_el.write_summary(folder, MPI.COMM_WORLD, runs=len(rows), recommended=best, in_words=words)


def row_of(main, options, numbers, report, varied, reference):
    """What the table says of a run: its options, quantities with their right values and errors, largest error and cost."""
    defaults = inspect.signature(main).parameters
    row = {name: options[name] if name in options else defaults[name].default for name in varied}
    row = {name: "x".join(map(str, value)) if isinstance(value, (tuple, list)) else value for name, value in row.items()}
    errors = []
    for name, right in report.quantities.items():
        right = reference.get(name, np.nan) if right is None else numbers[right] if isinstance(right, str) else right
        value = numbers.get(name, np.nan)  # a run that was too short or broke off has none
        errors.append(float(np.nan_to_num(abs(value - right) / (abs(right) or 1.0), nan=np.inf)))
        row |= {name: value, f"{name}_reference": right, f"{name}_error": errors[-1]}
    error = max(errors) if numbers.get("stable", True) else np.inf
    return row | {"error": error, "processor_s": numbers["processor_time"], "wall_s": numbers["wall_time"]}


def chance(rows, report):
    """Number of the run that repeats the reference from another seed, and how far it lies from it; ``None``, 0 without."""
    first = report.settings[report.reference]
    for k, setting in enumerate(report.settings):
        if {n for n in setting.keys() | first.keys() if setting.get(n) != first.get(n)} == {"seed"}:
            a, b = rows[report.reference], rows[k]
            return k, max(abs(a[n] - b[n]) / (abs(a[f"{n}_reference"]) or 1.0) for n in report.quantities)
    return None, 0.0


def label(row, varied):
    """The options of a run in a few characters."""
    return ", ".join(f"{row[n]:g}" if isinstance(row[n], float) else str(row[n]) for n in varied)


def in_words(rows, report, varied):
    """The sentence that says which setting to choose, the cheapest that is near enough, and its number."""
    repeated, spread = chance(rows, report)
    allowed = max(report.within, spread)
    tried = [k for k in range(len(rows)) if k != repeated]
    good = [k for k in tried if rows[k]["error"] <= allowed]
    best = min(good, key=lambda k: rows[k]["processor_s"]) if good else min(tried, key=lambda k: rows[k]["error"])
    names, row = ", ".join(n.replace("_", " ") for n in varied), rows[best]
    own = None in report.quantities.values()
    against = f"the reference run ({label(rows[report.reference], varied)})" if own else "the published values"
    verdict = "the cheapest" if good else "the nearest, but not"
    other_seed = f" (another seed alone: {100 * spread:.2g} %)" if spread else ""
    return (f"Choose {label(row, varied)} ({names}): {verdict} within {100 * allowed:.2g} % of {against}{other_seed}; error "
            f"{100 * row['error']:.2g} %, processor time {row['processor_s']:.3g} s where the first setting took "
            f"{rows[0]['processor_s']:.3g} s."), best


def write(folder, rows):
    """CSV of all settings so far."""
    with open(Path(folder) / "report.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def picture(folder, rows, report, varied, words):
    """PNG: error of each quantity against processor time, log-log; each run is labelled with its options."""
    import textwrap

    from matplotlib import pyplot as plt
    figure, axis = plt.subplots(figsize=(7.5, 5), layout="constrained")
    finite = [r for r in rows if 0 < r["error"] < np.inf]
    for name, marker in zip(report.quantities, "osv^D<>"):
        some = [r for r in finite if r[f"{name}_error"] > 0]
        axis.plot([r["processor_s"] for r in some], [r[f"{name}_error"] for r in some], marker, mfc="none",
                  label=name.replace("_", " "))
    for row in finite:
        axis.annotate(label(row, varied), (row["processor_s"], row["error"]), xytext=(4, 3), textcoords="offset points",
                      fontsize=6)
    axis.axhline(max(report.within, chance(rows, report)[1]), color="0.6", lw=0.8, label="near enough")
    if rows[report.reference]["error"] == 0:
        axis.axvline(rows[report.reference]["processor_s"], color="0.6", lw=0.8, ls=":", label="the reference run")
    scale = "log" if finite else "linear"  # nothing to show: all runs broke off, or are the reference
    axis.set(xscale=scale, yscale=scale, xlabel="processor time of a run [s]", ylabel="error")
    names = ", ".join(n.replace("_", " ") for n in varied)
    axis.set_title(f"labels: {names}\n{textwrap.fill(words, 110)}", fontsize=7)
    axis.margins(x=0.15)
    axis.legend(fontsize=7)
    figure.savefig(Path(folder) / "report.png", dpi=80)
    plt.close(figure)


def start(main, parser, reports, arguments=None, width=32):
    """Run a demo from its command line, or with ``--report`` its report, and print the summary.

    With ``--report`` the other options that differ from their defaults hold for all runs in place of the report's own.
    """
    parser.add_argument("--report", nargs="?", const=next(iter(reports)), choices=list(reports),
                        help="error against run time over steps, meshes, ...: OUTPUT/report.csv, report.png")
    options = vars(parser.parse_args(arguments))
    name = options.pop("report")
    if name is None:
        summary = main(**options)
    else:
        given = {k: v for k, v in options.items() if v != parser.get_default(k)}
        folder = given.pop("output", f"{options['output']}_report_{name}")
        summary = run(main, reports[name], folder, given)
    if MPI.COMM_WORLD.rank == 0:
        for key, value in summary.items():
            print(f"{key:{width}s} {value}")
    sys.stdout.flush()
    return summary
