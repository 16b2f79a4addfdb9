"""Discharge of a flat silo with a hopper: dry beads, walls of mesh facets, an outlet; no fluid is imported."""
import argparse
import logging
import sys
import time
from pathlib import Path

import matplotlib
import numpy as np
from mpi4py import MPI

import fe_el
from fe_el.particles.insertion import lattice_positions

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from demos import reports, restarts

matplotlib.use("Agg")
OUTLET, WALL = 2, 3
GRAVITY, DENSITY = 9.81, 2500.0
WIDTH, DEPTH, BIN, CONE = 0.1, 0.015, 0.12, 0.06
REPORTS = {"discharge": reports.Report(
    settings=tuple({"stiffness": k, "steps_per_contact": n, "seed": seed} for k, n, seed in (
        (8000.0, 50, 1), (8000.0, 50, 2), (2000.0, 30, 1), (2000.0, 15, 1), (500.0, 30, 1), (500.0, 15, 1), (100.0, 15, 1))),
    quantities={"discharge_rate": None, "left_mass": None},
    same={"diameter": 4e-3, "particles": 1200, "settle_time": 0.15, "end_time": 0.5},
    first={"settle_time": 1e-3, "end_time": 3e-3, "particles": 50}, within=0.05)}


def arguments():
    """Command line of the demo."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    p.add_argument("--diameter", type=float, default=2.5e-3, help="mean diameter of the beads [m]; sizes vary by a tenth")
    p.add_argument("--particles", type=int, default=6000, help="number of beads")
    p.add_argument("--slot", type=float, default=0.02, help="width of the outlet [m]")
    p.add_argument("--stiffness", type=float, default=2000.0, help="contact stiffness [N/m]")
    p.add_argument("--friction", type=float, default=0.3, help="friction of beads and walls")
    p.add_argument("--rolling-friction", type=float, default=0.0, help="coefficient of rolling friction; 0: none")
    p.add_argument("--restitution", type=float, default=0.7, help="restitution of beads and walls")
    p.add_argument("--steps-per-contact", type=int, default=30, help="contact steps in the shortest contact")
    p.add_argument("--settle-time", type=float, default=0.3, help="time with the outlet closed [s]")
    p.add_argument("--end-time", type=float, default=1.0, help="simulated time [s]")
    p.add_argument("--time-step", type=float, default=1e-3, help="time between records [s]; contacts choose their own steps")
    p.add_argument("--output-every", type=float, default=0.05, help="time between ParaView outputs [s]")
    p.add_argument("--seed", type=int, default=1, help="seed of sizes and places")
    p.add_argument("--output", default="out/contacts_only", help="folder for results")
    p.add_argument("--balance", action="store_true",
                   help="with --restart on several ranks: cut the mesh anew, by the particles of the checkpoint")
    restarts.add_arguments(p)
    return p


def main(diameter=2.5e-3, particles=6000, slot=0.02, stiffness=2000.0, friction=0.3, rolling_friction=0.0, restitution=0.7,
         settle_time=0.3, end_time=1.0, time_step=1e-3, output_every=0.05, seed=1, output="out/contacts_only",
         checkpoint_every=None, restart=None, wall_time=None, balance=False, steps_per_contact=30, progress=True):
    """Fill the silo, open the outlet, and return the summary."""
    if not 0 < slot < WIDTH:
        raise ValueError(f"--slot is {slot}; give a width between 0 and that of the silo, {WIDTH} m.")
    logging.getLogger().setLevel(logging.WARNING)
    keep = restarts.Restarts(output, time_step, checkpoint_every, restart, wall_time)
    sizes = diameter * np.random.default_rng(seed).uniform(0.9, 1.1, particles)
    box = (0, 0, CONE), (WIDTH, DEPTH, CONE + BIN + 0.1)
    at_start = lattice_positions(*box, sizes, seed)
    folder = Path(__file__).resolve().parent.parent / "meshes"
    mesh, _, tags = fe_el.mesh_geo(folder / "hopper.geo", width=WIDTH, depth=DEPTH, bin=BIN + 0.1, cone=CONE, slot=slot,
                                   balance=keep.origin() if balance and keep.going_on() else at_start)
    beads = fe_el.Particles(mesh, DENSITY, gravity=(0, 0, -GRAVITY))
    if not keep.going_on():
        beads.insert_on_lattice(*box, sizes, seed=seed)
    rolling = fe_el.RollingFriction(rolling_friction) if rolling_friction else None
    law = fe_el.LinearSpringDashpot(stiffness, restitution, friction, rolling=rolling)
    walls = [fe_el.FacetWalls(tags, WALL)]
    closed = fe_el.Contacts(beads, law, [*walls, fe_el.FacetWalls(tags, OUTLET)], steps_per_contact=steps_per_contact)
    open_ = fe_el.Contacts(beads, law, walls, steps_per_contact=steps_per_contact)
    out = fe_el.ParaViewOutput(output, beads, every=output_every)
    rows, resting, start, processor = restarts.Rows(), restarts.Kept(), time.perf_counter(), time.process_time()
    checkpoints = keep.checkpoints(beads, closed, open_, out, rows, resting)
    total, last = beads.comm.allreduce(beads.mass.sum()) + beads.left_mass, closed
    if checkpoints.time > settle_time:
        beads.remove_at(tags, OUTLET)
        last = open_
    with out, checkpoints:
        for now in keep.steps(checkpoints.time, end_time, progress):
            contacts = closed if now <= settle_time else open_
            if contacts is not last:
                resting.update(gather(beads))
                beads.remove_at(tags, OUTLET)
                last = contacts
            beads.advance(time_step, contacts)
            rows.append((now, beads.left_mass, beads.kinetic_energy()))
            out.write(now)
            checkpoints.after(now)
    rows, wall_time, processor = np.array(rows), time.perf_counter() - start, time.process_time() - processor
    rate = discharge_rate(rows, settle_time)
    bulk = 0.6 * DENSITY
    seconds = {k: closed.seconds[k] + open_.seconds[k] for k in closed.seconds}
    closed.seconds = seconds
    numbers = {
        "particles": particles, "cells": beads.comm.allreduce(beads.cells.owned), "end_time": end_time,
               "wall_time": wall_time, "processor_time": beads.comm.allreduce(processor),
        "contact_step": time_step / max(open_.steps_last or closed.steps_last, 1), "left_particles": beads.left,
        "left_mass": beads.left_mass, "lost_particles": particles - beads.left - beads.total_number,
        "mass_balance": abs(beads.left_mass + beads.comm.allreduce(beads.mass.sum()) - total) / total,
        "discharge_rate": rate, "beverloo_rate": 1.03 * bulk * np.sqrt(GRAVITY) * DEPTH * max(slot - 1.4 * diameter,
                                                                                              0) ** 1.5,
        "largest_overlap_over_diameter": beads.comm.allreduce(max(closed.largest_overlap, open_.largest_overlap),
                                                              op=MPI.MAX),
        "kinetic_energy": rows[-1, 2], **beads.imbalance(), **fe_el.stage_seconds(closed, out)}
    shown = gather(beads)
    if beads.comm.rank == 0:
        picture(output, rows, resting, shown, numbers)
    return fe_el.write_summary(output, beads.comm, **numbers)


def discharge_rate(rows, settle_time):
    """Mass rate [kg/s] over the middle half of the discharge; zero if nothing left."""
    t, mass = rows[:, 0], rows[:, 1]
    during = (mass > 0.25 * mass[-1]) & (mass < 0.75 * mass[-1]) & (t > settle_time)
    return float(np.polyfit(t[during], mass[during], 1)[0]) if during.sum() > 2 else 0.0


def gather(beads):
    """Positions, diameters and speeds of all beads on the first rank."""
    parts = beads.comm.gather((beads.position, beads.diameter, np.linalg.norm(beads.velocity, axis=1)))
    names = ("position", "diameter", "speed") if parts else ()
    return {name: np.concatenate([p[i] for p in parts]) for i, name in enumerate(names)}


def picture(output, rows, resting, shown, numbers):
    """PNG: the beads at rest and in the end, and the mass that left against time."""
    from matplotlib import pyplot as plt
    figure, axes = plt.subplots(1, 3, figsize=(12, 5.5), gridspec_kw={"width_ratios": [1, 1.2, 1.4]})
    for axis, state, title in ((axes[0], resting, "before opening"), (axes[1], shown, "in the end")):
        if state and len(state["position"]):
            x, d, v = (state[name] for name in ("position", "diameter", "speed"))
            order = np.argsort(-x[:, 1])
            mark = axis.scatter(x[order, 0], x[order, 2], s=(d[order] * 1e3) ** 2 * 3, c=v[order], cmap="viridis", lw=0)
            if axis is axes[1]:
                figure.colorbar(mark, ax=axis, label="speed [m/s]", shrink=0.7)
        a = (WIDTH - numbers.get("slot", 0.02)) / 2
        axis.plot([a, 0, 0], [0, CONE, CONE + BIN], "k", lw=1)
        axis.plot([WIDTH - a, WIDTH, WIDTH], [0, CONE, CONE + BIN], "k", lw=1)
        axis.set(aspect="equal", title=title, xlabel="x [m]", ylabel="z [m]")
    axes[2].plot(rows[:, 0], rows[:, 1], label="mass that left")
    axes[2].set(xlabel="time [s]", ylabel="[kg]", title=f"{numbers['discharge_rate']:.3f} kg/s (Beverloo "
                                                         f"{numbers['beverloo_rate']:.3f})")
    figure.tight_layout()
    figure.savefig(Path(output) / "contacts_only.png", dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    reports.start(main, arguments(), REPORTS)
