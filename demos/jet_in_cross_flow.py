"""The two-dimensional bidisperse particle jet in a cross flow of Radl et al. (2015), their Table 2 and figures 6 to 8.

Air of 25.4 m/s blows through a channel of 1.8 x 0.7 m, 2 mm deep; particles of 5 and 20 um, half of the mass each, come up
through a slot in its floor at 15 m/s, half as much mass as air. What the paper leaves open is chosen here once:

- The slot lies 0.20 to 0.25 m from the inlet, as in the DPMFoam case that this one is compared with: a quarter of the height
  away from the inlet, so that this does not feel it, and wide enough for five of the paper's cells. Air comes through it
  as fast as the particles, as in the jet of Table 3: without it small particles pile up on the floor, and explicit coupling
  does not hold even half of the paper's step.
- Mass loading is the mass of particles over that of the air through the inlet.
- A uniform inlet, pressure zero at the outlet, a no-slip floor and a frictionless roof, whose layer would be thinner than a
  cell and far from the jet. Particles leave through inlet and outlet and rebound from floor and roof without loss.
- Gravity is left out: the settling velocities, 2 and 30 mm/s, are a thousandth of that of the air.
- The paper's drag (Beetstra) and laminar stress; no contacts, as the solid fraction is 0.005 in the slot, and less beyond.
- All parcels have one mass, that of large particles with the given coarse graining; small ones then stand for 64 times as
  many particles. With 20, parcels are 0.4 mm, a twenty-fifth of the paper's cells.
- Crossed squares of 20 mm, as many triangles as the paper has squares, half as wide around the slot and at the floor.
"""
import argparse
import logging
import sys
import time
from pathlib import Path

import matplotlib
import numpy as np
from dolfinx import mesh as dmesh
from mpi4py import MPI

import fe_el

matplotlib.use("Agg")
LENGTH, HEIGHT, THICKNESS = 1.8, 0.7, 0.002
CROSS_FLOW, RISE, LOADING = 25.4, 0.591, 0.5
GAS_DENSITY, GAS_VISCOSITY, DENSITY, SMALL, LARGE = 1.1, 1.91e-5, 2500.0, 5e-6, 20e-6
INLET, OUTLET, FLOOR, ROOF, SLOT = 1, 2, 3, 4, 5
STATIONS = (0.4, 0.8, 1.4)  # of the velocity profiles [m]
BLOCKS = 6  # of time, for the errors of means
SCHEMES = sorted(fe_el.schemes.SCHEMES)
CLOSURES = {"none": lambda: None, "smagorinsky": fe_el.Smagorinsky, "vreman": fe_el.Vreman, "wale": fe_el.Wale}


