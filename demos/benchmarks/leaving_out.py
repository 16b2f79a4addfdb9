"""What a scene saves by what it does not create: a fluidised bed with everything in it, and the same without one thing each.

A slice of the bed of ``demos/fluidised_bed.py``, settled first without gas. The full scene has two diameters, friction,
smoothing, drag and the pressure gradient as forces. Seconds are those of a step, median; what is not created is in no stage.
"""
import argparse
import csv
import logging
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from mpi4py import MPI
from tqdm import tqdm

import fe_el

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from demos import fluidised_bed as bed

VELOCITY, LENGTH = 1.7, 3 * bed.LARGE
FULL = {"gas": "moves", "smoothing": True, "pressure": True, "friction": 0.1, "sizes": 2, "mapping": "overlap_volume",
        "contacts": True, "held": False, "back": True}
VARIANTS = {
    "everything": {}, "no smoothing": {"smoothing": False}, "no pressure gradient": {"pressure": False},
    "no friction": {"friction": 0.0}, "one diameter": {"sizes": 1}, "point particles": {"mapping": "particle_centred"},
    "one-way": {"back": False}, "frozen flow": {"gas": "frozen", "back": False}, "no contacts": {"contacts": False},
    "fixed bed": {"held": True}, "tracers: one-way, no contacts": {"back": False, "contacts": False},
    "dry": {"gas": None}, "gas alone": {"sizes": 0}}


def arguments():
    """Command line of the demo."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    p.add_argument("--slice", type=float, default=0.2, help="fraction of the bed's width")
    p.add_argument("--settle-time", type=float, default=0.2, help="time in which the beads settle without gas [s]")
    p.add_argument("--steps", type=int, default=30, help="steps of 1 ms; the median of the last two thirds counts")
    p.add_argument("--output", default="out/leaving_out", help="folder for results")
    return p


def settled(fraction, settle_time):
    """Positions and diameters of beads that have settled."""
    dry = bed.assemble(0.0, fraction)
    bed.fill(dry.beads, fraction, 1)
    for _ in range(int(np.ceil(settle_time / 2e-3))):
        dry.beads.advance(2e-3, dry.contacts)
    return dry.beads.position.copy(), dry.beads.diameter.copy()


class Scene:
    """The bed with what a variant of FULL asks for."""

    def __init__(self, fraction, position, diameter, **choices):
        want = SimpleNamespace(**{**FULL, **choices})
        self.mesh, _, tags = bed.bed_mesh(fraction, 0.0075)
        down = (0.0, 0.0, -bed.GRAVITY)
        self.beads = self.contacts = self.air = self.coupling = None
        self.moves, self.back = want.gas == "moves", want.back
        if want.sizes:
            self.beads = fe_el.Particles(self.mesh, density=bed.BEAD_DENSITY, gravity=down)
            self.beads.insert_at(position, diameter if want.sizes == 2 else np.full(len(diameter), bed.SMALL))
            if want.held:
                self.beads.hold()
            if not want.contacts:
                self.beads.rebound_at(tags, (bed.WALL, bed.INLET, bed.OUTLET))
        if want.sizes and want.contacts and not want.held:
            law = fe_el.LinearSpringDashpot(500.0, restitution=0.9, friction=want.friction)
            self.contacts = fe_el.Contacts(self.beads, law, walls=(tags, (bed.WALL, bed.INLET)), steps_per_contact=12)
        if want.gas:
            self.air = fe_el.VolumeAveragedNavierStokes(self.mesh, tags, bed.GAS_DENSITY, bed.GAS_VISCOSITY, down, 1e-9)
            self.air.set_velocity(bed.INLET, (0, 0, VELOCITY))
            self.air.set_pressure(bed.OUTLET, 0.0)
            self.air.set_no_slip(bed.WALL)
            self.air.set_initial_velocity((0, 0, VELOCITY))
        if want.gas and want.sizes:
            forces = [fe_el.Drag("beetstra")] + ([fe_el.PressureGradient()] if want.pressure else [])
            smooth = fe_el.HelmholtzSmoothing(self.mesh, LENGTH) if want.smoothing else None
            self.coupling = fe_el.Coupling.of(self.air, self.beads, forces, mapping=want.mapping,
                                              smoothing=smooth)

    def step(self, dt):
        """One step of what is there."""
        if self.coupling is not None:
            self.coupling.to_fluid(dt)
        if self.moves:
            self.air.advance(dt, self.coupling.fields if self.coupling is not None and self.back else None)
        if self.coupling is not None:
            self.coupling.to_particles(dt)
        if self.beads is not None:
            self.beads.advance(dt, self.contacts)

    def stages(self):
        """Seconds of what is there, by stage."""
        moving = self.air if self.moves else None
        return fe_el.stage_seconds(self.contacts, moving, self.coupling)["seconds_per_stage"]


def timed(scene, steps, dt=1e-3):
    """Median seconds of a step, and of its stages."""
    seconds = []
    for k in range(steps):
        if k == steps // 3:
            before = scene.stages()
        tick = time.perf_counter()
        scene.step(dt)
        seconds.append(time.perf_counter() - tick)
    late = steps - steps // 3
    return float(np.median(seconds[steps // 3:])), {name: (t - before[name]) / late for name, t in scene.stages().items()}


def main(slice=0.2, settle_time=0.2, steps=30, output="out/leaving_out", progress=True):
    """Time every variant and return the summary; on one rank."""
    logging.getLogger().setLevel(logging.WARNING)
    start, (position, diameter) = time.perf_counter(), settled(slice, settle_time)
    rows, numbers = [], {}
    for name, other in tqdm(VARIANTS.items(), disable=not progress):
        seconds, stages = timed(Scene(slice, position, diameter, **other), steps)
        rows.append((name, seconds, rows[0][1] / seconds if rows else 1.0, stages))
        numbers["milliseconds_" + name.replace(":", "").replace(",", "").replace(" ", "_").replace("-", "_")] = 1e3 * seconds
    Path(output).mkdir(parents=True, exist_ok=True)
    names = sorted({stage for row in rows for stage in row[3]})
    with open(Path(output) / "leaving_out.csv", "w", newline="") as file:
        csv.writer(file).writerows([("scene", "seconds", "times_as_fast", *names),
                                    *((*row[:3], *(row[3].get(n, "") for n in names)) for row in rows)])
    for name, seconds, ratio, stages in rows:
        parts = ", ".join(f"{stage} {1e3 * t:.2f}" for stage, t in stages.items())
        print(f"{name:32s} {1e3 * seconds:7.2f} ms, {ratio:5.1f} times as fast ({parts})")
    return fe_el.write_summary(output, MPI.COMM_SELF, particles=len(position), steps=steps,
                               wall_time=time.perf_counter() - start, **numbers)


if __name__ == "__main__":
    for key, value in main(**vars(arguments().parse_args())).items():
        print(f"{key:40s} {value}")
