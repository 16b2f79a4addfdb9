"""Pressure drop of a bed against gas velocity, up through minimum fluidisation and down again, beside Ergun's equation.

CFDEMcoupling's Ergun test: 10,000 beads of 1 mm and 2000 kg/m^3 in a cylinder of 13.85 mm radius, a gas of 10 kg/m^3 and
1.5e-4 m^2/s.
The beads are packed dry, the gas rises slowly from zero past the velocity of minimum fluidisation and falls again. A resting
bed follows
Ergun's equation, layer by layer of its own void fraction, less what gas gains by way of looser places (walls, and the noise
of cells that
hold a few beads); a fluidised one carries its weight. U_mf is where the curve of the resting bed reaches the weight. Three
minutes.
    python demos/minimum_fluidisation.py
"""
import argparse
import csv
import logging
import sys
from pathlib import Path

import matplotlib
import numpy as np

import fe_el

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from demos import bed_runs, reports, restarts

matplotlib.use("Agg")
RADIUS, HEIGHT, GRAVITY = 0.01385, 0.04, 9.81
DIAMETER, BEAD_DENSITY, GAS_DENSITY, GAS_VISCOSITY = 1e-3, 2000.0, 10.0, 10.0 * 1.5e-4
INLET, OUTLET, WALL = 1, 2, 3
REPORTS = {"ramp": reports.Report(
    settings=tuple({"cell_size": size, "time_step": dt, "steps_per_contact": n} for size, dt, n in (
        (0.003, 5e-4, 20), (0.003, 1e-3, 20), (0.003, 1e-3, 12), (0.003, 2e-3, 12), (0.004, 1e-3, 12), (0.004, 2e-3, 12),
        (0.005, 2e-3, 12))),
    quantities={"pressure_drop_fluidised_over_weight": 1.0, "drop_over_ergun_rising": None},
    same={"number": 6000, "ramp_time": 0.25, "settle_time": 0.1}, first={"ramp_time": 4e-3, "settle_time": 5e-3},
    within=0.05)}


def arguments():
    """Command line of the demo."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--largest-velocity", type=float, default=0.024, help="superficial velocity at the turn [m/s] (0.024)")
    p.add_argument("--ramp-time", type=float, default=1.5, help="time of each ramp [s] (1.5)")
    p.add_argument("--settle-time", type=float, default=0.25, help="time in which the beads settle without gas [s] (0.25)")
    p.add_argument("--number", type=int, default=10_000, help="beads (10000)")
    p.add_argument("--cell-size", type=float, default=0.003, help="edge length of the tetrahedra [m] (0.003)")
    p.add_argument("--time-step", type=float, default=1e-3, help="fluid time step [s] (1e-3)")
    p.add_argument("--steps-per-contact", type=int, default=20, help="contact steps in the shortest contact (20)")
    p.add_argument("--stiffness", type=float, default=50.0, help="contact stiffness [N/m] (50)")
    p.add_argument("--drag", default="ergun", help="name of the drag law (ergun)")
    p.add_argument("--seed", type=int, default=1, help="seed of the first positions (1)")
    p.add_argument("--output", default="out/minimum_fluidisation", help="folder for results (out/minimum_fluidisation)")
    restarts.add_arguments(p)
    return p


def ergun(void, velocity, height):
    """Pressure drop of a packed bed by Ergun's equation [Pa]."""
    solid = 1 - void
    return height * (150 * solid ** 2 / void ** 3 * GAS_VISCOSITY * velocity / DIAMETER ** 2
                     + 1.75 * solid / void ** 3 * GAS_DENSITY * velocity ** 2 / DIAMETER)


def minimum_velocity(void):
    """Velocity at which Ergun's pressure drop is the bed's weight in the gas [m/s]."""
    a, b = 1.75 / void ** 3 * GAS_DENSITY / DIAMETER, 150 * (1 - void) / void ** 3 * GAS_VISCOSITY / DIAMETER ** 2
    c = (BEAD_DENSITY - GAS_DENSITY) * GRAVITY
    return (np.sqrt(b * b + 4 * a * c) - b) / (2 * a)


