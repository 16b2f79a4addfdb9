"""Speed of the fluid: seconds of a step in a lid-driven cube, beside icoFoam where it is installed."""
import argparse
import csv
import logging
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from mpi4py import MPI
from tqdm import tqdm

import fe_el

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from demos.peers import ico_foam

EDGE, LID, VISCOSITY, COURANT = 0.1, 1.0, 1e-4, 0.3


def arguments():
    """Command line of the demo."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    p.add_argument("--cubes", type=int, nargs="*", default=[12, 20, 25],
                   help="cubes per edge of fe_el's cube, six tetrahedra each")
    p.add_argument("--steps", type=int, default=40, help="steps that are timed, after 20 that are not")
    p.add_argument("--repeats", type=int, default=3, help="runs of each, one code after the other; the median counts")
    p.add_argument("--output", default="out/fluid_speed", help="folder for results")
    return p


def cube(n, steps):
    """Cells and median seconds of a step of fe_el in the cube."""
    mesh, tags = fe_el.box((EDGE,) * 3, (n,) * 3)
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, 1.0, VISCOSITY, tolerance=1e-6)
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
    ico_foam.write_case(folder, (EDGE,) * 3, (n,) * 3, patches, VISCOSITY, COURANT * EDGE / n / LID, 20 + steps, ranks=ranks)
    seconds = ico_foam.run(folder, ranks)
    return n ** 3, (seconds[-1] - seconds[19]) / steps


def main(cubes=(12, 20, 25), steps=40, repeats=3, output="out/fluid_speed", progress=True):
    """Run the comparison and return the summary."""
    logging.getLogger().setLevel(logging.WARNING)
    comm, start, peer = MPI.COMM_WORLD, time.perf_counter(), ico_foam.installed()
    if comm.rank == 0 and not peer:
        print("icoFoam is not installed (Debian: openfoam); fe_el is timed alone.")
    rows = []
    with (tempfile.TemporaryDirectory() as scratch,
          tqdm(total=repeats * len(cubes), disable=not progress or comm.rank > 0, unit="case") as bar):
        for k in range(repeats):
            for n in cubes:
                cells, seconds = cube(n, steps)
                rows.append({"code": "fe_el", "n": n, "cells": cells, "repeat": k, "seconds": seconds})
                for ranks in (1, 2) if peer and comm.size == 1 else ():
                    found = cube_of_ico_foam(cells, steps, f"{scratch}/cube", ranks)
                    rows.append({"code": f"icoFoam {ranks} rank" + "s" * (ranks > 1), "n": n, "cells": found[0], "repeat": k,
                                 "seconds": found[1]})
                bar.update()
    table = medians(rows)
    if comm.rank == 0:
        write(output, rows, table)
    numbers = {f"cube_{code.replace(' ', '_')}_{n}_{what}": value
               for (code, n), row in table.items() for what, value in row.items()}
    return fe_el.write_summary(output, comm, **numbers, repeats=repeats, wall_time=time.perf_counter() - start)


def medians(rows):
    """Cells and median seconds of a step, of each code and size."""
    table = {}
    for key in dict.fromkeys((r["code"], r["n"]) for r in rows):
        these = [r for r in rows if (r["code"], r["n"]) == key]
        table[key] = {"cells": these[0]["cells"], "seconds": float(np.median([r["seconds"] for r in these]))}
    return table


def write(output, rows, table):
    """CSV, and table on the screen."""
    Path(output).mkdir(parents=True, exist_ok=True)
    with open(Path(output) / "fluid_speed.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)
    print(f"{'code':<18} {'n':>4} {'cells':>7} {'seconds':>9}")
    for (code, n), row in table.items():
        print(f"{code:<18} {n:4d} {row['cells']:7d} {row['seconds']:9.4f}")


if __name__ == "__main__":
    summary = main(**vars(arguments().parse_args()))
