"""The jet of Salzman and Schwarz (1978) as Radl et al. (2015) computed it: gas and particles of 15 um out of a round nozzle
into a cross flow.

Given (Table 3 of the paper): nozzle 4.62 mm; particles 15 um, 2638 kg/m^3; air 1.1 kg/m^3, 1.91e-5 Pa s; in the jet 20.8 kg
of particles for each of air, as fast as the air, 1.57 times the cross flow of 16.8 m/s. Not given, and chosen here:

- The channel is 255 x 157 x 40 mm: the paper's 510 x 314 x 79 cells, if these are cubes of 0.5 mm, a ninth of the nozzle.
- The nozzle is in the middle of the floor, 30 mm (6.5 nozzles) from the inlet.
- Uniform velocities in nozzle and inlet; a wall law on the floor, slip on the other sides, whose layers the jet does not
  meet.
- The drag of Beetstra et al.; no gravity, which gives 0.1 m/s in the time of passage; no collisions: particles start with
  one velocity, and 0.9 % of the jet is solid.
- Smoothing over 1.125 mm: a quarter of the nozzle, and three diameters of a parcel of coarse graining 25. So heights do not
  depend on the parcels; with three diameters of each, as the paper has it, or with none, they do (table in demos/README.md).

Heights are means of all particles by mass over time, against the way from the nozzle. The trajectory beside them is that of
one particle with Stokes' drag in the undisturbed cross flow, 45.5 mm high at the end.
    python demos/salzman_jet.py --coarse-graining 25 40 60
    mpirun -n 2 python -m mpi4py demos/salzman_jet.py
"""
import argparse
import logging
import sys
import time
from pathlib import Path

import matplotlib
import numpy as np
from mpi4py import MPI

import fe_el

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from demos import restarts

matplotlib.use("Agg")
INLET, OUTLET, FLOOR, SIDES, NOZZLE = 1, 2, 3, 4, 5
MESH = Path(__file__).resolve().parent.parent / "meshes" / "salzman_jet.geo"
NOZZLE_DIAMETER, NOZZLE_AT, LENGTH = 4.62e-3, 0.03, 0.255
DIAMETER, PARTICLE_DENSITY, GAS_DENSITY, GAS_VISCOSITY = 15e-6, 2638.0, 1.1, 1.91e-5
CROSS_FLOW, JET, LOADING = 16.8, 1.57 * 16.8, 20.8
STATIONS = (0.05, 0.1, 0.2)  # way from the nozzle [m]
BLOCKS = 4  # of the time averaged over, for the error of the means
CLOSURES = {"wale": fe_el.Wale, "vreman": fe_el.Vreman, "smagorinsky": fe_el.Smagorinsky, "none": lambda: None}


def arguments():
    """Command line of the demo."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--coarse-graining", type=float, nargs="+", default=[25.0],
                   help="parcel over particle diameter, one run each (25)")
    p.add_argument("--smoothing-length", type=float, default=1.125e-3, help="[m]; 0: none (1.125e-3)")
    p.add_argument("--cells", type=float, default=3.0, help="edges across the nozzle (3)")
    p.add_argument("--closure", choices=CLOSURES, default="wale", help="eddy viscosity (wale)")
    p.add_argument("--coupling", default="conservative", help="scheme of the coupling (conservative)")
    p.add_argument("--intensity", type=float, default=0.0, help="turbulence of the cross flow, eddies of 10 mm (0)")
    p.add_argument("--time-step", type=float, default=1e-4, help="[s] (1e-4)")
    p.add_argument("--end-time", type=float, default=0.05, help="of each run [s] (0.05)")
    p.add_argument("--average-from", type=float, default=0.02, help="start of the means [s] (0.02)")
    p.add_argument("--output", default="out/salzman_jet", help="folder for results (out/salzman_jet)")
    p.add_argument("--report", action="store_true", help="error of the penetration against cost, over parcels, mesh, step")
    restarts.add_arguments(p)
    return p


def stokes_height(way):
    """Height [m] of a particle with Stokes' drag in the undisturbed cross flow at ways from the nozzle [m]."""
    tau = PARTICLE_DENSITY * DIAMETER ** 2 / (18 * GAS_VISCOSITY)
    t = np.linspace(0, 0.05, 20001)
    rise = 1 - np.exp(-t / tau)
    return np.interp(way, CROSS_FLOW * (t - tau * rise), JET * tau * rise)


