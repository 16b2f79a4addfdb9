"""A bubbling bed beside a measurement: voidage and bead velocity that Mueller et al. measured by magnetic resonance (2008,
2009).

44 x 10 mm in plan, 9,240 beads of 1.2 mm and 1000 kg/m^3 (poppy seeds), air at 0.9 or 0.6 m/s. The measured profiles are
time means:
of the voidage across the bed at 16.4 and 31.2 mm above the distributor, and of the vertical velocity of the beads at 15, 25
and 35 mm
(0.9 m/s) or 20 mm (0.6 m/s). Published simulations differ from the measured voidage by about 0.06.

Restitution 0.97, friction 0.1, stiffness 200 N/m as in published runs; the depth is resolved with three cells, the walls are
no-slip.
A run of 5 s takes about six minutes for each drag law and velocity.
    python demos/mri_bed.py --drag beetstra gidaspow
    mpirun -n 2 python -m mpi4py demos/mri_bed.py
"""
import argparse
import csv
import logging
import sys
from pathlib import Path

import matplotlib
import numpy as np
from mpi4py import MPI

import fe_el

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from demos import bed_runs, reports, restarts

matplotlib.use("Agg")
WIDTH, DEPTH, HEIGHT, NUMBER, DIAMETER = 0.044, 0.01, 0.12, 9240, 1.2e-3
BEAD_DENSITY, GAS_DENSITY, GAS_VISCOSITY, GRAVITY = 1000.0, 1.2, 1.2 * 1.8e-5, 9.81
HEIGHTS = {"mean_voidage": (16.4, 31.2), "mean_particle_vy_m_s": (15.0, 20.0, 25.0, 35.0)}
THICKNESS, COLUMNS = 3e-3, 22  # of the boxes in which means are taken [m], and their number across the bed
MEASURED = Path(__file__).resolve().parent / "mri_bed_measured.csv"
REPORTS = {"voidage": reports.Report(
    settings=({"cells": (11, 3, 30), "time_step": 5e-4, "steps_per_contact": 20, "seed": 1},
              {"cells": (11, 3, 30), "time_step": 5e-4, "steps_per_contact": 20, "seed": 2},
              {"cells": (11, 3, 30), "time_step": 1e-3, "steps_per_contact": 20, "seed": 1},
              {"cells": (11, 3, 30), "time_step": 1e-3, "steps_per_contact": 12, "seed": 1},
              {"cells": (8, 2, 22), "time_step": 1e-3, "steps_per_contact": 12, "seed": 1},
              {"cells": (8, 2, 22), "time_step": 2e-3, "steps_per_contact": 12, "seed": 1}),
    quantities={f"beetstra_0.9_deviation_mean_voidage_{h}_mm": 0.0 for h in (16.4, 31.2)},
    same={"superficial_velocity": (0.9,), "drag": ("beetstra",), "end_time": 0.6, "average_from": 0.2},
    first={"end_time": 2e-3, "average_from": 0.0}, within=0.06)}


