"""A bidisperse gas-fluidised bed on a tetrahedral mesh: 27,720 beads of 1.5 mm and 17,940 of 2.5 mm (Goldschmidt et al. 2003)."""
import argparse
import logging
import time
from pathlib import Path

import matplotlib
import numpy as np
from mpi4py import MPI

import fe_el

matplotlib.use("Agg")
WIDTH, DEPTH, HEIGHT = 0.15, 0.015, 0.45
INLET, OUTLET, WALL = 1, 2, 3
GRAVITY, GAS_DENSITY, GAS_VISCOSITY, BEAD_DENSITY = 9.81, 1.13, 1.77e-5, 2525.0
SMALL, LARGE, NUMBER_SMALL, NUMBER_LARGE = 1.5e-3, 2.5e-3, 27_720, 17_940


def arguments():
    """Command line of the demo."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    p.add_argument("--superficial-velocity", type=float, default=1.3, help="gas velocity at the inlet [m/s]; 0: no gas, dry bed")
    p.add_argument("--end-time", type=float, default=1.0, help="simulated time [s]")
    p.add_argument("--time-step", type=float, default=1e-4, help="fluid time step [s]")
    p.add_argument("--slice", type=float, default=1.0, help="fraction of the bed's width, same height")
    p.add_argument("--drag", default="beetstra", help="name of the drag law")
    p.add_argument("--stiffness", type=float, default=500.0, help="contact stiffness [N/m]")
    p.add_argument("--steps-per-contact", type=int, default=50, help="contact steps in the shortest contact")
    p.add_argument("--cell-size", type=float, default=0.0075, help="edge length of the tetrahedra [m]")
    p.add_argument("--output-every", type=float, default=0.05, help="time between ParaView outputs [s]")
    p.add_argument("--checkpoint-every", type=float, help="time between checkpoints, OUTPUT/checkpoint.h5 [s]; absent: none")
    p.add_argument("--restart", help="checkpoint to go on from, of a run with the same slice and cell size")
    p.add_argument("--seed", type=int, default=1, help="seed of the initial mixture")
    p.add_argument("--output", default="out/fluidised_bed", help="folder for results")
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


def assemble(superficial_velocity=1.3, slice=1.0, drag="beetstra", stiffness=500.0, steps_per_contact=50, cell_size=0.0075):
    """Beads (none yet), contacts, fluid and coupling of the bed; no fluid and coupling without a velocity."""
    mesh, _, tags = bed_mesh(slice, cell_size)
    gravity = (0, 0, -GRAVITY)
    beads = fe_el.Particles(mesh, density=BEAD_DENSITY, gravity=gravity)
    contacts = fe_el.Contacts(beads, fe_el.LinearSpringDashpot(stiffness, restitution=0.9, friction=0.1),
                              walls=(tags, (WALL, INLET)), steps_per_contact=steps_per_contact)
    if not superficial_velocity:
        return beads, contacts, None, None
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, GAS_DENSITY, GAS_VISCOSITY, gravity, tolerance=1e-9)
    air.set_velocity(INLET, (0, 0, superficial_velocity))
    air.set_pressure(OUTLET, 0.0)
    air.set_no_slip(WALL)
    air.set_initial_velocity((0, 0, superficial_velocity))
    return beads, contacts, air, fe_el.Coupling(beads, air.velocity, air.pressure, GAS_DENSITY, GAS_VISCOSITY,
                                                [fe_el.Drag(drag), fe_el.PressureGradient()])


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
    solid = np.array([np.bincount(layer[np.isclose(beads.diameter, d)], minlength=count) * np.pi / 6 * d ** 3 for d in sizes])
    solid = beads.comm.allreduce(solid) / (area * thickness)
    total, drop = solid.sum(0), 0.0
    for share, d in zip(solid, sizes):
        beta = law.coefficient(total, velocity / (1 - total), np.full(count, d), GAS_DENSITY, GAS_VISCOSITY)
        drop += (share * beta * velocity / (1 - total) ** 2 * thickness).sum()
    return drop


class Record:
    """What is measured at every step."""

    def __init__(self):
        self.rows, self.solid, self.momentum, self.mass, self.fullest, self.spilled = [], 0.0, 0.0, 0.0, 0.0, 0

    def ledger(self, coupling, air):
        """Largest ledger entries so far."""
        self.solid = max(self.solid, coupling.solid_volume_error)
        self.momentum = max(self.momentum, coupling.momentum_imbalance)
        self.mass = max(self.mass, air.mass_residual())
        self.fullest = max(self.fullest, coupling.max_solid_fraction)


def main(superficial_velocity=1.3, end_time=1.0, time_step=1e-4, slice=1.0, drag="beetstra", stiffness=500.0,
         steps_per_contact=50, cell_size=0.0075, output_every=0.05, checkpoint_every=None, restart=None, seed=1,
         output="out/fluidised_bed", progress=True):
    """Run the bed and return the summary."""
    if not 0 < slice <= 1:
        raise ValueError(f"--slice is {slice}; give a fraction of the bed's width in (0, 1].")
    if checkpoint_every is not None and not checkpoint_every >= time_step:
        raise ValueError(f"--checkpoint-every is {checkpoint_every}; give at least a time step of {time_step} s.")
    logging.getLogger().setLevel(logging.WARNING)
    beads, contacts, air, coupling = assemble(superficial_velocity, slice, drag, stiffness, steps_per_contact, cell_size)
    if restart is None:
        fill(beads, slice, seed)
    mesh, area = beads.mesh, WIDTH * slice * DEPTH
    parts, begin = [beads, contacts] + ([air] if air else []), 0.0
    if restart is not None:
        begin = float(fe_el.load_checkpoint(restart, *parts)["time"])
    next_checkpoint = begin + (checkpoint_every or np.inf)
    out = fe_el.ParaViewOutput(output, beads, [air.velocity, air.pressure, coupling.fields[0]] if air else [], output_every)
    record, start = Record(), time.perf_counter()
    number, weight = beads.total_number, beads.comm.allreduce(beads.mass.sum()) * GRAVITY / area
    with out:
        for now in fe_el.time_steps(time_step, end_time, begin, progress=progress):
            if air:
                coupling.to_fluid(time_step)
                air.advance(time_step, coupling.fields)
                coupling.to_particles(time_step)
                record.ledger(coupling, air)
            beads.advance(time_step, contacts)
            drop = pressure_drop(air) if air else 0.0
            record.rows.append((now, drop, mean_height(beads, True), mean_height(beads, False), beads.kinetic_energy()))
            out.write(now)
            if now > next_checkpoint - 0.5 * time_step:
                fe_el.save_checkpoint(Path(output) / "checkpoint.h5", *parts, time=now)
                next_checkpoint += checkpoint_every
    wall_time = time.perf_counter() - start
    return finish(output, record, beads, contacts, air, coupling, out, {
        "slice": slice, "particles": number, "cells": mesh.comm.allreduce(beads.cells.owned), "time_step": time_step, "end_time": end_time,
        "superficial_velocity": superficial_velocity, "bed_weight_per_area": weight, "wall_time": wall_time})


def pressure_drop(air):
    """Mean pressure at the inlet above the outlet's, less the weight of the gas column [Pa]."""
    bottom = np.isclose(air.node_position[:air.owned_nodes, 2], 0.0)
    p = air.pressure.x.array[:air.owned_nodes][bottom]
    total = air.comm.allreduce(np.array([p.sum(), len(p)]))
    return total[0] / total[1] - GAS_DENSITY * GRAVITY * HEIGHT


