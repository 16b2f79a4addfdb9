"""MP-PIC beside parcels with contacts (DPM): a column of parcels that falls and comes to rest, without fluid.

Grains of 1 mm in parcels, spread over a box of 5 x 5 x 20 cm at a quarter of its volume. Solid fractions are those of the
overlap of spheres and cells, means over the patches of the nodes, for both; with contacts the parcels stack as spheres do.
    python demos/benchmarks/mp_pic_against_contacts.py --time-step 2e-4 1e-3 5e-3
"""
import argparse
import csv
import logging
import time
from pathlib import Path

import numpy as np
from mpi4py import MPI
from tqdm import tqdm

import fe_el

LENGTHS, GRAIN, DENSITY, GRAVITY, FRACTION = (0.05, 0.05, 0.2), 1e-3, 2500.0, 9.81, 0.25
STIFFNESS = 1000.0  # of single grains [N/m]: parcels overlap by less than a hundredth


def arguments():
    """Command line of the demo."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--parcels", type=int, default=4000, help="their number (4000)")
    p.add_argument("--cells", type=int, default=5, help="cubes across the box, six tetrahedra each (5)")
    p.add_argument("--time-step", type=float, nargs="+", default=[2e-4, 1e-3, 5e-3], help="[s] (2e-4 1e-3 5e-3)")
    p.add_argument("--end-time", type=float, default=0.4, help="[s] (0.4)")
    p.add_argument("--output", default="out/mp_pic_against_contacts", help="folder for results")
    return p


def column(parcels, cells):
    """The parcels of the start, and their walls."""
    mesh, tags = fe_el.box(LENGTHS, (cells, cells, 4 * cells))
    grains = fe_el.Particles(mesh, DENSITY, (0, 0, -GRAVITY))
    diameter = (FRACTION * np.prod(LENGTHS) / parcels * 6 / np.pi) ** (1 / 3)
    grains.insert_in_box((0, 0, 0), LENGTHS, parcels, diameter, seed=1, without_overlap=True,
                         coarse_graining=diameter / GRAIN)
    return grains, (tags, (1, 2, 3, 4, 5, 6))


def one_run(kind, parcels, cells, dt, end_time):
    """Run a column; returns its row of numbers."""
    grains, walls = column(parcels, cells)
    if kind == "mp_pic":
        packing = fe_el.MultiphasePIC(grains, walls=walls)
    else:
        packing = fe_el.Contacts(grains, fe_el.LinearSpringDashpot(STIFFNESS, 0.9, 0.3), walls=walls, steps_per_contact=20)
    mapping, smooth = fe_el.OverlapVolume(), fe_el.PatchAverage(grains.mesh)
    fullest, spent, energies, parts = 0.0, 0.0, [], 0
    for _ in range(round(end_time / dt)):
        start = time.process_time()
        grains.advance(dt, packing)
        spent, parts = spent + time.process_time() - start, parts + packing.steps_last
        mapping.prepare(grains.cells, *grains.located(), 0.5 * grains.diameter)
        out = np.zeros((len(grains.cells.volume), 1))
        mapping.deposit(grains.volume[:, None], out)
        solid = smooth((grains.halo.reverse_add(out) / grains.cells.volume[:, None])[:grains.cells.owned])
        fullest = max(fullest, grains.comm.allreduce(float(solid.max(initial=0.0)), op=MPI.MAX))
        mass, height = grains.comm.allreduce(np.array([grains.mass.sum(), grains.mass @ grains.position[:, 2]]))
        energies.append(grains.kinetic_energy() + GRAVITY * height)
    speed = np.sqrt(2 * grains.kinetic_energy() / mass)
    return {"packing": kind, "time_step": dt, "largest_solid_fraction": fullest,
            "packing_at_rest": FRACTION * LENGTHS[2] / (2 * height / mass), "rms_velocity_at_end": speed,
            "largest_gain_of_energy": float(np.max(np.diff(energies)) / energies[0]),
            "processor_seconds_per_simulated_second": spent / end_time, "parts_of_a_step": parts / len(energies)}


def main(parcels=4000, cells=5, time_step=(2e-4, 1e-3, 5e-3), end_time=0.4, output="out/mp_pic_against_contacts",
         progress=True):
    """Run the columns and return the summary."""
    logging.getLogger().setLevel(logging.WARNING)
    cases = [(kind, dt) for dt in time_step for kind in ("contacts", "mp_pic")]
    comm = MPI.COMM_WORLD
    rows = [one_run(kind, parcels, cells, dt, end_time)
            for kind, dt in tqdm(cases, disable=not progress or comm.rank > 0, unit="run")]
    summary = {f"{row['packing']}_{row['time_step']:g}_{name}": value for row in rows
               for name, value in row.items() if name not in ("packing", "time_step")}
    if comm.rank == 0:
        Path(output).mkdir(parents=True, exist_ok=True)
        with open(Path(output) / "columns.csv", "w", newline="") as file:
            writer = csv.DictWriter(file, rows[0])
            writer.writeheader()
            writer.writerows(rows)
        if progress:
            for row in rows:
                print("  ".join(f"{v:10.4g}" if isinstance(v, float) else f"{v:10s}" for v in row.values()))
    return fe_el.write_summary(output, comm, parcels=parcels, cells=cells, end_time=end_time, **summary)


if __name__ == "__main__":
    main(**vars(arguments().parse_args()))
