"""Speed of the fluid: a lid-driven cube, and error against run time of a drifting vortex; beside icoFoam where it is installed."""
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

sys.path.insert(0, str(Path(__file__).resolve().parent))
import ico_foam

matplotlib.use("Agg")
EDGE, LID, CUBE_VISCOSITY, COURANT = 0.1, 1.0, 1e-4, 0.3
VORTEX_VISCOSITY, DRIFT, END = 0.01, np.array([1.0, 0.5]), 1.0


def arguments():
    """Command line of the demo."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    p.add_argument("--cubes", type=int, nargs="*", default=[12, 20, 25], help="cubes per edge of fe_el's cavity, six tetrahedra each")
    p.add_argument("--steps", type=int, default=40, help="steps that are timed, after 20 that are not")
    p.add_argument("--vortex", type=int, nargs="*", default=[16, 32, 64], help="squares per edge of the vortex' box")
    p.add_argument("--repeats", type=int, default=3, help="runs of each, one code after the other; the median counts")
    p.add_argument("--output", default="out/fluid_speed", help="folder for results")
    return p


def cube(n, steps):
    """Cells and median seconds of a step of fe_el in the cube."""
    mesh, tags = fe_el.box((EDGE,) * 3, (n,) * 3)
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, 1.0, CUBE_VISCOSITY, tolerance=1e-6)
    air.set_velocity(6, (LID, 0.0, 0.0))
    for side in (1, 2, 3, 4, 5):
        air.set_no_slip(side)
    cells = air.comm.allreduce(air.num_cells)
    dt, seconds = COURANT * EDGE / cells ** (1 / 3) / LID, []
    for _ in range(20 + steps):
        air.comm.barrier()
        start = time.perf_counter()
        air.advance(dt)
        seconds.append(time.perf_counter() - start)
    return cells, float(np.median(seconds[20:]))


def cube_of_ico_foam(cells, steps, folder, ranks):
    """Cells and mean seconds of a step of icoFoam in the cube, of about as many cells."""
    n = round(cells ** (1 / 3))
    still = ("type noSlip;", "type zeroGradient;")
    patches = {"lid": ("wall", "", "z+", f"type fixedValue; value uniform ({LID} 0 0);", "type zeroGradient;"),
               "walls": ("wall", "", "x- x+ y- y+ z-", *still)}
    ico_foam.write_case(folder, (EDGE,) * 3, (n,) * 3, patches, CUBE_VISCOSITY, COURANT * EDGE / n / LID, 20 + steps, ranks=ranks)
    seconds = ico_foam.run(folder, ranks)
    return n ** 3, (seconds[-1] - seconds[19]) / steps


def vortex(time, x):
    """Velocity of a Taylor-Green vortex that drifts and decays."""
    a, b, fade = x[:, 0] - DRIFT[0] * time, x[:, 1] - DRIFT[1] * time, np.exp(-2 * VORTEX_VISCOSITY * time)
    return DRIFT + fade * np.column_stack([np.sin(a) * np.cos(b), -np.cos(a) * np.sin(b)])


def relative_error(weight, found, exact):
    """L2 error over the L2 norm of the vortex without its drift."""
    return float(np.sqrt((weight * ((found - exact) ** 2).sum(1)).sum() / (weight * ((exact - DRIFT) ** 2).sum(1)).sum()))


def steps_of(n):
    """Steps to the end at Courant number 0.4 of a square."""
    return int(np.ceil(END / (0.4 * 2 * np.pi / n / 2)))


def vortex_of_fe_el(n):
    """Cells, seconds and relative error of fe_el."""
    mesh, _ = fe_el.periodic_box((2 * np.pi,) * 2, (n, n))
    air = fe_el.VolumeAveragedNavierStokes(mesh, None, 1.0, VORTEX_VISCOSITY, tolerance=1e-6)
    air.set_initial_velocity(vortex)
    steps = steps_of(n)
    air.advance(END / steps)  # sets up
    start = time.perf_counter()
    for _ in range(steps - 1):
        air.advance(END / steps)
    seconds = (time.perf_counter() - start) * steps / (steps - 1)
    found = air.velocity.x.array.reshape(-1, 2)[:air.num_cells]
    return air.num_cells, seconds, relative_error(air.volume, found, vortex(END, air.corner.mean(1)))


def vortex_of_ico_foam(n, folder, ddt):
    """Cells, seconds and relative error of icoFoam."""
    length = 2 * np.pi
    pairs = {"left": ("right", "x-"), "right": ("left", "x+"), "low": ("top", "y-"), "top": ("low", "y+")}
    patches = {k: ("cyclic", f"neighbourPatch {other};", face, "type cyclic;", "type cyclic;") for k, (other, face) in pairs.items()}
    patches["faces"] = ("empty", "", "z- z+", "type empty;", "type empty;")
    c = (np.arange(n) + 0.5) * length / n
    x = np.column_stack([a.ravel() for a in np.meshgrid(c, c)])
    steps = steps_of(n)
    ico_foam.write_case(folder, (length, length, length / n), (n, n, 1), patches, VORTEX_VISCOSITY, END / steps, steps,
                        ico_foam.vectors(vortex(0.0, x)), ddt)
    seconds = ico_foam.run(folder)
    seconds = (seconds[-1] - seconds[0]) * steps / (steps - 1)
    return n * n, float(seconds), relative_error(np.ones(n * n), ico_foam.final_velocity(folder, n * n), vortex(END, x))


def main(cubes=(12, 20, 25), steps=40, vortex=(16, 32, 64), repeats=3, output="out/fluid_speed", progress=True):
    """Run the comparisons and return the summary."""
    logging.getLogger().setLevel(logging.WARNING)
    comm, start, peer = MPI.COMM_WORLD, time.perf_counter(), ico_foam.installed()
    if comm.rank == 0 and not peer:
        print("icoFoam is not installed (Debian: openfoam); fe_el is timed alone.")
    rows, total = [], repeats * (len(cubes) + (len(vortex) if comm.size == 1 else 0))
    with tempfile.TemporaryDirectory() as scratch, tqdm(total=total, disable=not progress or comm.rank > 0, unit="case") as bar:
        for k in range(repeats):
            for n in cubes:
                cells, seconds = cube(n, steps)
                rows.append({"scene": "cube", "code": "fe_el", "n": n, "cells": cells, "repeat": k, "seconds": seconds, "error": ""})
                if peer and comm.size == 1:
                    for ranks in (1, 2):
                        found = cube_of_ico_foam(cells, steps, f"{scratch}/cube", ranks)
                        rows.append({"scene": "cube", "code": f"icoFoam {ranks} rank" + "s" * (ranks > 1), "n": n, "cells": found[0],
                                     "repeat": k, "seconds": found[1], "error": ""})
                bar.update()
            for n in vortex if comm.size == 1 else ():
                runs = {"fe_el": vortex_of_fe_el(n)}
                if peer:
                    runs |= {f"icoFoam {ddt}": vortex_of_ico_foam(n, f"{scratch}/vortex", ddt) for ddt in ("Euler", "backward")}
                rows += [{"scene": "vortex", "code": code, "n": n, "cells": r[0], "repeat": k, "seconds": r[1], "error": r[2]}
                         for code, r in runs.items()]
                bar.update()
    table = medians(rows)
    if comm.rank == 0:
        write(output, rows, table)
    numbers = {f"{scene}_{code.replace(' ', '_')}_{n}_{what}": value for (scene, code, n), row in table.items()
               for what, value in row.items() if value is not None}
    return fe_el.write_summary(output, comm, **numbers, repeats=repeats, wall_time=time.perf_counter() - start)


def medians(rows):
    """Median seconds, cells and error of each scene, code and size."""
    table = {}
    for key in dict.fromkeys((r["scene"], r["code"], r["n"]) for r in rows):
        these = [r for r in rows if (r["scene"], r["code"], r["n"]) == key]
        table[key] = {"cells": these[0]["cells"], "seconds": float(np.median([r["seconds"] for r in these])),
                      "error": these[0]["error"] or None}
    return table


def write(output, rows, table):
    """CSV, table on the screen, and PNG of error against seconds."""
    from matplotlib import pyplot as plt
    Path(output).mkdir(parents=True, exist_ok=True)
    with open(Path(output) / "fluid_speed.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)
    print(f"{'scene':<8} {'code':<18} {'n':>4} {'cells':>7} {'seconds':>9} {'error':>9}")
    for (scene, code, n), row in table.items():
        error = f"{row['error']:9.2e}" if row["error"] else ""
        print(f"{scene:<8} {code:<18} {n:4d} {row['cells']:7d} {row['seconds']:9.4f} {error}")
    curves = dict.fromkeys(code for scene, code, _ in table if scene == "vortex")
    if curves:
        figure, axis = plt.subplots(figsize=(6, 4.5))
        for code in curves:
            points = [(max(r["seconds"], 1e-3), r["error"]) for (s, c, _), r in table.items() if s == "vortex" and c == code]
            axis.loglog(*zip(*points), marker="o", label=code)
        axis.set(xlabel="wall time [s]", ylabel="relative L2 error of the velocity")
        axis.grid(alpha=0.3, which="both")
        axis.legend()
        figure.tight_layout()
        figure.savefig(Path(output) / "error_against_run_time.png", dpi=110)
        plt.close(figure)


if __name__ == "__main__":
    summary = main(**vars(arguments().parse_args()))
