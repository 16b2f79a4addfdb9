"""A small scene with everything in it, for many steps: memory, time per step and handles, which must not grow.

Beads in gas with a scalar, an inlet, an outlet, walls of facets, a plane, a surface that turns, averages, a probe,
checkpoints and output. Memory is what the process holds in RAM (VmRSS), time that of its processor.
    python demos/benchmarks/long_run.py
    mpirun -n 2 python -m mpi4py demos/benchmarks/long_run.py
"""
import argparse
import gc
import logging
import os
import time
from pathlib import Path

import numpy as np
from mpi4py import MPI

import fe_el

DT, DOWN = 2e-4, (0.0, 0.0, -9.81)


def arguments():
    """Command line of the benchmark."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--steps", type=int, default=100_000, help="steps (100000)")
    p.add_argument("--record-every", type=int, default=1000, help="steps between records (1000)")
    p.add_argument("--checkpoint-every", type=int, default=5000, help="steps between checkpoints and frames (5000)")
    p.add_argument("--output", default="out/long_run", help="folder for results (out/long_run)")
    return p


def blade():
    """A closed bar that turns."""
    lower, upper = (0.004, 0.009, 0.006), (0.016, 0.011, 0.007)
    points = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * np.subtract(upper, lower) + lower
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return fe_el.SurfaceWall((points, triangles), point=(0.01, 0.01, 0.0065), angular_velocity=(0, 0, 20.0))


class Scene:
    """Everything at once."""

    def __init__(self, folder):
        mesh, tags = fe_el.box((0.02, 0.02, 0.03), (3, 3, 4))
        self.air = fe_el.VolumeAveragedNavierStokes(mesh, tags, 1.2, 1.8e-5, DOWN)
        self.air.set_velocity(5, (0, 0, 0.3))
        self.air.set_pressure(6)
        self.air.set_no_slip((1, 2, 3, 4))
        self.beads = fe_el.Particles(mesh, 2500.0, DOWN)
        self.beads.insert_in_box((0.001,) * 3, (0.019, 0.019, 0.003), 60, 1.2e-3, without_overlap=True)
        self.beads.remove_at(tags, 5)
        law = fe_el.LinearSpringDashpot(200.0, 0.5, 0.4, rolling=fe_el.RollingFriction(0.1))
        walls = [fe_el.FacetWalls(tags, (1, 2, 3, 4)), fe_el.PlaneWall((0, 0, 0.0), (0.3, 0, 1)), blade()]
        self.contacts = fe_el.Contacts(self.beads, law, walls, steps_per_contact=12)
        self.coupling = fe_el.Coupling.of(self.air, self.beads, [fe_el.Drag("beetstra"), fe_el.PressureGradient(),
                                                                 fe_el.SaffmanLift(), fe_el.Torque()])
        self.heat = fe_el.Scalar(self.air, 1e-4, lambda x: x[:, 2])
        self.inlet = fe_el.Inlet(self.beads, tags, 6, 2e-4, [1e-3, 1.3e-3], (0, 0, -0.3), seed=1)
        self.mean, self.probe = fe_el.TimeAverage(self.air.velocity), fe_el.Probe([self.air.pressure], [(0.01, 0.01, 0.001)])
        self.out = fe_el.ParaViewOutput(folder, self.beads, [self.air.velocity, self.air.pressure], contacts=self.contacts)
        self.parts = (self.beads, self.contacts, self.air, self.heat, self.inlet, self.coupling, self.mean)

    def step(self):
        """One step of all."""
        self.inlet.advance(DT)
        self.coupling.to_fluid(DT)
        self.air.advance(DT, self.coupling.fields)
        self.heat.advance(DT)
        self.coupling.to_particles(DT)
        self.beads.advance(DT, self.contacts)
        self.mean.add(DT)
        self.probe.values()


def memory():
    """What this process holds in RAM, in MB."""
    with open("/proc/self/status") as file:
        return next(int(line.split()[1]) for line in file if line.startswith("VmRSS")) / 1024


def next_communicator(comm):
    """Number that MPI gives to the next communicator, the lowest that is free: it grows with those that are not freed."""
    new = comm.Dup()
    number = new.py2f()
    new.Free()
    return number


def main(steps=100_000, record_every=1000, checkpoint_every=5000, output="out/long_run", progress=True):
    """Run the scene and return the summary."""
    logging.getLogger().setLevel(logging.WARNING)
    scene, rows, tick = Scene(output), [], time.process_time()
    comm = scene.beads.comm
    for k, now in enumerate(fe_el.time_steps(DT, steps * DT, progress=progress), 1):
        scene.step()
        if k % checkpoint_every == 0:
            fe_el.save_checkpoint(Path(output) / "checkpoint.h5", *scene.parts, time=now)
            scene.out.write(now)
        if k % record_every == 0:
            gc.collect()
            handles = len(os.listdir("/proc/self/fd"))
            seconds, tick = (time.process_time() - tick) / record_every, time.process_time()
            rows.append((k, comm.allreduce(memory(), op=MPI.MAX), seconds, handles, next_communicator(comm),
                         scene.beads.total_number))
    rows = np.array(rows)
    if comm.rank == 0:
        np.savetxt(Path(output) / "long_run.csv", rows, "%.6g", ",",
                   header="step,memory_MB,seconds_per_step,files,next_communicator,particles")
    late = rows[min(2, len(rows) - 1):]
    slope = np.polyfit(late[:, 0], late[:, 1], 1)[0] if len(late) > 2 else 0.0
    return fe_el.write_summary(output, comm, steps=steps, memory_first=rows[0, 1], memory_last=rows[-1, 1],
                               memory_growth=late[-1, 1] - late[0, 1], bytes_per_step=slope * 2 ** 20,
                               seconds_per_step_first=late[0, 2], seconds_per_step_last=late[-1, 2],
                               files=int(rows[:, 3].max()), files_first=int(rows[0, 3]),
                               communicators_more=int(rows[-1, 4] - rows[0, 4]), particles=int(rows[-1, 5]),
                               let_in=scene.inlet.inserted, left=scene.beads.left)


if __name__ == "__main__":
    summary = main(**vars(arguments().parse_args()))
    if MPI.COMM_WORLD.rank == 0:
        for key, value in summary.items():
            print(f"{key:32s} {value}")
