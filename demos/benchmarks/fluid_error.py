"""Error against run time of the fluid alone: fe_el, Taylor-Hood elements in UFL, and icoFoam where it is installed.

vortex: a Taylor-Green vortex drifts through a periodic square and decays; relative L2 error of the velocity at cell centres.
cavity: lid-driven, Reynolds number 1000, from rest to steady state; largest error on the centre lines against Botella and
Peyret (1998). The deviation from Ghia et al. (1982) is in the table as well; the two references differ by up to 0.018.
"""
import argparse
import csv
import logging
import sys
import tempfile
import time
from pathlib import Path

import matplotlib
import numpy as np
from mpi4py import MPI
from tqdm import tqdm

import fe_el

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from demos.benchmarks import fluid_error_scenes as scenes
from demos.peers import ico_foam

matplotlib.use("Agg")
SIZES = {"vortex-fe-el": (16, 32, 64, 128), "vortex-ico-foam": (16, 32, 64, 128), "vortex-taylor-hood": (4, 8, 16, 32),
         "cavity-fe-el": (16, 32, 64, 96), "cavity-ico-foam": (32, 64, 128), "cavity-taylor-hood": (8, 16, 32, 48)}


def arguments():
    """Command line of the demo."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for case, sizes in SIZES.items():
        p.add_argument(f"--{case}", type=int, nargs="*", default=sizes, help=f"squares per edge (default: {sizes})")
    p.add_argument("--end-time", type=float, default=60.0, help="end of the cavity's march to steady state (default: 60)")
    p.add_argument("--repeats", type=int, default=1, help="runs of each case; the median counts (default: 1)")
    p.add_argument("--output", default="out/fluid_error", help="folder for results (default: out/fluid_error)")
    return p


def cases(folder, end_time):
    """(scene, code) -> a function of the squares per edge, and about how many seconds it takes per cubic square."""
    return {("vortex", "fe_el"): (scenes.vortex_of_fe_el, 2e-6),
            ("vortex", "icoFoam Euler"): (lambda n: scenes.vortex_of_ico_foam(n, folder, "Euler"), 1e-6),
            ("vortex", "icoFoam backward"): (lambda n: scenes.vortex_of_ico_foam(n, folder, "backward"), 1e-6),
            ("vortex", "Taylor-Hood"): (lambda n: scenes.vortex_of_taylor_hood(n, False), 2e-4),
            ("vortex", "Taylor-Hood explicit"): (lambda n: scenes.vortex_of_taylor_hood(n, True), 1e-5),
            ("cavity", "fe_el"): (lambda n: scenes.cavity_of_fe_el(n, end_time), 4e-7 * end_time),
            ("cavity", "icoFoam Euler"): (lambda n: scenes.cavity_of_ico_foam(n, folder, end_time), 4e-7 * end_time),
            ("cavity", "Taylor-Hood"): (lambda n: scenes.cavity_of_taylor_hood(n, end_time), 2e-6 * end_time)}


def main(vortex_fe_el=SIZES["vortex-fe-el"], vortex_ico_foam=SIZES["vortex-ico-foam"],
         vortex_taylor_hood=SIZES["vortex-taylor-hood"], cavity_fe_el=SIZES["cavity-fe-el"],
         cavity_ico_foam=SIZES["cavity-ico-foam"], cavity_taylor_hood=SIZES["cavity-taylor-hood"], end_time=60.0, repeats=1,
         output="out/fluid_error", progress=True):
    """Run the comparisons, on one rank, and return the summary."""
    logging.getLogger().setLevel(logging.WARNING)
    if MPI.COMM_WORLD.size > 1:
        raise ValueError(f"There are {MPI.COMM_WORLD.size} ranks; this comparison runs on one.")
    if not end_time >= 2:
        raise ValueError(f"The end time is {end_time}; give at least 2, two steps of Taylor-Hood.")
    sizes = {"vortex fe_el": vortex_fe_el, "vortex icoFoam": vortex_ico_foam, "vortex Taylor-Hood": vortex_taylor_hood,
             "cavity fe_el": cavity_fe_el, "cavity icoFoam": cavity_ico_foam, "cavity Taylor-Hood": cavity_taylor_hood}
    start, peer, rows = time.perf_counter(), ico_foam.installed(), []
    if not peer:
        print("icoFoam is not installed (Debian: openfoam); fe_el and Taylor-Hood run without it.")
    with tempfile.TemporaryDirectory() as scratch:
        runs = [(scene, code, n, run, cost * n ** 3) for (scene, code),
                (run, cost) in cases(f"{scratch}/case", end_time).items()
                if peer or "icoFoam" not in code for n in sizes[f"{scene} {code.split()[0]}"]]
        with tqdm(total=repeats * sum(r[-1] for r in runs), disable=not progress,
                  bar_format="{desc:<32}{percentage:3.0f}%|{bar}| {elapsed}, {remaining} left") as bar:
            for scene, code, n, run, cost in runs * repeats:
                bar.set_description_str(f"{scene}, {code}, {n} x {n}")
                rows.append({"scene": scene, "code": code, "n": n, **run(n)})
                bar.update(cost)
    table = medians(rows)
    write(output, rows, table)
    numbers = {f"{scene}_{code.replace(' ', '_').replace('-', '_')}_{n}_{what}": value for (scene, code, n),
               row in table.items()
               for what, value in row.items()}
    return fe_el.write_summary(output, **numbers, end_time=end_time, repeats=repeats, wall_time=time.perf_counter() - start)


def medians(rows):
    """Cells, median seconds and errors of each scene, code and size."""
    table = {}
    for key in dict.fromkeys((r["scene"], r["code"], r["n"]) for r in rows):
        these = [r for r in rows if (r["scene"], r["code"], r["n"]) == key]
        table[key] = {k: v for k, v in these[0].items() if k not in ("scene", "code", "n")}
        table[key]["seconds"] = float(np.median([r["seconds"] for r in these]))
    return table


def write(output, rows, table):
    """CSV, table on the screen, and picture."""
    Path(output).mkdir(parents=True, exist_ok=True)
    with open(Path(output) / "fluid_error.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, ["scene", "code", "n", "cells", "seconds", "error", "deviation_from_ghia"])
        writer.writeheader()
        writer.writerows(rows)
    print(f"{'scene':<8} {'code':<20} {'n':>4} {'cells':>7} {'seconds':>9} {'error':>9} {'from Ghia':>9}")
    for (scene, code, n), row in table.items():
        ghia = f"{row['deviation_from_ghia']:9.2e}" if scene == "cavity" else ""
        print(f"{scene:<8} {code:<20} {n:4d} {row['cells']:7d} {row['seconds']:9.3f} {row['error']:9.2e} {ghia}")
    picture(table, Path(output) / "fluid_error.png")


def picture(table, name):
    """Error against seconds, a panel for each scene; the numbers are squares per edge."""
    from matplotlib import pyplot as plt
    figure, axes = plt.subplots(1, 2, figsize=(10.5, 4.5))
    titles = {"vortex": "relative L2 error of the velocity", "cavity": "largest error on the centre lines / lid velocity"}
    marks = {"fe_el": "C0o-", "icoFoam Euler": "C1s-", "icoFoam backward": "C1s--", "Taylor-Hood": "C2^-",
             "Taylor-Hood explicit": "C2^--"}
    for axis, (scene, label) in zip(axes, titles.items()):
        for code, mark in marks.items():
            points = [(max(r["seconds"], 1e-3), r["error"], n) for (s, c, n), r in table.items() if (s, c) == (scene, code)]
            if points:
                axis.loglog([p[0] for p in points], [p[1] for p in points], mark, label=code)
            for seconds, error, n in points:
                axis.annotate(n, (seconds, error), (5, 4), textcoords="offset points", fontsize=8)
        axis.set(title=scene, xlabel="wall time [s]", ylabel=label)
        axis.grid(alpha=0.3, which="both")
        if axis.lines:
            axis.legend(loc="lower left", fontsize=8)
    figure.tight_layout()
    figure.savefig(name, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    main(**vars(arguments().parse_args()))