def arguments():
    """Command line of the demo."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--superficial-velocity", type=float, nargs="+", default=[0.9, 0.6],
                   help="0.9, 0.6 or both [m/s] (0.9 0.6)")
    p.add_argument("--drag", nargs="+", default=["beetstra", "gidaspow"], help="drag laws, one run each (beetstra gidaspow)")
    p.add_argument("--end-time", type=float, default=6.0, help="simulated time of each run [s] (6)")
    p.add_argument("--average-from", type=float, default=1.0, help="start of the time means [s] (1)")
    p.add_argument("--time-step", type=float, default=5e-4, help="fluid time step [s] (5e-4)")
    p.add_argument("--steps-per-contact", type=int, default=20, help="contact steps in the shortest contact (20)")
    p.add_argument("--cells", type=int, nargs=3, default=[11, 3, 30],
                   help="cubes along x, y and z, six tetrahedra each (11 3 30)")
    p.add_argument("--stiffness", type=float, default=200.0, help="contact stiffness [N/m] (200)")
    p.add_argument("--mp-pic", action="store_true", help="the solids stress of MultiphasePIC in place of contacts")
    p.add_argument("--slip", action="store_true", help="slip walls for the gas in place of no-slip ones")
    p.add_argument("--seed", type=int, default=1, help="seed of the first positions (1)")
    p.add_argument("--output", default="out/mri_bed", help="folder for results (out/mri_bed)")
    restarts.add_arguments(p)
    return p


def assemble(velocity, drag, cells, stiffness, steps_per_contact, slip, seed, mp_pic=False):
    """The bed with its beads on a loose lattice; without a seed there are none yet."""
    mesh, tags = fe_el.box((WIDTH, DEPTH, HEIGHT), cells, slices_along=0)
    down = (0.0, 0.0, -GRAVITY)
    beads = fe_el.Particles(mesh, BEAD_DENSITY, down)
    if seed is not None:
        beads.insert_on_lattice((0, 0, 0), (WIDTH, DEPTH, 0.98 * HEIGHT), np.full(NUMBER, DIAMETER), seed=seed)
        # equal beads would fall as columns
        beads.velocity[:] = np.random.default_rng(seed).normal(scale=0.02, size=(NUMBER, 3))[beads.id]
    walls = tags, (1, 2, 3, 4, 5)
    if mp_pic:
        contacts = fe_el.MultiphasePIC(beads, walls=walls, restitution=0.97)
    else:
        law = fe_el.LinearSpringDashpot(stiffness, restitution=0.97, friction=0.1)
        contacts = fe_el.Contacts(beads, law, walls=walls, steps_per_contact=steps_per_contact)
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, GAS_DENSITY, GAS_VISCOSITY, down, tolerance=1e-8)
    air.set_velocity(5, (0.0, 0.0, velocity))
    air.set_pressure(6, 0.0)
    (air.set_slip if slip else air.set_no_slip)((1, 2, 3, 4))
    air.set_initial_velocity((0.0, 0.0, velocity))
    coupling = fe_el.Coupling(beads, air.velocity, air.pressure, GAS_DENSITY, GAS_VISCOSITY,
                              [fe_el.Drag(drag), fe_el.PressureGradient()])
    return bed_runs.Bed(beads, contacts, air, coupling)


def measured(velocity):
    """Measured profiles: {(quantity, height [mm]): (x [m], values)}."""
    out = {}
    with open(MEASURED) as file:
        for row in csv.DictReader(line for line in file if not line.startswith("#")):
            if float(row["U_superficial_m_s"]) == velocity:
                out.setdefault((row["quantity"], float(row["height_mm"])),
                               []).append((float(row["x_m_from_left_wall"]), float(row["value"])))
    return {key: np.array(rows).T for key, rows in out.items()}


def compare(averages, velocity):
    """Computed profiles, and root of the mean squared deviation from the measured ones, for each measured profile."""
    void, upward = averages.means()
    middle, heights = 0.5 * (averages.columns[1:] + averages.columns[:-1]), 500 * (averages.rows[::2] + averages.rows[1::2])
    profiles, deviations = {}, {}
    for (quantity, height), (x, values) in measured(velocity).items():
        row = int(np.argmin(np.abs(heights - height)))
        profiles[quantity, height] = middle, (void if quantity == "mean_voidage" else upward)[row]
        deviations[quantity, height] = float(np.sqrt(np.mean((np.interp(x, *profiles[quantity, height]) - values) ** 2)))
    return profiles, deviations


def one_run(velocity, drag, options, progress):
    """Run one bed; returns its profiles and numbers."""
    folder = Path(options["output"]) / f"{drag}_{velocity:g}"
    keep = restarts.Restarts(folder, *(options[k] for k in ("time_step", "checkpoint_every", "restart", "wall_time")))
    bed = assemble(velocity, drag, options["cells"], options["stiffness"], options["steps_per_contact"], options["slip"],
                   None if keep.going_on() else options["seed"], options["mp_pic"])
    edges = sorted({h for group in HEIGHTS.values() for h in group})
    rows = np.array([(1e-3 * h - THICKNESS / 2, 1e-3 * h + THICKNESS / 2) for h in edges]).ravel()
    averages = bed_runs.Averages(bed.beads, np.linspace(0, WIDTH, COLUMNS + 1), rows, DEPTH)
    drops = restarts.Rows()

    def each(now):
        if now > options["average_from"]:
            averages.add()
            drops.append((bed_runs.pressure_drop(bed.air),))
    with fe_el.ParaViewOutput(folder, bed.beads, [bed.air.velocity, bed.air.pressure, bed.coupling.fields[0]], 0.1) as out:
        numbers = bed_runs.run(bed, options["end_time"], out, each, keep, 10, [averages, drops], progress=progress)
    drops = np.ravel(drops)
    weight = bed.beads.comm.allreduce(bed.beads.mass.sum()) * GRAVITY / (WIDTH * DEPTH)
    profiles, deviations = compare(averages, velocity)
    numbers |= {"pressure_drop": float(np.mean(drops)), "pressure_drop_error": bed_runs.standard_error(drops),
                "bed_weight_per_area": weight, "cells": bed.beads.comm.allreduce(bed.beads.cells.owned)}
    numbers |= {f"deviation_{quantity}_{height:g}_mm": value for (quantity, height), value in deviations.items()}
    return profiles, numbers


def main(superficial_velocity=(0.9, 0.6), drag=("beetstra", "gidaspow"), end_time=6.0, average_from=1.0, time_step=5e-4,
         steps_per_contact=20, cells=(11, 3, 30), stiffness=200.0, mp_pic=False, slip=False, seed=1, output="out/mri_bed",
         checkpoint_every=None, restart=None, wall_time=None, progress=True):
    """Run the beds, compare them with the measurement, and return the summary."""
    options = dict(locals())
    unknown = [u for u in superficial_velocity if not measured(u)]
    if unknown:
        raise ValueError(f"--superficial-velocity is {unknown[0]}; there are measurements at 0.9 and 0.6 m/s.")
    if restart not in (None, True):
        raise ValueError(f"--restart is {restart}; each run goes on from the checkpoint in its own folder: give it "
                         "without a name.")
    if not 0 <= average_from < end_time:
        raise ValueError(f"--average-from is {average_from}; give a time before the end, {end_time} s.")
    logging.getLogger().setLevel(logging.WARNING)
    results = {(u, law): one_run(u, law, options, progress) for u in superficial_velocity for law in drag}
    summary = {f"{law}_{u:g}_{key}": value for (u, law), (_, numbers) in results.items() for key, value in numbers.items()
               if not isinstance(value, dict)}
    summary |= {name: sum(n[name] for _, n in results.values()) for name in ("wall_time", "processor_time")}
    if MPI.COMM_WORLD.rank == 0:
        picture(output, {key: profiles for key, (profiles, _) in results.items()})
    return fe_el.write_summary(output, MPI.COMM_WORLD, **summary)


def picture(output, results):
    """PNG: measured and computed profiles, a row for each gas velocity."""
    from matplotlib import pyplot as plt
    speeds = sorted({u for u, _ in results}, reverse=True)
    width = max(len(measured(u)) for u in speeds)
    figure, axes = plt.subplots(len(speeds), width, figsize=(3.2 * width, 3.1 * len(speeds)), squeeze=False,
                                layout="constrained")
    for row, u in zip(axes, speeds):
        for axis in row[len(measured(u)):]:
            axis.axis("off")
        for axis, ((quantity, height), (x, values)) in zip(row, sorted(measured(u).items())):
            axis.plot(1e3 * x, values, "ko", ms=4, label="measured")
            for (speed, law), profiles in results.items():
                if speed == u:
                    axis.plot(1e3 * profiles[quantity, height][0], profiles[quantity, height][1], label=law)
            name = "voidage" if quantity == "mean_voidage" else "velocity of the beads [m/s]"
            axis.set(xlabel="x [mm]", ylabel=name, title=f"{u:g} m/s, {height:g} mm high")
    axes[0, 0].legend(fontsize=8)
    figure.savefig(Path(output) / "mri_bed.png", dpi=100)
    plt.close(figure)


if __name__ == "__main__":
    reports.start(main, arguments(), REPORTS, width=60)