def arguments():
    """Command line of the demo."""
    p = argparse.ArgumentParser(description=__doc__.split("\n\n")[0], formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    p.add_argument("--coupling", default="conservative", choices=SCHEMES, help="scheme of the momentum exchange")
    p.add_argument("--time-step", type=float, default=4.9e-5, help="[s]; the paper: 1e-5, implicit schemes 4.9e-5")
    p.add_argument("--end-time", type=float, default=0.2, help="simulated time [s]; the second half is averaged")
    p.add_argument("--coarse-graining", type=float, default=20.0, help="parcel over particle diameter of large particles")
    p.add_argument("--smoothing-length", type=float, help="in diameters of parcels; absent: no smoothing")
    p.add_argument("--cells", type=int, nargs=2, default=(90, 35), help="squares along and across, four triangles each")
    p.add_argument("--refinement", type=float, default=2.0, help="how much smaller squares are at the slot; 1: all equal")
    p.add_argument("--closure", default="none", choices=sorted(CLOSURES), help="eddy viscosity")
    p.add_argument("--slot", type=float, nargs=2, default=(0.2, 0.05), help="begin and width of the slot [m]")
    p.add_argument("--slot-air", type=float, default=1.0, help="velocity of the air in the slot over that of particles")
    p.add_argument("--output-every", type=float, default=0.01, help="time between ParaView outputs [s]")
    p.add_argument("--report", choices=("schemes", "left-open"), help="schemes and steps, or what is left open, compared")
    p.add_argument("--seed", type=int, default=1, help="seed of the places of parcels")
    p.add_argument("--output", default="out/jet_in_cross_flow", help="folder for results")
    return p


def graded(x, length, centre, width, refinement):
    """Coordinates with spacings that are smaller by ``refinement`` near a centre than far from it."""
    fine = np.linspace(0, length, 2001)
    density = 1 + (refinement - 1) * np.exp(-((fine - centre) / width) ** 2)
    along = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
    return np.interp(x / length, along / along[-1], fine)


def channel(cells, refinement, slot):
    """Mesh of crossed squares, finer at the slot and the floor, and its facet tags."""
    mesh, tags = fe_el.box((LENGTH, HEIGHT), cells)
    x, ends = mesh.geometry.x, (slot[0], slot[0] + slot[1])
    columns = graded(np.linspace(0, LENGTH, cells[0] + 1), LENGTH, sum(ends) / 2, 0.25, refinement)
    first = int(np.argmin(np.abs(columns - ends[0])))
    last = max(int(np.argmin(np.abs(columns - ends[1]))), first + 1)
    x[:, 0] = graded(x[:, 0], LENGTH, sum(ends) / 2, 0.25, refinement)
    x[:, 0] = np.interp(x[:, 0], [0, columns[first], columns[last], LENGTH], [0, *ends, LENGTH])  # columns end at the slot
    x[:, 1] = graded(x[:, 1], HEIGHT, 0.0, 0.2, refinement)
    middle, values = dmesh.compute_midpoints(mesh, 1, tags.indices)[:, 0], tags.values.copy()
    values[(values == FLOOR) & (middle > ends[0]) & (middle < ends[1])] = SLOT
    return mesh, dmesh.meshtags(mesh, 1, tags.indices, values)


class Jet:
    """Air, parcels, injector and coupling."""

    def __init__(self, coupling="conservative", coarse_graining=20.0, smoothing_length=None, cells=(90, 35), refinement=2.0,
                 closure="none", slot=(0.2, 0.05), slot_air=1.0, seed=1):
        self.mesh, tags = channel(cells, refinement, slot)
        self.air = fe_el.VolumeAveragedNavierStokes(self.mesh, tags, GAS_DENSITY, GAS_VISCOSITY, tolerance=1e-6,
                                                    turbulence=CLOSURES[closure]())
        self.air.set_velocity(INLET, (CROSS_FLOW, 0.0))
        self.air.set_pressure(OUTLET)
        self.air.set_no_slip((FLOOR,) if slot_air else (FLOOR, SLOT))
        if slot_air:
            self.air.set_velocity(SLOT, (0.0, slot_air * RISE * CROSS_FLOW))
        self.air.set_slip(ROOF)
        self.air.set_initial_velocity((CROSS_FLOW, 0.0))
        self.parcels = fe_el.Particles(self.mesh, DENSITY, thickness=THICKNESS)
        self.parcels.remove_at(tags, (INLET, OUTLET))
        self.parcels.rebound_at(tags, (FLOOR, ROOF, SLOT))
        source = fe_el.DiscSource((slot[0] + 0.5 * slot[1], 0.0), (0.0, 1.0), slot[1])
        sizes = fe_el.SizeDistribution.listed([SMALL, LARGE], [1, 1], by="mass")
        self.jet = fe_el.Injector(self.parcels, source, (0.0, RISE * CROSS_FLOW), sizes, seed=seed,
                                  mass_rate=LOADING * GAS_DENSITY * CROSS_FLOW * HEIGHT * THICKNESS,
                                  number=lambda d: (coarse_graining * LARGE / d) ** 3)
        smoothing = None
        if smoothing_length:
            smoothing = fe_el.HelmholtzSmoothing(self.mesh, smoothing_length * coarse_graining * LARGE)
        self.coupling = fe_el.Coupling.of(self.air, self.parcels, [fe_el.Drag("beetstra"), fe_el.PressureGradient()],
                                          scheme=coupling, smoothing=smoothing)

    def advance(self, dt):
        """One time step."""
        self.jet.advance(dt)
        self.coupling.to_fluid(dt)
        self.air.advance(dt, self.coupling.fields)
        self.coupling.to_particles(dt)
        self.parcels.advance(dt)

    def fastest(self):
        """Largest speed of the air [m/s]."""
        speed = np.linalg.norm(self.air.velocity.x.array.reshape(-1, 2), axis=1)
        return self.mesh.comm.allreduce(float(speed.max()), op=MPI.MAX)


class Record:
    """Velocity profiles, mean heights of the parcels against x, and the mean field of the second half of a run."""

    def __init__(self, scene, end_time, bins=36):
        self.scene, self.coupling, self.begin, self.imbalance = scene, scene.coupling, 0.5 * end_time, []
        self.height = np.linspace(0, HEIGHT, 71)[:-1] + 0.5 * HEIGHT / 70
        points = [(x, y) for x in STATIONS for y in self.height]
        self.probe, self.average = fe_el.Probe([scene.air.velocity], points), fe_el.TimeAverage(scene.air.velocity)
        self.edges, self.rows = np.linspace(0, LENGTH, bins + 1), []

    def __call__(self, now, dt):
        """Look at the state after a step."""
        self.imbalance.append((self.coupling.momentum_imbalance, *self.coupling.force_given, *self.coupling.force_missing))
        if now > self.begin:
            self.average.add(dt)

    def sample(self, now):
        """Keep profiles and heights."""
        if now <= self.begin:
            return
        self.probe.record(now)
        p, out = self.scene.parcels, []
        for kind in (p.primary_diameter < 0.5 * (SMALL + LARGE), p.primary_diameter > 0.5 * (SMALL + LARGE)):
            x, y, mass = p.position[kind, 0], p.position[kind, 1], p.mass[kind]
            out += [np.histogram(x, self.edges, weights=w)[0] for w in (mass, mass * y)]
        self.rows.append(p.comm.allreduce(np.array(out)))

    def profiles(self):
        """Mean velocity along the channel (stations, heights) [m/s], and its standard error."""
        values = np.array([row[1][:, 0] for row in self.probe.rows]).reshape(-1, len(STATIONS), len(self.height))
        return means(values)

    def heights(self):
        """Mean height (small, large, all; bins) of the mass against x [m], and its standard error."""
        small, small_y, large, large_y = np.moveaxis(np.array(self.rows), 1, 0)
        mass = np.stack([small, large, small + large], 1)
        moment = np.stack([small_y, large_y, small_y + large_y], 1)
        whole = moment.sum(0) / np.maximum(mass.sum(0), 1e-300)
        parts = [(b.sum(0), m.sum(0)) for b, m in zip(np.array_split(moment, BLOCKS), np.array_split(mass, BLOCKS))]
        blocks = [b / np.maximum(m, 1e-300) for b, m in parts]
        return np.where(mass.sum(0) > 0, whole, np.nan), np.std(blocks, 0, ddof=1) / BLOCKS ** 0.5

    def penetration(self):
        """Mean height of the mass behind x = 1 m, and its standard error [m]."""
        behind = self.edges[:-1] > 0.999
        rows = np.array(self.rows)[:, :, behind].sum(2)
        values = (rows[:, 1] + rows[:, 3]) / np.maximum(rows[:, 0] + rows[:, 2], 1e-300)
        return means(values)


def means(values):
    """Mean over time (first axis), and its standard error by blocks."""
    parts = [b.mean(0) for b in np.array_split(values, BLOCKS)]
    return values.mean(0), np.std(parts, 0, ddof=1) / BLOCKS ** 0.5


def main(coupling="conservative", time_step=4.9e-5, end_time=0.2, coarse_graining=20.0, smoothing_length=None,
         cells=(90, 35), refinement=2.0, closure="none", slot=(0.2, 0.05), slot_air=1.0, output_every=0.01, seed=1,
         output="out/jet_in_cross_flow", progress=True):
    """Run the jet and return the summary."""
    if not 0 < slot[0] < slot[0] + slot[1] < LENGTH:
        raise ValueError(f"--slot is {list(slot)}; give its begin and width so that it lies between 0 and {LENGTH} m.")
    logging.getLogger().setLevel(logging.WARNING)
    scene = Jet(coupling, coarse_graining, smoothing_length, cells, refinement, closure, slot, slot_air, seed)
    record, comm = Record(scene, end_time), scene.mesh.comm
    out = fe_el.ParaViewOutput(output, scene.parcels, [scene.air.velocity, scene.air.pressure, scene.coupling.fields[0]],
                               output_every) if output_every else None
    every, stable, start, spent = max(round(2e-4 / time_step), 1), True, time.perf_counter(), []
    for step, now in enumerate(fe_el.time_steps(time_step, end_time, progress=progress), 1):
        tick = time.process_time()
        try:
            scene.advance(time_step)
            spent.append(time.process_time() - tick)
            if not scene.fastest() < 20 * CROSS_FLOW:
                raise FloatingPointError(f"the air reached {scene.fastest():.3g} m/s")
        except (FloatingPointError, fe_el.SolverDiverged, fe_el.LostParticle) as error:
            stable = False
            if comm.rank == 0:
                print(f"Unstable after {step} steps: {error}")
            break
        record(now, time_step)
        if step % every == 0:
            record.sample(now)
        if out:
            out.write(now)
    wall = time.perf_counter() - start
    return finish(output, scene, record, {
        "coupling": coupling, "time_step": time_step, "end_time": end_time, "coarse_graining": coarse_graining,
        "closure": closure, "steps": step, "stable": stable, "wall_time": wall,
        "processor_milliseconds_per_step": 1e3 * np.mean(spent[len(spent) // 2:] or np.nan),
        "cells": comm.allreduce(scene.air.num_cells), "courant": scene.air.courant(time_step) if stable else None})


def finish(output, scene, record, numbers):
    """Write curves, picture and summary."""
    p, jet, comm = scene.parcels, scene.jet, scene.mesh.comm
    held, errors = comm.allreduce(p.mass.sum()), np.array(record.imbalance).reshape(-1, 5)
    late = errors[len(errors) // 2:].mean(0) if len(errors) else np.full(5, np.nan)
    numbers |= {"parcels": p.total_number, "parcels_in": jet.parcels, "parcels_left": p.left,
                "mass_balance": abs(held + p.left_mass - jet.mass) / max(jet.mass, 1e-300),
                "third_law_error": late[0], "largest_third_law_error": errors[:, 0].max(initial=0.0),
                "third_law_error_of_means": np.hypot(*late[3:]) / np.hypot(*late[1:3])}
    if numbers["stable"] and len(record.rows) >= BLOCKS:
        penetration, error = record.penetration()
        numbers |= {"penetration": penetration, "penetration_error": error}
        if comm.rank == 0:
            write(Path(output), record)
            picture(Path(output), scene, record, numbers)
    return fe_el.write_summary(output, comm, **numbers, **fe_el.stage_seconds(scene.air, scene.coupling))


def write(folder, record):
    """CSV of profiles and heights."""
    folder.mkdir(parents=True, exist_ok=True)
    (profile, error), (height, spread) = record.profiles(), record.heights()
    rows = np.column_stack([record.height, *[a for pair in zip(profile, error) for a in pair]])
    names = ["y_m"] + [f"{what}_at_{x:g}_m_s" for x in STATIONS for what in ("velocity", "error")]
    np.savetxt(folder / "profiles.csv", rows, delimiter=",", header=",".join(names), comments="", fmt="%.6g")
    middle = 0.5 * (record.edges[1:] + record.edges[:-1])
    rows = np.column_stack([middle, *[a for pair in zip(height, spread) for a in pair]])
    names = ["x_m"] + [f"{what}_{kind}_m" for kind in ("small", "large", "all") for what in ("height", "error")]
    np.savetxt(folder / "heights.csv", rows, delimiter=",", header=",".join(names), comments="", fmt="%.6g")


def picture(folder, scene, record, numbers):
    """PNG: mean speed of the air, parcels, profiles and heights."""
    from matplotlib import pyplot as plt
    figure = plt.figure(figsize=(11, 9), layout="constrained")
    grid = figure.add_gridspec(3, 2)
    top, middle, left, right = (figure.add_subplot(grid[k]) for k in ((0, slice(None)), (1, slice(None)), (2, 0), (2, 1)))
    n = scene.air.num_cells
    speed = np.linalg.norm(record.average.mean.reshape(-1, 2)[:n], axis=1)
    corner = scene.parcels.cells.corner[:n]
    shown = top.tripcolor(corner[:, :, 0].ravel(), corner[:, :, 1].ravel(), np.arange(3 * n).reshape(-1, 3), speed,
                          cmap="viridis")
    figure.colorbar(shown, ax=top, label="mean speed of the air [m/s]")
    p = scene.parcels
    small = p.primary_diameter < 0.5 * (SMALL + LARGE)
    for kind, colour, size, label in ((small, "tab:blue", 0.4, "5 um"), (~small, "tab:red", 1.2, "20 um")):
        middle.plot(*p.position[kind, :2].T, ".", ms=size, color=colour, label=label)
    middle.legend(loc="upper right", markerscale=8, fontsize=8)
    for axis in (top, middle):
        axis.set(xlim=(0, LENGTH), ylim=(0, HEIGHT), ylabel="y [m]", aspect="equal")
    for x, mean, error in zip(STATIONS, *record.profiles()):
        left.fill_betweenx(record.height, mean - error, mean + error, alpha=0.3)
        left.plot(mean, record.height, label=f"x = {x:g} m")
    left.set(xlabel="mean velocity along the channel [m/s]", ylabel="y [m]")
    left.legend(fontsize=8)
    for name, mean, error in zip(("5 um", "20 um"), *record.heights()):
        right.errorbar(0.5 * (record.edges[1:] + record.edges[:-1]), mean, error, label=name, capsize=2)
    right.set(xlabel="x [m]", ylabel="mean height [m]", xlim=(0, LENGTH), ylim=(0, None))
    right.legend(fontsize=8)
    figure.suptitle(f"{numbers['coupling']}, step {numbers['time_step']:g} s", fontsize=10)
    figure.savefig(folder / "jet_in_cross_flow.png", dpi=100)
    plt.close(figure)


def command(options):
    """What the command line asks for."""
    report = options.pop("report")
    if not report:
        return main(**options)
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    from demos import jet_report
    return jet_report.main(options, jet_report.RUNS[report])


if __name__ == "__main__":
    summary = command(vars(arguments().parse_args()))
    if MPI.COMM_WORLD.rank == 0:
        for key, value in summary.items():
            print(f"{key:32s} {value}")
