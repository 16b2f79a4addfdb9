"""Flow past a cylinder in a channel, the benchmark of Schaefer and Turek (1996): 2D-1 (Re 20, steady) and 2D-2 (Re 100,
shedding)."""
import argparse
import logging
import sys
import time
from pathlib import Path

import matplotlib
import numpy as np

import fe_el

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from demos import reports, restarts

matplotlib.use("Agg")
INLET, OUTLET, WALLS, CYLINDER = 1, 2, 3, 4
HEIGHT, DIAMETER, VISCOSITY = 0.41, 0.1, 1e-3
MESH = Path(__file__).resolve().parent.parent / "meshes" / "cylinder.geo"
STEADY = {"drag": 5.57953523384, "lift": 0.010618948146, "pressure_difference": 0.11752016697}  # Nabh (1998)
SHEDDING = {"strouhal": (0.295, 0.305), "largest_drag": (3.22, 3.24), "largest_lift": (0.99, 1.01)}  # Schaefer and Turek
REPORTS = {
    "steady": reports.Report(
        settings=tuple({"around": n, "time_step": dt} for n, dt in (
            (128, 0.05), (64, 0.05), (64, 0.2), (32, 0.05), (32, 0.2), (32, 0.8), (16, 0.2))),
        quantities={name: STEADY[name] for name in ("drag", "pressure_difference")},
        same={"reynolds": 20.0, "end_time": 12.0},
        first={"end_time": 0.1}),
    "shedding": reports.Report(
        settings=tuple({"around": n, "time_step": dt} for n, dt in (
            (128, 0.0025), (128, 0.005), (64, 0.0025), (64, 0.005), (64, 0.01), (32, 0.005), (32, 0.01), (32, 0.02))),
        quantities={name: sum(value) / 2 for name, value in SHEDDING.items()},
        same={"reynolds": 100.0, "size": 0.06, "end_time": 6.0}, first={"end_time": 0.05}, within=0.03)}


def arguments():
    """Command line of the demo."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    p.add_argument("--reynolds", type=float, default=100.0,
                   help="of the mean velocity and the diameter; 20: steady, 100: shedding")
    p.add_argument("--around", type=int, default=64, help="segments on the cylinder, a multiple of four")
    p.add_argument("--size", type=float, default=0.04, help="edges far from the cylinder [m]")
    p.add_argument("--growth", type=float, default=0.1, help="gain of size per distance from the cylinder")
    p.add_argument("--time-step", type=float, default=0.01, help="[s]")
    p.add_argument("--end-time", type=float, default=8.0, help="[s]")
    p.add_argument("--output-every", type=float, default=0.5, help="time between ParaView outputs [s]")
    p.add_argument("--output", default="out/flow_past_cylinder", help="folder for results")
    restarts.add_arguments(p)
    return p


def channel(reynolds, around, size, growth):
    """The fluid, with a start that is not symmetric so that vortices shed soon, and its mean velocity [m/s]."""
    mesh, _, tags = fe_el.mesh_geo(MESH, dimension=2, around=around, size=size, growth=growth)
    mean = reynolds * VISCOSITY / DIAMETER

    def inflow(time, x):
        return np.column_stack([6 * mean * x[:, 1] * (HEIGHT - x[:, 1]) / HEIGHT ** 2, 0 * x[:, 1]])

    def start(time, x):
        bump = 0.5 * mean * np.exp(-((x[:, 0] - 0.35) ** 2 + (x[:, 1] - 0.2) ** 2) / 0.05 ** 2)
        return inflow(time, x) + np.column_stack([0 * bump, bump])
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, 1.0, VISCOSITY, tolerance=1e-7)
    air.set_velocity(INLET, inflow)
    air.set_pressure(OUTLET, 0.0)
    air.set_no_slip(WALLS)
    air.set_no_slip(CYLINDER)
    air.set_initial_velocity(start)
    return air, mean


def strouhal_number(times, lift, mean):
    """Shedding frequency over the last half of the run times diameter over mean velocity; not a number without two
    periods."""
    late = times > 0.5 * times[-1]
    t, y = times[late], lift[late] - lift[late].mean()
    k = np.flatnonzero((y[:-1] < 0) & (y[1:] >= 0))
    crossing = t[k] - y[k] * (t[k + 1] - t[k]) / (y[k + 1] - y[k])
    return DIAMETER / (np.diff(crossing).mean() * mean) if len(crossing) > 2 else np.nan


def main(reynolds=100.0, around=64, size=0.04, growth=0.1, time_step=0.01, end_time=8.0, output_every=0.5,
         output="out/flow_past_cylinder", checkpoint_every=None, restart=None, wall_time=None, progress=True):
    """Run the flow and return the summary."""
    logging.getLogger().setLevel(logging.WARNING)
    air, mean = channel(reynolds, around, size, growth)
    comm, scale = air.comm, 2 / (mean ** 2 * DIAMETER)
    probe = fe_el.Probe([air.pressure], [(0.15, 0.2), (0.25, 0.2)])
    out = fe_el.ParaViewOutput(output, None, [air.velocity, air.pressure], output_every)
    keep, rows = restarts.Restarts(output, time_step, checkpoint_every, restart, wall_time), restarts.Rows()
    checkpoints, start, processor = keep.checkpoints(air, out, rows), time.perf_counter(), time.process_time()
    with out, checkpoints:
        for now in keep.steps(checkpoints.time, end_time, progress):
            air.advance(time_step)
            drag, lift = scale * sum(air.boundary_force(CYLINDER))
            front, back = probe.values()[0][:, 0]
            rows.append((now, drag, lift, front - back))
            out.write(now)
            checkpoints.after(now)
    times, drag, lift, difference = np.array(rows).T
    late = times > 0.75 * end_time
    numbers = {
        "reynolds": reynolds, "cells": comm.allreduce(air.num_cells), "time_step": time_step, "end_time": end_time,
        "courant": air.courant(time_step), "drag": drag[-1], "lift": lift[-1], "pressure_difference": difference[-1],
        "largest_drag": drag[late].max(), "largest_lift": lift[late].max(), "strouhal": strouhal_number(times, lift, mean),
        "mass_residual": air.mass_residual(), "wall_time": time.perf_counter() - start,
        "processor_time": comm.allreduce(time.process_time() - processor), **fe_el.stage_seconds(air, out)}
    if abs(reynolds - 20) < 1e-9:
        numbers |= {f"{name}_error": numbers[name] / value - 1 for name, value in STEADY.items()}
    if abs(reynolds - 100) < 1e-9:
        numbers |= {f"{name}_interval": list(value) for name, value in SHEDDING.items()}
    if comm.rank == 0:
        picture(output, times, drag, lift, numbers)
    return fe_el.write_summary(output, comm, **numbers)


def picture(output, times, drag, lift, numbers):
    """PNG: drag and lift coefficients against time."""
    from matplotlib import pyplot as plt
    figure, axis = plt.subplots(figsize=(7, 4))
    axis.plot(times, drag, label="drag coefficient")
    axis.plot(times, lift, label="lift coefficient")
    low, high = min(lift[len(lift) // 4:].min(), 0), drag[len(drag) // 4:].max()
    axis.set(xlabel="time [s]", ylim=(1.2 * low - 0.2, 1.2 * high),
             title=f"Re {numbers['reynolds']:g}, {numbers['cells']} triangles")
    axis.legend()
    figure.tight_layout()
    figure.savefig(Path(output) / "forces.png", dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    reports.start(main, arguments(), REPORTS)