def first_positions(number, seed):
    """Places on layers of a square lattice inside the cylinder, disturbed, shuffled with the seed."""
    step, rng = 1.12 * DIAMETER, np.random.default_rng(seed)
    side = np.arange(-RADIUS, RADIUS, step)
    x, y = (a.ravel() for a in np.meshgrid(side, side))
    keep = np.hypot(x, y) < RADIUS - 0.75 * DIAMETER
    layers = int(np.ceil(number / keep.sum()))
    at = np.concatenate([np.column_stack([x[keep], y[keep], np.full(keep.sum(), (k + 0.6) * step)])
                         for k in range(layers)])[:number]
    return at + rng.uniform(-0.05, 0.05, at.shape) * DIAMETER


def layers(beads, area):
    """Void fraction of layers one diameter thick, from the bottom up: each bead spread over 29 points; collective."""
    points = fe_el.mapping.isotropic_points()[:, 2]
    z = (beads.position[:, 2, None] + 0.5 * DIAMETER * points).ravel()
    count = np.bincount(np.clip((z / DIAMETER).astype(int), 0, None), minlength=int(HEIGHT / DIAMETER) + 2)
    solid = beads.comm.allreduce(count * np.pi / 6 * DIAMETER ** 3 / len(points)) / (area * DIAMETER)
    return 1 - solid


def bed_state(beads, area, velocity):
    """Height of the bed (twice that of its centre), its void fraction, and pressure drop by Ergun's equation with these and
    layer by layer, which is more, as layers differ and the equation is convex; collective."""
    by_layer = layers(beads, area)
    solid = 1 - by_layer
    height = 2 * DIAMETER * (solid @ (np.arange(len(solid)) + 0.5)) / solid.sum()
    void = 1 - solid.sum() * DIAMETER / height
    return height, void, ergun(void, velocity, height), ergun(by_layer, velocity, DIAMETER)[solid > 1e-3].sum()


def main(largest_velocity=0.024, ramp_time=1.5, settle_time=0.25, number=10_000, cell_size=0.003, time_step=1e-3,
         steps_per_contact=20, stiffness=50.0, drag="ergun", seed=1, output="out/minimum_fluidisation",
         checkpoint_every=None, restart=None, wall_time=None, progress=True):
    """Ramp the gas up and down and return the summary."""
    logging.getLogger().setLevel(logging.WARNING)
    mesh, _, tags = fe_el.mesh_geo(Path(__file__).resolve().parent.parent / "meshes" / "column.geo", size=cell_size)
    keep, down = restarts.Restarts(output, time_step, checkpoint_every, restart, wall_time), (0.0, 0.0, -GRAVITY)
    beads, going_on = fe_el.Particles(mesh, BEAD_DENSITY, down), keep.going_on()
    if not going_on:
        beads.insert_at(first_positions(number, seed), DIAMETER)
    law = fe_el.LinearSpringDashpot(stiffness, restitution=0.3, friction=0.5)
    contacts = fe_el.Contacts(beads, law, walls=(tags, (WALL, INLET)), steps_per_contact=steps_per_contact)
    for _ in range(0 if going_on else int(np.ceil(settle_time / 5e-3))):
        beads.advance(5e-3, contacts)
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, GAS_DENSITY, GAS_VISCOSITY, down, tolerance=1e-9)

    def speed(time):
        return largest_velocity * (1 - abs(1 - time / ramp_time))
    air.set_velocity(INLET, lambda time, x: (0.0, 0.0, speed(time)))
    air.set_pressure(OUTLET, 0.0)
    air.set_no_slip(WALL)
    coupling = fe_el.Coupling.of(air, beads, [fe_el.Drag(drag), fe_el.PressureGradient()])
    bed, rows = bed_runs.Bed(beads, contacts, air, coupling), restarts.Rows()
    area = mesh.comm.allreduce(beads.cells.volume[:beads.cells.owned].sum()) / HEIGHT

    def each(now):
        rows.append((now, speed(now), bed_runs.pressure_drop(air), *bed_state(beads, area, speed(now))))
    with fe_el.ParaViewOutput(output, beads, [air.velocity, air.pressure, coupling.fields[0]], ramp_time / 20) as out:
        numbers = bed_runs.run(bed, 2 * ramp_time, out, each, keep, 10, [rows], progress=progress)
    weight = beads.comm.allreduce(beads.mass.sum()) * GRAVITY * (1 - GAS_DENSITY / BEAD_DENSITY) / area
    return finish(output, beads.comm, np.array(rows), weight, ramp_time, numbers)


