"""Turbulent flow between two plates on a mesh that does not resolve the layers at the walls: friction beside Dean's law.

A constant pressure gradient drives the flow through a periodic channel, so that the mean wall stress is known and the mean
velocity is the answer. Lengths are in half heights, velocities in friction velocities. Without a wall law the friction of
the laminar gradient across half a cell is too small, and the flow too fast; ``--no-wall-law`` shows by how much.

Dean (J. Fluids Eng. 100, 1978, 215): friction coefficient 0.073 Re^(-1/4), Re of the mean velocity and the full height.
"""
import argparse
import logging
import sys
import time
from pathlib import Path

import matplotlib
import numpy as np

import fe_el

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from demos import reports

matplotlib.use("Agg")
CLOSURES = {"none": lambda: None, "smagorinsky": fe_el.Smagorinsky, "vreman": fe_el.Vreman, "wale": fe_el.Wale}
LENGTH, WIDTH, WALLS = 6.0, 3.0, (3, 4)
REPORTS = {"friction": reports.Report(
    settings=tuple({"across": n, "closure": closure, "wall_law": law, "courant": c} for n, closure, law, c in (
        (8, "wale", True, 2.0), (8, "none", True, 2.0), (6, "wale", True, 2.0), (6, "none", True, 2.0),
        (4, "wale", True, 2.0), (4, "none", True, 2.0), (4, "vreman", True, 2.0), (4, "wale", False, 2.0))),
    quantities={"friction_coefficient": "friction_coefficient_dean"}, same={"end_time": 16.0}, first={"end_time": 1.0},
    within=0.05)}


def arguments():
    """Command line of the demo."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    p.add_argument("--across", type=int, default=8, help="cubes of six tetrahedra between the plates")
    p.add_argument("--friction-reynolds", type=float, default=2000.0, help="of the friction velocity and half the height")
    p.add_argument("--closure", choices=CLOSURES, default="wale", help="eddy viscosity")
    p.add_argument("--no-wall-law", dest="wall_law", action="store_false", help="no-slip walls without Spalding's law")
    p.add_argument("--courant", type=float, default=0.5, help="of the mean velocity and the edge of a cube")
    p.add_argument("--end-time", type=float, default=16.0, help="[half heights / friction velocity]; the last half counts")
    p.add_argument("--seed", type=int, default=1, help="of the disturbance at the start")
    p.add_argument("--output", default="out/turbulent_channel", help="folder for results")
    return p


def channel(across, reynolds, closure, wall_law, seed):
    """The fluid, from the logarithmic law with large eddies on top."""
    h = 2 / across
    mesh, tags = fe_el.periodic_box((LENGTH, 2.0, WIDTH), [round(a / h) for a in (LENGTH, 2.0, WIDTH)],
                                    periodic=(True, False, True))
    flow = fe_el.VolumeAveragedNavierStokes(mesh, tags, 1.0, 1 / reynolds, turbulence=CLOSURES[closure](),
                                            mean_pressure_gradient=(1.0, 0.0, 0.0))
    for wall in WALLS:
        flow.set_no_slip(wall, law=fe_el.Spalding() if wall_law else None)
    rng = np.random.default_rng(seed)
    phases = rng.uniform(0, 2 * np.pi, (4, 3))

    def start(now, x):
        distance = np.maximum(1 - np.abs(x[:, 1] - 1), 1e-6)
        out, fade = np.zeros((len(x), 3)), np.sin(0.5 * np.pi * x[:, 1]) ** 2
        out[:, 0] = np.log(1 + 0.4 * reynolds * distance) / 0.4 + 5.5 * (1 - np.exp(-0.1 * reynolds * distance))
        for k, (a, b, c) in enumerate(phases, 1):  # vortices along and across the stream
            along, across_stream = 2 * np.pi * k * x[:, 0] / LENGTH, 2 * np.pi * k * x[:, 2] / WIDTH
            out[:, 1] += 2 / k * fade * np.cos(across_stream + a) * np.cos(along + b)
            out[:, 0] += 2 / k * fade * np.cos(across_stream + c)
        return out
    flow.set_initial_velocity(start)
    return flow


def profile(flow, layers):
    """Volume mean of the velocity along the stream in each layer of cubes (layers,)."""
    n = flow.num_cells
    layer = np.minimum((flow.corner.mean(1)[:, 1] / 2 * layers).astype(int), layers - 1)
    sums = np.array([np.bincount(layer, w, layers) for w in (flow.volume, flow.volume * flow.velocity.x.array[:3 * n:3])])
    volume, momentum = flow.comm.allreduce(sums)
    return momentum / volume


def dean(velocity, reynolds):
    """Dean's friction coefficient at a mean velocity in friction velocities."""
    return 0.073 * (2 * velocity * reynolds) ** -0.25