def finish(output, record, beads, contacts, air, coupling, out, numbers):
    """Write picture and summary."""
    rows = np.array(record.rows)
    late = rows[:, 0] > 0.5 * rows[-1, 0]
    numbers |= fe_el.stage_seconds(contacts, air, coupling, out)
    numbers |= {"contact_steps_per_fluid_step": contacts.steps_last, "lost_particles": numbers["particles"] - beads.total_number,
                "mean_height_small": rows[-1, 2], "mean_height_large": rows[-1, 3], "kinetic_energy": rows[-1, 4],
                "largest_overlap_over_diameter": beads.comm.allreduce(contacts.largest_overlap, op=MPI.MAX),
                "pressure_drop": rows[late, 1].mean()}
    if air:
        numbers["drag_law_pressure_drop"] = drag_law_drop(beads, coupling.drag, numbers["superficial_velocity"],
                                                          WIDTH * numbers["slice"] * DEPTH)
        numbers |= {"solid_volume_error": record.solid, "momentum_imbalance": record.momentum, "mass_residual": record.mass,
                    "max_solid_fraction": record.fullest, "over_filled_cells": coupling.over_filled_total}
    picture(output, rows, beads, numbers)
    return fe_el.write_summary(output, beads.comm, **numbers)


def picture(output, rows, beads, numbers):
    """PNG: beads by size, beads by vertical velocity, pressure drop and mean heights against time."""
    parts = beads.comm.gather((beads.position, beads.velocity, beads.diameter))
    if beads.comm.rank:
        return
    from matplotlib import pyplot as plt
    x, v, d = (np.concatenate([p[i] for p in parts]) for i in range(3))
    order = np.argsort(-x[:, 1])
    x, v, d = x[order], v[order], d[order]
    figure, axes = plt.subplots(1, 3, figsize=(13, 6), gridspec_kw={"width_ratios": [1, 1.15, 1.6]})
    top = 1.1 * x[:, 2].max()
    for axis, colour, name, kwargs in ((axes[0], d * 1e3, "diameter [mm]", {"cmap": "coolwarm"}),
                                       (axes[1], v[:, 2], "vertical velocity [m/s]", {"cmap": "RdBu_r"})):
        limit = np.abs(colour).max() if axis is axes[1] else None
        shown = axis.scatter(x[:, 0], x[:, 2], s=d ** 2 * 3e5 * 0.3 / top, c=colour, lw=0, **kwargs,
                             **({"vmin": -limit, "vmax": limit} if limit else {}))
        axis.set(aspect="equal", xlabel="x [m]", ylabel="z [m]", ylim=(0, top), title=name)
        figure.colorbar(shown, ax=axis, shrink=0.6)
    axes[2].plot(rows[:, 0], rows[:, 1], lw=0.8, label="pressure drop")
    axes[2].axhline(numbers["bed_weight_per_area"], color="k", ls="--", label="bed weight per area")
    axes[2].set(xlabel="time [s]", ylabel="[Pa]", ylim=(0, 2 * numbers["bed_weight_per_area"]))
    axes[2].legend()
    figure.tight_layout()
    figure.savefig(Path(output) / "fluidised_bed.png", dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    summary = main(**vars(arguments().parse_args()))
    if MPI.COMM_WORLD.rank == 0:
        for key, value in summary.items():
            print(f"{key:32s} {value}")