def finish(output, comm, rows, weight, ramp_time, numbers):
    """Compare with Ergun's equation and the weight; write curve, picture and summary."""
    time, velocity, drop, height, void, expected, by_layers = rows.T
    down, packed = time > ramp_time, (drop < 0.8 * weight) & (drop > 0.1 * weight)
    numbers |= {"weight_per_area": weight,
                "pressure_drop_fluidised_over_weight": drop[velocity > 0.9 * velocity.max()].mean() / weight,
                "void_fraction_at_start": void[0], "void_fraction_at_end": void[-1],
                "minimum_fluidisation_velocity_by_ergun": minimum_velocity(void[-1])}
    ratio = drop / np.maximum(expected, 1e-300)
    for name, branch in (("rising", packed & ~down), ("falling", packed & down)):
        # of a resting bed the drop is a polynomial of the velocity; where it reaches the weight is U_mf
        if branch.sum() > 3:
            curve = np.polyfit(drop[branch], velocity[branch], 2)
            numbers |= {f"drop_over_ergun_{name}": ratio[branch].mean(),
                        f"drop_over_ergun_by_layers_{name}": (drop / np.maximum(by_layers, 1e-300))[branch].mean(),
                        f"minimum_fluidisation_velocity_{name}": float(np.polyval(curve, weight))}
    if comm.rank == 0:
        with open(Path(output) / "curve.csv", "w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(["time_s", "superficial_velocity_m_s", "pressure_drop_Pa", "bed_height_m", "void_fraction",
                             "ergun_Pa", "ergun_by_layers_Pa"])
            writer.writerows(rows.tolist())
        picture(output, rows, weight, ramp_time, numbers)
    return fe_el.write_summary(output, comm, **numbers)


def picture(output, rows, weight, ramp_time, numbers):
    """PNG: pressure drop and void fraction against velocity, both ways."""
    from matplotlib import pyplot as plt
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
    up = rows[:, 0] <= ramp_time
    for part, colour, name in ((up, "C0", "rising"), (~up, "C3", "falling")):
        left.plot(1e3 * rows[part, 1], rows[part, 2], colour, label=f"velocity {name}")
        right.plot(1e3 * rows[part, 1], rows[part, 4], colour, label=f"velocity {name}")
    for part, style, name in ((up, "C0:", "rising"), (~up, "C3:", "falling")):
        left.plot(1e3 * rows[part, 1], rows[part, 5], style, label=f"Ergun, {name}")
    left.axhline(weight, color="0.5", label="weight of the bed")
    left.set(xlabel="superficial velocity [mm/s]", ylabel="pressure drop [Pa]", ylim=(0, 1.4 * weight))
    right.set(xlabel="superficial velocity [mm/s]", ylabel="void fraction of the bed")
    left.legend(fontsize=8)
    figure.savefig(Path(output) / "minimum_fluidisation.png", dpi=100)
    plt.close(figure)


if __name__ == "__main__":
    reports.start(main, arguments(), REPORTS, width=42)