def main(across=8, friction_reynolds=2000.0, closure="wale", wall_law=True, courant=0.5, end_time=16.0, seed=1,
         output="out/turbulent_channel", progress=True):
    """Run the channel and return the summary."""
    logging.getLogger().setLevel(logging.WARNING)
    flow = channel(across, friction_reynolds, closure, wall_law, seed)
    comm, start, processor = flow.comm, time.perf_counter(), time.process_time()
    dt = courant * 2 / across / 20
    out = fe_el.ParaViewOutput(output, None, [flow.velocity, flow.pressure], every=end_time / 8)
    times, profiles = [], []
    with out:
        for k, now in enumerate(fe_el.time_steps(dt, end_time, progress=progress), 1):
            flow.advance(dt)
            if k % 10 == 0:
                times.append(now)
                profiles.append(profile(flow, across))
            out.write(now)
    times, profiles = np.array(times), np.array(profiles)
    means, late = profiles.mean(1), times > 0.5 * end_time
    velocity, blocks = means[late].mean(), [b.mean() for b in np.array_split(means[late], 4)]
    expected = dean(velocity, friction_reynolds)
    force = -(flow.boundary_force(WALLS[0])[1][0] + flow.boundary_force(WALLS[1])[1][0]) / (2 * LENGTH * WIDTH)
    numbers = {
        "friction_reynolds": friction_reynolds, "reynolds": 2 * velocity * friction_reynolds, "closure": closure,
        "wall_law": wall_law, "cells": comm.allreduce(flow.num_cells), "cubes_across": across, "time_step": dt,
        "end_time": end_time, "mean_velocity": velocity, "mean_velocity_standard_error": np.std(blocks, ddof=1) / 2,
        "friction_coefficient": 2 / velocity ** 2, "friction_coefficient_dean": expected,
        "deviation_from_dean": 2 / velocity ** 2 / expected - 1, "last_wall_stress": abs(force),
        "mass_residual": flow.mass_residual(), "wall_time": time.perf_counter() - start,
        "processor_time": comm.allreduce(time.process_time() - processor), **fe_el.stage_seconds(flow, out)}
    if comm.rank == 0:
        picture(output, times, means, profiles[late].mean(0), friction_reynolds, expected)
    return fe_el.write_summary(output, comm, **numbers)


def picture(output, times, means, layers, reynolds, expected):
    """PNG: mean velocity against time, and its profile beside the logarithmic law."""
    from matplotlib import pyplot as plt
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
    left.plot(times, means)
    left.axhline(np.sqrt(2 / expected), color="k", linestyle="--", label="Dean")
    left.set(xlabel="time [half heights / friction velocity]", ylabel="mean velocity / friction velocity")
    left.legend()
    distance = (np.arange(len(layers)) + 0.5) * 2 / len(layers)
    lower = distance < 1
    right.semilogx(reynolds * distance[lower], layers[lower], "o", label="layers of cubes")
    y = np.geomspace(30, reynolds, 50)
    right.semilogx(y, np.log(y) / 0.4 + 5.5, "k--", label="logarithmic law")
    right.set(xlabel="distance from the wall [wall units]", ylabel="velocity / friction velocity")
    right.legend()
    figure.savefig(Path(output) / "turbulent_channel.png", dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    reports.start(main, arguments(), REPORTS)