def assemble(coarse_graining, smoothing_length, cells, closure, coupling, intensity, **_):
    """Gas, parcels, injector and coupling."""
    mesh, _, tags = fe_el.mesh_geo(MESH, dimension=3, cells=cells, growth=0.56 / cells, size=0.024 / cells)
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, GAS_DENSITY, GAS_VISCOSITY, tolerance=1e-6,
                                           turbulence=CLOSURES[closure]())
    area = air.comm.allreduce(float(np.linalg.norm(air.boundary(NOZZLE).area_normal, axis=1).sum()))
    whole = np.pi / 4 * NOZZLE_DIAMETER ** 2  # the nozzle of the mesh is a polygon: the gas keeps its rate
    cross = (CROSS_FLOW, 0.0, 0.0)
    air.set_velocity(INLET, fe_el.SyntheticEddies(air, INLET, cross, intensity, 0.01) if intensity else cross)
    air.set_velocity(NOZZLE, (0.0, JET * whole / area, 0.0))
    air.set_pressure(OUTLET)
    air.set_no_slip(FLOOR, law=fe_el.Spalding())
    air.set_slip(SIDES)
    air.set_initial_velocity(cross)
    parcels = fe_el.Particles(mesh, PARTICLE_DENSITY)
    parcels.remove_at(tags, OUTLET)
    parcels.rebound_at(tags, (INLET, FLOOR, SIDES, NOZZLE), restitution=0.9)
    disc = fe_el.DiscSource((NOZZLE_AT, 0, 0), (0, 1, 0), 0.999 * NOZZLE_DIAMETER * np.sqrt(area / whole))
    injector = fe_el.Injector(parcels, disc, (0, JET, 0), DIAMETER, mass_rate=LOADING * GAS_DENSITY * JET * whole,
                              coarse_graining=coarse_graining, seed=1)
    smoothing = fe_el.HelmholtzSmoothing(mesh, smoothing_length) if smoothing_length else None
    exchange = fe_el.Coupling.of(air, parcels, [fe_el.Drag("beetstra"), fe_el.PressureGradient()], scheme=coupling,
                                 smoothing=smoothing)
    return air, parcels, injector, exchange


class Means:
    """What is averaged: heights against the way, whole and in blocks of the time, fields, and fluxes through planes."""

    def __init__(self, parcels, start, end):
        self.start, self.length = start, (end - start) / BLOCKS
        edges = NOZZLE_AT + np.linspace(0, LENGTH - NOZZLE_AT, 46)
        self.heights = [fe_el.ParticleProfile(parcels, edges, lambda p: p.position[:, 1]) for _ in range(1 + BLOCKS)]
        self.fields = fe_el.ParticleFieldAverage(parcels)
        self.plane = fe_el.PlaneFlux(parcels, (NOZZLE_AT + STATIONS[1], 0, 0), (1, 0, 0))
        self.way = self.heights[0].middle - NOZZLE_AT

    def add(self, now, dt):
        """Add the parcels of now."""
        if now <= self.start:
            return
        block = min(int((now - self.start) / self.length), BLOCKS - 1)
        for observer in (self.heights[0], self.heights[1 + block], self.fields, self.plane):
            observer.add(dt)

    def observers(self):
        """All that is averaged, for checkpoints."""
        return *self.heights, self.fields, self.plane

    def at_stations(self):
        """Mean heights and their standard errors [m], and mean heights over those of Stokes' drag."""
        rows = np.array([np.interp(STATIONS, self.way, h.mean) for h in self.heights])
        return rows[0], rows[1:].std(0, ddof=1) / np.sqrt(BLOCKS), rows[0] / stokes_height(np.array(STATIONS))


def one_run(options, folder, progress):
    """Run one jet; returns its means, its last state and its numbers."""
    air, parcels, injector, coupling = assemble(**options)
    dt, end, wall, processor = options["time_step"], options["end_time"], time.perf_counter(), time.process_time()
    keep = restarts.Restarts(folder, *(options[k] for k in ("time_step", "checkpoint_every", "restart", "wall_time")))
    means, largest = Means(parcels, options["average_from"], end), restarts.Kept(imbalance=0.0, solid_fraction=0.0)
    with fe_el.ParaViewOutput(folder, parcels, [air.velocity, air.pressure, coupling.fields[0]], end / 10) as out, \
            keep.checkpoints(parcels, air, injector, coupling, out, *means.observers(), largest) as checkpoints:
        for now in keep.steps(checkpoints.time, end, progress):
            injector.advance(dt)
            coupling.to_fluid(dt)
            air.advance(dt, coupling.fields)
            coupling.to_particles(dt)
            parcels.advance(dt)
            means.add(now, dt)
            largest["imbalance"] = max(largest["imbalance"], coupling.momentum_imbalance)
            largest["solid_fraction"] = max(largest["solid_fraction"], coupling.max_solid_fraction)
            out.write(now)
            checkpoints.after(now)
    heights, errors, ratios = means.at_stations()
    held = parcels.comm.allreduce(float(parcels.mass.sum()))
    numbers = {"parcels": parcels.total_number, "cells": parcels.comm.allreduce(air.num_cells), "time_step": dt,
               "courant": air.courant(dt), "smoothing_length": getattr(coupling.smoothing, "length", 0.0),
               "largest_solid_fraction": largest["solid_fraction"], "momentum_imbalance": largest["imbalance"],
               "mass_error": abs(held + parcels.left_mass - injector.mass) / injector.mass,
               "flux_through_plane_over_injected": means.plane.mass_rate * end / injector.mass,
               "seconds_per_step": (time.perf_counter() - wall) * dt / end, "wall_time": time.perf_counter() - wall,
               "processor_time": parcels.comm.allreduce(time.process_time() - processor),
               **fe_el.stage_seconds(air, coupling, out)}
    for way, height, error, ratio in zip(STATIONS, heights, errors, ratios):
        key = f"at_{1e3 * way:g}_mm"
        numbers |= {f"height_{key}": height, f"height_error_{key}": error, f"over_stokes_{key}": ratio}
    return means, (air, parcels), numbers


