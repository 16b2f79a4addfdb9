"""How collisions amplify round-off: a packing falls and settles, again with one bead moved by its last digit, on one rank.

Results on several ranks differ from those on one in the last digits; the order of sums is suspected. This shows what
becomes of such a difference however it came about.
    python demos/benchmarks/round_off.py
"""
import argparse
import logging
from pathlib import Path

import numpy as np
from mpi4py import MPI

import fe_el

BOX, DIAMETER, DENSITY = (0.03, 0.02, 0.05), 2e-3, 2500.0


def arguments():
    """Command line of the benchmark."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--steps", type=int, default=60, help="steps of 1 ms (60)")
    p.add_argument("--beads", type=int, default=800, help="beads of 2 mm (800)")
    p.add_argument("--output", default="out/round_off", help="folder for results (out/round_off)")
    return p


def settling(steps, beads, change):
    """Places (steps, beads, 3) and kinetic energies, with one coordinate of one bead changed by a part of its own."""
    mesh, tags = fe_el.box(BOX, (4, 3, 6))
    particles, sizes = fe_el.Particles(mesh, DENSITY, (0, 0, -9.81)), np.random.default_rng(1).uniform(0.9, 1.1, beads)
    particles.insert_on_lattice((0, 0, 0), BOX, DIAMETER * sizes, seed=1)
    particles.position[particles.id == beads // 2, 0] *= 1 + change
    contacts = fe_el.Contacts(particles, fe_el.LinearSpringDashpot(2000.0, 0.9, 0.1), (tags, (1, 2, 3, 4, 5, 6)),
                              steps_per_contact=20)
    places, energies = [], []
    for _ in range(steps):
        particles.advance(1e-3, contacts)
        places.append(particles.position[np.argsort(particles.id)])
        energies.append(particles.kinetic_energy())
    return np.array(places), np.array(energies)


def main(steps=60, beads=800, output="out/round_off"):
    """Compare the two runs and return the summary."""
    logging.getLogger().setLevel(logging.WARNING)
    if MPI.COMM_WORLD.size > 1:
        raise ValueError(f"There are {MPI.COMM_WORLD.size} ranks; run this benchmark on one, without mpirun.")
    (x, energy), (moved, other) = (settling(steps, beads, change) for change in (0.0, 2.3e-16))
    apart, error = np.abs(x - moved).max((1, 2)) / DIAMETER, np.abs(energy - other) / energy
    Path(output).mkdir(parents=True, exist_ok=True)
    np.savetxt(Path(output) / "round_off.csv", np.column_stack([np.arange(1, steps + 1), apart, error]), "%.4g", ",",
               header="step_ms,largest_distance_over_diameter,difference_of_kinetic_energy")
    grows = (apart > 1e-14) & (apart < 1e-3)
    rate = np.polyfit(np.flatnonzero(grows), np.log10(apart[grows]), 1)[0] if grows.sum() > 2 else 0.0
    return fe_el.write_summary(output, MPI.COMM_WORLD, particles=beads, decades_per_10_ms=10 * rate,
                               distance_over_diameter={f"{k}_ms": apart[k - 1] for k in range(10, steps + 1, 10)},
                               kinetic_energy={f"{k}_ms": error[k - 1] for k in range(10, steps + 1, 10)})


if __name__ == "__main__":
    for key, value in main(**vars(arguments().parse_args())).items():
        print(f"{key:32s} {value}")
