"""Bed, suspension, silo and a user's own weak form on each platform: the same figures, and what each scene costs there.

Run it once with every installation, each with an ``--output`` of its own, then compare the folders: ``--compare A B C``.
"""
import argparse
import json
import logging
import sys
from pathlib import Path

from mpi4py import MPI

import fe_el

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from demos import contacts_only, fluidised_bed, own_weak_form, sedimenting_suspension

# scene: (main, options, figures); the times end before collisions have made round-off visible (round_off.py)
SCENES = {
    "bed": (fluidised_bed.main, {"end_time": 0.01, "record_every": 1},
            ("kinetic_energy", "mean_height_small", "mean_height_large", "pressure_drop")),
    "suspension": (sedimenting_suspension.main, {"end_time": 0.02},
                   ("slip_velocity", "max_solid_fraction", "courant")),
    "silo": (contacts_only.main, {"settle_time": 1e-3, "end_time": 0.02, "seed": 3},
             ("kinetic_energy", "largest_overlap_over_diameter")),
    "own_weak_form": (own_weak_form.main, {"cells": 12}, ("mean_velocity",)),
}


def arguments():
    """Command line of the demo."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    p.add_argument("--output", default="out/platforms", help="folder for results")
    p.add_argument("--compare", nargs="+", default=(), help="folders of earlier runs; nothing is run")
    p.add_argument("--within", type=float, default=1e-9, help="relative difference of a figure that is taken for the same")
    return p


def main(scenes=tuple(SCENES), output="out/platforms", progress=True):
    """Run the scenes, each three times, the first of which compiles, and return the summary with the least cost of each."""
    logging.getLogger().setLevel(logging.WARNING)
    numbers = {}
    for name in scenes:
        run, options, figures = SCENES[name]
        found = [run(**options, output=f"{output}/{name}", progress=False) for _ in range(3)]
        cost = min(one["processor_time"] for one in found)
        numbers |= {f"{name}_{figure}": found[0][figure] for figure in figures} | {f"{name}_processor_time": cost}
        if progress and MPI.COMM_WORLD.rank == 0:
            print(f"{name:14s}: {cost:6.2f} s of processor time", flush=True)
    return fe_el.write_summary(output, **numbers)


def compare(folders, within=1e-9):
    """Table of what runs have found, figures relative to the first run's; returns the largest difference."""
    runs = [json.loads((Path(folder) / "summary.json").read_text()) for folder in folders]
    heads = [", ".join(f"{name} {run['version_' + name]}" for name in ("dolfinx", "numba", "petsc")) for run in runs]
    print("| | " + " | ".join(heads) + " |")
    print("| --- |" + " --- |" * len(runs))
    largest = 0.0
    for key in [key for key in runs[0] if key.startswith(tuple(SCENES))]:
        values = [run[key] for run in runs]
        if key.endswith("processor_time"):
            cells = [f"{value:.2f} s" for value in values]
        else:
            apart = [abs(value - values[0]) / max(abs(values[0]), 1e-300) for value in values]
            largest = max(largest, *apart)
            cells = [f"{values[0]:.12g}"] + [f"{a:.0e} off" for a in apart[1:]]
        print(f"| {key.replace('_', ' ')} | " + " | ".join(cells) + " |")
    verdict = "the same" if largest <= within else "NOT the same"
    print(f"Figures differ by {largest:.1e} at most: {verdict} within {within:g}.")
    return largest


if __name__ == "__main__":
    options = arguments().parse_args()
    if options.compare:
        sys.exit(int(compare(options.compare, options.within) > options.within))
    main(output=options.output)
