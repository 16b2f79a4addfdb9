"""Stability of the fluid alone: one parameter at a time over its range, and whether the kinetic energy stays bounded.

The energy is 0.5 rho phi V |u|^2 summed over cells. Each scene starts from a vortex free of divergence, with and
without a rough part in the cells. Unforced scenes must never exceed the energy they start from; forced ones (moving void
fraction, inlet) must not keep growing.
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
from demos.benchmarks.stability_scenes import AXES, Scene, least_angle

matplotlib.use("Agg")
ROUNDING, STARTS = 1e-8, {"rough": 0.3, "smooth": 0.0}  # relative rise that counts; roughness of the start [m/s]


def arguments():
    """Command line of the demo."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    p.add_argument("--axes", nargs="+", choices=list(AXES), default=list(AXES), help="what is varied")
    p.add_argument("--steps", type=int, default=300, help="of every case")
    p.add_argument("--cells", type=int, default=16, help="crossed squares across the box")
    p.add_argument("--coupled", action="store_true", help="fluid and particles together, forty steps of every case")
    p.add_argument("--output", default="out/stability_map", help="folder for results")
    return p


def run(axis, value, start, steps, cells, time_order=2):
    """One row of the map."""
    scene, tick, reason = Scene(cells, time_order, STARTS[start], **AXES[axis][2](value)), time.perf_counter(), ""
    energy = [scene.energy()]
    for _ in range(steps):
        try:
            scene.advance()
        except (fe_el.SolverDiverged, FloatingPointError, ValueError) as error:
            reason = f"{type(error).__name__}: {str(error)[:60]}"
            break
        energy.append(scene.energy())
        if not energy[-1] < 1e6 * energy[0]:
            reason = "energy beyond a million times the initial one"
            break
    e = np.array(energy) / energy[0]
    floor, late = np.maximum(e[:-1], 1e-12), e[len(e) // 2:].max()  # what is left below that is rounding
    forced = scene.case["motion"] or scene.case["swirl"]
    bounded = not reason and bool(late < 2 * e[:len(e) // 2 + 1].max() if forced else e.max() <= 1 + ROUNDING)
    return {"axis": axis + ("" if time_order == 2 else " (first order)"), "start": start,
            "value": least_angle(scene.air) if axis == "slivers" else value, "steps": len(e) - 1,
            "max_energy": float(e.max()),
            "end_energy": float(e[-1]), "largest_rise": float(np.max(np.diff(e) / floor, initial=-1.0)),
            "growth_from_least": float(np.max(e[1:] / np.minimum.accumulate(floor), initial=0.0)), "bounded": bounded,
            "fallbacks": scene.fallbacks(), "seconds": time.perf_counter() - tick, "reason": reason}


def main(axes=tuple(AXES), steps=300, cells=16, output="out/stability_map", progress=True):
    """Run all cases, those whose energy rises in first order as well, and return the summary."""
    logging.getLogger().setLevel(logging.WARNING)
    comm, begin, rows = MPI.COMM_WORLD, time.perf_counter(), []
    cases = [(axis, value, start) for axis in axes for start in STARTS for value in AXES[axis][1]
             if not (axis == "outlet" and start == "rough")]
    for case in tqdm(cases, disable=not progress or comm.rank > 0, unit="case"):
        rows.append(run(*case, steps, cells))
        if not rows[-1]["bounded"] or rows[-1]["largest_rise"] > ROUNDING:
            rows.append(run(*case, steps, cells, 1))
    numbers = {"wall_time": time.perf_counter() - begin, "steps": steps, "cells": cells, "cases": len(rows),
               "bounded": sum(r["bounded"] for r in rows)}
    for name in dict.fromkeys(r["axis"] for r in rows):
        mine, key = [r for r in rows if r["axis"] == name], name.replace(" (first order)", "_first_order")
        numbers[f"not_bounded_{key}"] = sum(not r["bounded"] for r in mine)
        numbers[f"max_energy_{key}"] = max(r["max_energy"] for r in mine)
    if comm.rank == 0:
        Path(output).mkdir(parents=True, exist_ok=True)
        table(output, rows)
        picture(output, rows)
    return fe_el.write_summary(output, comm, **numbers)


def table(output, rows):
    """CSV, and the same as a table on the screen."""
    with open(Path(output) / "stability_map.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)
    print(f"{'axis':<29} {'start':<6} {'value':>14} {'steps':>5} {'max energy':>12} {'end energy':>10} {'rise':>8} "
          f"{'growth':>8} "
          f"{'bounded':>7} {'fallbacks':>9} {'seconds':>7} reason")
    for r in rows:
        value = r["value"] if isinstance(r["value"], str) else f"{r['value']:.3g}"
        print(f"{r['axis']:<29} {r['start']:<6} {value:>14} {r['steps']:5d} {r['max_energy']:12.8g} {r['end_energy']:10.3e} "
              f"{r['largest_rise']:+8.1e} {r['growth_from_least']:8.3g} {r['bounded']!s:>7} {r['fallbacks']:9d} "
              f"{r['seconds']:7.2f} {r['reason']}")


def picture(output, rows):
    """PNG: one panel per axis, largest energy over the initial one; green marks are bounded, red crosses are not."""
    from matplotlib import pyplot as plt
    names = list(dict.fromkeys(r["axis"].split(" (")[0] for r in rows))
    across = min(4, len(names))
    down = -(-len(names) // across)
    figure, panels = plt.subplots(down, across, figsize=(3.8 * across, 2.7 * down), squeeze=False, layout="constrained")
    for panel in panels.flat[len(names):]:
        panel.set_visible(False)
    for name, panel in zip(names, panels.flat):
        mine = [r for r in rows if r["axis"].split(" (")[0] == name]
        for r in mine:
            mark = "s" if "(" in r["axis"] else "o" if r["start"] == "rough" else "D"
            panel.plot(r["value"], r["max_energy"], mark if r["bounded"] else "x", mfc="none",
                       ms={"s": 9, "D": 4}.get(mark, 6),
                       color="tab:green" if r["bounded"] else "tab:red")
        if mine[0]["value"] == 0:
            panel.set_xscale("symlog", linthresh=1e-3)
        elif not isinstance(mine[0]["value"], str):
            panel.set_xscale("log")
        largest = max(r["max_energy"] for r in mine)
        if largest > 10:
            panel.set_yscale("log")
        elif largest < 1.01:
            panel.set_ylim(0.99, 1.01)
        panel.tick_params(labelsize=7)
        panel.set_xlabel(AXES[name][0], fontsize=9)
        panel.grid(alpha=0.3)
    for row in panels:
        row[0].set_ylabel("max energy / initial", fontsize=9)
    figure.suptitle("green: bounded, red cross: not; circle: rough start, diamond: smooth, square: first order", fontsize=10)
    figure.savefig(Path(output) / "stability_map.png", dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    options = vars(arguments().parse_args())
    if options.pop("coupled"):
        from demos.benchmarks import coupled_map
        summary = coupled_map.main(output=options["output"])
    else:
        summary = main(**options)
    if MPI.COMM_WORLD.rank == 0:
        for key, value in summary.items():
            print(f"{key:48s} {value}")