def main(coarse_graining=(25.0,), smoothing_length=1.125e-3, cells=3.0, closure="wale", coupling="conservative",
         intensity=0.0, time_step=1e-4, end_time=0.05, average_from=0.02, output="out/salzman_jet", checkpoint_every=None,
         restart=None, wall_time=None, progress=True):
    """Run the jets and return the summary."""
    if not 0 <= average_from < end_time:
        raise ValueError(f"--average-from is {average_from}; give a time before the end, {end_time} s.")
    if restart not in (None, True):
        raise ValueError(f"--restart is {restart}; each run goes on from the checkpoint in its own folder: give it "
                         "without a name.")
    logging.getLogger().setLevel(logging.WARNING)
    options, runs, summary = dict(locals()), {}, {}
    for ratio in coarse_graining:
        folder = Path(output) / f"coarse_graining_{ratio:g}"
        means, state, numbers = one_run({**options, "coarse_graining": ratio}, folder, progress)
        runs[ratio] = means.way, means.heights[0].mean, means.heights[0].deviation
        picture_of_fields(folder, means, *state)
        summary |= {f"coarse_graining_{ratio:g}_{key}": value for key, value in numbers.items()}
    if MPI.COMM_WORLD.rank == 0:
        picture_of_heights(output, runs)
    return fe_el.write_summary(output, MPI.COMM_WORLD, closure=closure, coupling=coupling, **summary)


def picture_of_heights(output, runs):
    """PNG: mean height of the particles against the way from the nozzle, beside Stokes' drag in undisturbed flow."""
    from matplotlib import pyplot as plt
    figure, axis = plt.subplots(figsize=(7, 4), layout="constrained")
    for ratio, (way, mean, deviation) in runs.items():
        line, = axis.plot(1e3 * way, 1e3 * mean, label=f"coarse graining {ratio:g}")
        axis.fill_between(1e3 * way, 1e3 * (mean - deviation), 1e3 * (mean + deviation), color=line.get_color(), alpha=0.12)
    way = np.linspace(0, LENGTH - NOZZLE_AT, 200)
    for factor, label in ((1, "Stokes' drag, undisturbed flow"), (1.5, "1.5 and 2 times that (the paper)"), (2, None)):
        axis.plot(1e3 * way, 1e3 * factor * stokes_height(way), "k--" if factor == 1 else "k:", lw=1, label=label)
    axis.set(xlabel="way from the nozzle [mm]", ylabel="mean height of the particles [mm]", ylim=(0, None))
    axis.legend(fontsize=8)
    figure.savefig(Path(output) / "heights.png", dpi=110)
    plt.close(figure)


def picture_of_fields(folder, means, air, parcels):
    """PNG: gas velocity and parcels in the middle plane, and mean solid fraction across the jet. Collective."""
    comm, n = air.comm, air.num_cells
    speed, near = air.velocity.x.array.reshape(-1, 3)[:n, 0], np.abs(parcels.position[:, 2]) < NOZZLE_DIAMETER / 2
    rows = np.column_stack([air.corner.mean(1), air.h, speed, means.fields.solid_fraction])
    rows, points = (comm.gather(a) for a in (rows, parcels.position[near]))
    if comm.rank:
        return
    from matplotlib import pyplot as plt
    (x, y, z, h, speed, solid), points = np.concatenate(rows).T, np.concatenate(points)
    figure, axes = plt.subplots(1, 3, figsize=(15, 4.4), width_ratios=(3, 1, 1), layout="constrained")
    near = np.abs(z) < 0.6 * h
    drawn = axes[0].tripcolor(1e3 * x[near], 1e3 * y[near], speed[near], shading="gouraud", cmap="coolwarm")
    figure.colorbar(drawn, ax=axes[0], label="gas velocity along x [m/s]")
    axes[0].plot(*1e3 * points[::max(len(points) // 4000, 1), :2].T, "k,")
    axes[0].set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", title="at the end, in the middle plane")
    for axis, way in zip(axes[1:], STATIONS):
        near = np.abs(x - NOZZLE_AT - way) < 0.6 * h
        drawn = axis.tripcolor(1e3 * z[near], 1e3 * y[near], solid[near], shading="gouraud", cmap="magma_r")
        figure.colorbar(drawn, ax=axis)
        axis.set(xlabel="z [mm]", aspect="equal", ylim=(0, 120), title=f"mean solid fraction, {1e3 * way:g} mm")
    figure.savefig(Path(folder) / "fields.png", dpi=110)
    plt.close(figure)


def command(options):
    """What the command line asks for."""
    if not options.pop("report"):
        return main(**options)
    from demos import salzman_report
    return salzman_report.main(options)


if __name__ == "__main__":
    summary = command(vars(arguments().parse_args()))
    if MPI.COMM_WORLD.rank == 0:
        for key, value in summary.items():
            print(f"{key:60s} {value}")
