"""A bidisperse gas-fluidised bed on a tetrahedral mesh: 27,720 beads of 1.5 mm and 17,940 of 2.5 mm (Goldschmidt et al.
2003)."""
import argparse
import logging
import sys
from pathlib import Path

import matplotlib
import numpy as np
from mpi4py import MPI

import fe_el

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from demos import bed_runs, restarts

matplotlib.use("Agg")
WIDTH, DEPTH, HEIGHT = 0.15, 0.015, 0.45
INLET, OUTLET, WALL = 1, 2, 3
GRAVITY, GAS_DENSITY, GAS_VISCOSITY, BEAD_DENSITY = 9.81, 1.13, 1.77e-5, 2525.0
SMALL, LARGE, NUMBER_SMALL, NUMBER_LARGE = 1.5e-3, 2.5e-3, 27_720, 17_940


def arguments():
    """Command line of the demo."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    p.add_argument("--superficial-velocity", type=float, default=1.3,
                   help="gas velocity at the inlet [m/s]; 0: no gas, dry bed")
    p.add_argument("--end-time", type=float, default=1.0, help="simulated time [s]")
    p.add_argument("--time-step", type=float, default=1e-3, help="fluid time step [s]")
    p.add_argument("--slice", type=float, default=1.0, help="fraction of the bed's width, same height")
    p.add_argument("--drag", default="beetstra", help="name of the drag law")
    p.add_argument("--stiffness", type=float, default=500.0, help="contact stiffness [N/m]")
    p.add_argument("--steps-per-contact", type=int, default=12, help="contact steps in the shortest contact")
    p.add_argument("--cell-size", type=float, default=0.0075, help="edge length of the tetrahedra [m]")
    p.add_argument("--output-every", type=float, default=0.05, help="time between ParaView outputs [s]")
    p.add_argument("--record-every", type=int, default=10, help="steps between records of pressure, heights and ledger")
    p.add_argument("--report", action="store_true",
                   help="error against wall time over step, steps in a contact and cell size")
    p.add_argument("--seed", type=int, default=1, help="seed of the initial mixture")
    p.add_argument("--output", default="out/fluidised_bed", help="folder for results")
    restarts.add_arguments(p)
    return p


def bed_mesh(fraction, cell_size):
    """Mesh of the bed, or of a slice of its width."""
    folder = Path(__file__).resolve().parent.parent / "meshes"
    if fraction == 1.0 and cell_size == 0.0075:
        return fe_el.read_mesh(folder / "fluidised_bed.msh", slices_along=0)
    return fe_el.mesh_geo(folder / "fluidised_bed.geo", slices_along=0, width=WIDTH * fraction, size=cell_size)


def fill(beads, fraction, seed):
    """Insert the mixture on a loose lattice: it falls and settles in the first quarter of a second."""
    diameter = np.repeat([SMALL, LARGE], [round(NUMBER_SMALL * fraction), round(NUMBER_LARGE * fraction)])
    beads.insert_on_lattice((0, 0, 0), (WIDTH * fraction, DEPTH, 0.98 * HEIGHT), diameter, seed=seed)


def assemble(superficial_velocity=1.3, slice=1.0, drag="beetstra", stiffness=500.0, steps_per_contact=12, cell_size=0.0075):
    """Beads (none yet), contacts, fluid and coupling of the bed; no fluid and coupling without a velocity."""
    mesh, _, tags = bed_mesh(slice, cell_size)
    gravity = (0, 0, -GRAVITY)
    beads = fe_el.Particles(mesh, density=BEAD_DENSITY, gravity=gravity)
    contacts = fe_el.Contacts(beads, fe_el.LinearSpringDashpot(stiffness, restitution=0.9, friction=0.1),
                              walls=[fe_el.FacetWalls(tags, WALL), fe_el.FacetWalls(tags, INLET)],
                              steps_per_contact=steps_per_contact)
    if not superficial_velocity:
        return bed_runs.Bed(beads, contacts)
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, GAS_DENSITY, GAS_VISCOSITY, gravity, tolerance=1e-9)
    air.set_velocity(INLET, (0, 0, superficial_velocity))
    air.set_pressure(OUTLET, 0.0)
    air.set_no_slip(WALL)
    air.set_initial_velocity((0, 0, superficial_velocity))
    return bed_runs.Bed(beads, contacts, air, fe_el.Coupling(beads, air.velocity, air.pressure, GAS_DENSITY, GAS_VISCOSITY,
                                                             [fe_el.Drag(drag), fe_el.PressureGradient()]))


def mean_height(beads, small):
    """Mean height of the small or the large beads [m]."""
    chosen = (beads.diameter < 0.5 * (SMALL + LARGE)) == small
    total = beads.comm.allreduce(np.array([beads.position[chosen, 2].sum(), chosen.sum()]))
    return total[0] / max(total[1], 1)


def drag_law_drop(beads, law, velocity, area):
    """Pressure drop [Pa] that the drag law gives for layers of the measured solid fraction, without any fluid solver."""
    thickness = 2 * LARGE
    layer = np.minimum((beads.position[:, 2] / thickness).astype(int), int(HEIGHT / thickness))
    count = int(HEIGHT / thickness) + 1
    sizes = (SMALL, LARGE)
    solid = np.array([np.bincount(layer[np.isclose(beads.diameter, d)],
                                  minlength=count) * np.pi / 6 * d ** 3 for d in sizes])
    solid = beads.comm.allreduce(solid) / (area * thickness)
    total, drop = solid.sum(0), 0.0
    for share, d in zip(solid, sizes):
        beta = law.coefficient(total, velocity / (1 - total), np.full(count, d), GAS_DENSITY, GAS_VISCOSITY)
        drop += (share * beta * velocity / (1 - total) ** 2 * thickness).sum()
    return drop


def drop_by_cells(bed, area):
    """Pressure drop [Pa] that balances the drag of the last step in every cell, with the velocity that the gas has there."""
    cells, d = bed.beads.cells, 3
    n, (void, drag, source) = cells.owned, [field.x.array for field in bed.coupling.fields[:3]]
    upwards = bed.air.velocity.x.array.reshape(-1, d)[:n, 2]
    force = (drag[:n] * upwards - source.reshape(-1, d)[:n, 2]) / void[:n]
    return bed.beads.comm.allreduce(float(force @ cells.volume[:n])) / area


class Record:
    """Pressure drop, mean heights and energy against time, and snapshots of the beads."""

    def __init__(self, bed, end_time):
        self.bed, self.rows, self.snapshots, self.times = bed, [], [], list(end_time * np.array([0.25, 0.5, 0.75, 1.0]))
        self.until = 0.0

    def saved(self):
        """Rows and snapshots so far, for a checkpoint; the first rank has them."""
        shots = {f"{name}_{k}": value for k, shot in enumerate(self.snapshots) for name, value in shot.items()}
        return {"same": (None, {"rows": np.array(self.rows, float), "snapshots": len(self.snapshots), "until": self.until,
                                **shots})}

    def restore(self, state):
        """Take them back; only what comes later is taken anew."""
        same = state["same"]
        self.rows = [tuple(row) for row in same["rows"]]
        if self.bed.beads.comm.rank == 0:
            self.snapshots = [{name: same[f"{name}_{k}"] for name in ("time", "position", "velocity", "diameter")}
                              for k in range(int(same["snapshots"]))]
        self.until = float(same["until"])
        self.times = [t for t in self.times if t > self.until]

    def __call__(self, now):
        beads, contacts, air, _ = self.bed
        drop = bed_runs.pressure_drop(air) if air else 0.0
        held_back, standing = (wall.force[2] for wall in contacts.walls)  # by rubbing on the walls, and on the distributor
        gas = air.boundary_force(WALL)[1][2] if air else 0.0
        self.rows.append((now, drop, mean_height(beads, True), mean_height(beads, False), beads.kinetic_energy(),
                          held_back + gas, -standing, beads.momentum()[2]))

    def snapshot(self, now, step):
        """Keep the beads at four instants."""
        self.until = now + 0.5 * step
        if self.times and self.until > self.times[0]:
            self.times.pop(0)
            parts = bed_runs.gathered(self.bed.beads, "position", "velocity", "diameter")
            if parts is not None:
                self.snapshots.append({"time": now, **dict(zip(("position", "velocity", "diameter"), parts))})


def main(superficial_velocity=1.3, end_time=1.0, time_step=1e-3, slice=1.0, drag="beetstra", stiffness=500.0,
         steps_per_contact=12, cell_size=0.0075, output_every=0.05, checkpoint_every=None, restart=None, wall_time=None,
         record_every=10, report=False, seed=1, output="out/fluidised_bed", progress=True):
    """Run the bed and return the summary."""
    if not 0 < slice <= 1:
        raise ValueError(f"--slice is {slice}; give a fraction of the bed's width in (0, 1].")
    if record_every < 1:
        raise ValueError(f"--record-every is {record_every}; give a number of steps, 1 or more.")
    logging.getLogger().setLevel(logging.WARNING)
    keep = restarts.Restarts(output, time_step, checkpoint_every, restart, wall_time)
    bed = assemble(superficial_velocity, slice, drag, stiffness, steps_per_contact, cell_size)
    beads, _, air, coupling = bed
    if not keep.going_on():
        fill(beads, slice, seed)
    area = WIDTH * slice * DEPTH
    out = fe_el.ParaViewOutput(output, beads, [air.velocity, air.pressure, coupling.fields[0]] if air else [], output_every)
    record = Record(bed, end_time)
    with out:
        numbers = bed_runs.run(bed, end_time, out, record, keep, record_every, [record],
                               lambda now: record.snapshot(now, time_step), progress)
    weight = beads.comm.allreduce(beads.mass.sum()) * GRAVITY / area
    numbers |= {"slice": slice, "cells": beads.comm.allreduce(beads.cells.owned),
                "superficial_velocity": superficial_velocity,
                "steps_per_contact": steps_per_contact, "bed_weight_per_area": weight}
    return finish(output, record, bed, numbers, weight, area)


def finish(output, record, bed, numbers, weight, area):
    """Write picture and summary."""
    rows = np.array(record.rows)
    late = rows[rows[:, 0] > 0.5 * numbers["end_time"]]
    drop = late[:, 1]
    numbers |= {"mean_height_small": late[:, 2].mean(), "mean_height_large": late[:, 3].mean(),
                "kinetic_energy": late[-1, 4],
                "pressure_drop": drop.mean(), "pressure_drop_error": bed_runs.standard_error(drop),
                "pressure_drop_fluctuation": drop.std()}
    if bed.air:
        displaced = weight * GAS_DENSITY / BEAD_DENSITY  # the pressure drop is without the weight of a column of gas
        rubbing, standing = late[:, 5:7].mean(0) / area
        rising = (late[-1, 7] - late[0, 7]) / max(late[-1, 0] - late[0, 0], 1e-9) / area  # 1e-9: a single row
        numbers |= {"pressure_drop_over_weight": drop.mean() / weight, "wall_friction_per_area": rubbing,
                    "carried_by_distributor_per_area": standing,
                    "momentum_gained_per_area": rising,
                    "pressure_drop_expected": weight - displaced + rubbing - standing + rising,
                    "drag_law_pressure_drop": drag_law_drop(bed.beads, bed.coupling.drag, numbers["superficial_velocity"],
                                                            area),
                    "drag_by_cells_pressure_drop": drop_by_cells(bed, area)}
    if bed.beads.comm.rank == 0:
        picture(output, rows, record.snapshots, numbers)
    return fe_el.write_summary(output, bed.beads.comm, **numbers)


def meaning(numbers):
    """What the pressure drop says of the bed, in a sentence."""
    ratio = numbers.get("pressure_drop_over_weight", 0.0)
    if not ratio:
        return "There is no gas: a dry bed."
    share = (f"The gas carries {100 * ratio:.0f} % of the bed's weight ({numbers['pressure_drop']:.0f} of "
             f"{numbers['bed_weight_per_area']:.0f} Pa)")
    if ratio < 0.9:
        return share + ": the bed rests, held by contacts."
    return share + (": the bed is fluidised." if ratio < 1.1 else
                    ": more than it weighs, so beads are being lifted or jammed.")


def picture(output, rows, snapshots, numbers):
    """PNG: beads by vertical velocity at four instants, their sizes at the end, pressure drop and mean heights against
    time."""
    from matplotlib import pyplot as plt
    width = WIDTH * numbers["slice"]
    top = 1.05 * max(s["position"][:, 2].max() for s in snapshots)
    limit = max(np.quantile(np.abs(s["velocity"][:, 2]), 0.99) for s in snapshots) + 1e-9
    panels, narrow = len(snapshots) + 1, max(min(width / top, 1.2), 0.12)
    figure = plt.figure(figsize=(6.5 + 4.6 * narrow * panels, 5.6), layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=[4.6 * narrow * panels + 1.5, 5.0])
    axes = left.subplots(1, panels, sharey=True)
    for axis, s in zip(axes, snapshots):
        shown = bed_runs.draw_beads(axis, s, s["velocity"][:, 2], width, top, f"{s['time']:.2f} s", cmap="RdBu_r",
                                    clim=(-limit, limit))
    left.colorbar(shown, ax=list(axes[:-1]), location="bottom", shrink=0.8, label="vertical velocity [m/s]", pad=0.02)
    s = snapshots[-1]
    sizes = bed_runs.draw_beads(axes[-1], s, s["diameter"] * 1e3, width, top, "sizes", cmap="coolwarm")
    left.colorbar(sizes, ax=axes[-1], location="bottom", label="[mm]", ticks=[SMALL * 1e3, LARGE * 1e3], pad=0.02)
    axes[0].set(ylabel="height [m]", xlabel="width [mm]")
    drop, heights = right.subplots(2, 1, sharex=True)
    drop.plot(rows[:, 0], rows[:, 1], lw=1.0, label="pressure drop")
    drop.axhline(numbers["bed_weight_per_area"], color="k", ls="--", label="weight of the bed per area")
    drop.set(ylabel="[Pa]", ylim=(0, 2 * numbers["bed_weight_per_area"]))
    drop.legend(loc="upper right", fontsize=8)
    for column, name in ((2, "small beads"), (3, "large beads")):
        heights.plot(rows[:, 0], 1e3 * rows[:, column], lw=1.0, label=name)
    heights.set(xlabel="time [s]", ylabel="mean height [mm]")
    heights.legend(fontsize=8)
    figure.savefig(Path(output) / "fluidised_bed.png", dpi=110)
    plt.close(figure)


def command(options):
    """What the command line asks for."""
    if not options["report"]:
        return main(**options)
    from demos import bed_report
    return bed_report.main(options)


if __name__ == "__main__":
    summary = command(vars(arguments().parse_args()))
    if MPI.COMM_WORLD.rank == 0:
        for key, value in summary.items():
            print(f"{key:32s} {value}")
        if "pressure_drop" in summary:
            print("\n" + meaning(summary))
