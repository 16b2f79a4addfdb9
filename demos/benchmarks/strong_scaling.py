"""One rank and two on a fluidised bed, a dense suspension and a silo: speed-up by stage, and what it is lost by.

Each scene is settled once on one rank; every run goes on from that checkpoint. A library that is loaded before MPI
(count_messages.c) tells processor time inside MPI, where ranks wait and exchange, from that outside, where they compute. So
on a busy machine, too: work done twice is the processor time outside of MPI of all ranks over that of one, imbalance the
largest over the mean, and one rank over the largest the speed-up at most. Two runs of one rank at once, beside one alone,
say what the machine's second core gives.
    python demos/benchmarks/strong_scaling.py
"""
import argparse
import csv
import ctypes
import json
import logging
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from mpi4py import MPI
from tqdm import tqdm

import fe_el

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from demos import contacts_only, fluidised_bed
from demos.benchmarks import communication
from fe_el.parallel.failures import environment_outside_mpirun
from fe_el.particles.insertion import lattice_positions

STAGES = ("mapping and drag", "fluid", "answer", "contacts", "neighbours")
SUSPENSION = 8  # blocks of the suspension of communication.py
WARM = 5  # steps before those that are timed
OWN = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1", "OMPI_MCA_rmaps_base_oversubscribe": "1",
       "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe"}


def arguments():
    """Command line of the benchmark."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--scenes", nargs="+", default=list(SCENES), choices=list(SCENES), help="which (all)")
    p.add_argument("--ranks", type=int, default=2, help="ranks beside one (2)")
    p.add_argument("--steps", type=int, default=20, help="steps that are timed, after five that are not (20)")
    p.add_argument("--repeats", type=int, default=3, help="runs of each, one after the other; the least counts (3)")
    p.add_argument("--slice", type=float, default=1.0, help="fraction of the bed's width, and of the silo's beads (1)")
    p.add_argument("--settle-time", type=float, default=0.3, help="time in which bed and silo settle first [s] (0.3)")
    p.add_argument("--busy", action="store_true", help="for a machine that does other work: ranks that wait give way")
    p.add_argument("--without-pair", action="store_true", help="no two runs of one rank at once")
    p.add_argument("--output", default="out/strong_scaling", help="folder for results (out/strong_scaling)")
    p.add_argument("--run", nargs=3, metavar=("SCENE", "CHECKPOINT", "LIBRARY"),
                   help="what the benchmark starts its runs with; prints seconds of every rank")
    return p


class Scene:
    """Fluid, particles and contacts of a scene; without gas ``air`` and ``coupling`` are ``None``. What has settled is let
    ``go``."""

    def __init__(self, dt, beads, contacts, air=None, coupling=None, go=lambda: None):
        self.dt, self.beads, self.contacts, self.air, self.coupling, self.go = dt, beads, contacts, air, coupling, go

    def step(self, stage):
        """One step; ``stage`` is told before each part which it is."""
        if self.air is not None:
            for k, part in enumerate((lambda: self.coupling.to_fluid(self.dt),
                                      lambda: self.air.advance(self.dt, self.coupling.fields),
                                      lambda: self.coupling.to_particles(self.dt))):
                stage(k)
                part()
        stage(3)
        self.beads.advance(self.dt, self.contacts)

    def parts(self):
        """What a checkpoint keeps."""
        return [part for part in (self.beads, self.contacts, self.air, self.coupling) if part is not None]


def bed(fraction, checkpoint=None):
    """The bed of demos/fluidised_bed.py at 1.3 m/s; filled, unless it goes on from a checkpoint."""
    made = fluidised_bed.assemble(1.3, fraction)
    if checkpoint is None:
        fluidised_bed.fill(made.beads, fraction, 1)
    return Scene(1e-3, *made)


def suspension(fraction, checkpoint=None):
    """Eight blocks of the periodic suspension of communication.py, whatever the number of ranks."""
    beads, contacts, air, coupling = communication.suspension(SUSPENSION, checkpoint is None)
    return Scene(communication.DT, beads, contacts, air, coupling)


def silo(fraction, checkpoint=None):
    """The silo of demos/contacts_only.py, closed until it has settled."""
    demo, meshes = contacts_only, Path(__file__).resolve().parents[2] / "meshes"
    sizes = 2.5e-3 * np.random.default_rng(1).uniform(0.9, 1.1, round(6000 * fraction))
    box = (0, 0, demo.CONE), (demo.WIDTH, demo.DEPTH, demo.CONE + demo.BIN + 0.1)
    mesh, _, tags = fe_el.mesh_geo(meshes / "hopper.geo", width=demo.WIDTH, depth=demo.DEPTH, bin=demo.BIN + 0.1,
                                   cone=demo.CONE, slot=0.02, balance=checkpoint or lattice_positions(*box, sizes, 1))
    beads = fe_el.Particles(mesh, demo.DENSITY, gravity=(0, 0, -demo.GRAVITY))
    if checkpoint is None:
        beads.insert_on_lattice(*box, sizes, seed=1)
    contacts = fe_el.Contacts(beads, fe_el.LinearSpringDashpot(2000.0, 0.7, 0.3),
                              [fe_el.FacetWalls(tags, demo.WALL), fe_el.FacetWalls(tags, demo.OUTLET)], steps_per_contact=30)

    def go():
        contacts.walls = contacts.walls[:1]
        beads.remove_at(tags, demo.OUTLET)
    return Scene(1e-3, beads, contacts, go=go)


SCENES = {"bed": bed, "suspension": suspension, "silo": silo}


class Clock:
    """Wall time, processor time and that inside of MPI, by stage, from when it is told the first."""

    def __init__(self, counter):
        self.inside = (ctypes.c_double * 32).in_dll(counter, "seconds_inside")
        self.stage, self.seconds = -1, np.zeros((len(STAGES), 3))
        self.last = self._now()

    def _now(self):
        return np.array((time.perf_counter(), time.process_time(), self.inside[0]))

    def __call__(self, stage):
        """What was since the last call belongs to the stage that was told then; -1: to none."""
        now = self._now()
        if self.stage >= 0:
            self.seconds[self.stage] += now - self.last
        self.stage, self.last = stage, now


def timed(name, checkpoint, library, steps, fraction):
    """Seconds (ranks, stages, 3) of a step that goes on from a checkpoint: wall, processor, processor inside MPI; and what
    the ranks have. On every rank."""
    counter = communication.count_compiled_calls(library)
    scene = SCENES[name](fraction, checkpoint)
    fe_el.load_checkpoint(checkpoint, *scene.parts())
    scene.go()
    scene.step(lambda stage: None)
    comm, clock, renew = scene.beads.comm, Clock(counter), scene.contacts.lists.rebuild

    def rebuild(*arguments):
        before = clock.stage
        clock(STAGES.index("neighbours") if before >= 0 else -1)
        renew(*arguments)
        clock(before)
    scene.contacts.lists.rebuild = rebuild
    for _ in range(WARM):
        scene.step(lambda stage: None)
    rebuilds, sub_steps = scene.contacts.rebuilds, 0
    for _ in range(steps):
        scene.step(clock)
        clock(-1)
        comm.Barrier()
        sub_steps += scene.contacts.steps_last
    return {"seconds": comm.allgather((clock.seconds / steps).tolist()), "sub_steps": sub_steps / steps,
            "rebuilds": (scene.contacts.rebuilds - rebuilds) / steps, "particles": comm.allgather(len(scene.beads)),
            "cells": comm.allgather(scene.beads.cells.owned)}


def settle(name, folder, fraction, settle_time):
    """Checkpoint of a scene that has settled, on this rank."""
    path = folder / f"{name}.h5"
    if not path.is_file():
        scene = SCENES[name](fraction)
        for _ in range(round(settle_time / scene.dt) if name != "suspension" else WARM):
            scene.step(lambda stage: None)
        fe_el.save_checkpoint(path, *scene.parts())
    return path


def start(options, ranks, busy=False):
    """A run on some ranks."""
    own = OWN | {"OMPI_MCA_mpi_yield_when_idle": "1"} if busy else OWN
    launch = [] if ranks == 1 else ["mpirun", "-n", str(ranks)]
    module = [] if ranks == 1 else ["-m", "mpi4py"]
    command = [*launch, "env", f"LD_PRELOAD={options[options.index('--run') + 3]}", sys.executable, "-W", "ignore", *module,
               __file__, *options]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, stdin=subprocess.DEVNULL,
                            env=environment_outside_mpirun() | own)


def results(*runs):
    """What runs print at their end.

    Raises:
        RuntimeError: where one fails.
    """
    out = []
    for run in runs:
        said, errors = run.communicate()
        if run.returncode:
            raise RuntimeError(f"A run ended with exit code {run.returncode}:\n{errors[-2000:]}")
        out.append(json.loads(said.splitlines()[-1]))
    return out


def least(runs):
    """Wall seconds of each stage, mean over the ranks, and seconds outside of MPI and inside (ranks, stages), each the least
    of several runs."""
    seconds = np.array([r["seconds"] for r in runs])
    return seconds[..., 0].mean(1).min(0), (seconds[..., 1] - seconds[..., 2]).min(0), seconds[..., 2].min(0)


def table(one, many, pair):
    """Rows for each stage and the step: milliseconds and ratios, as the head of strong_scaling.csv says."""
    (wall, work, _), (wall_many, work_many, waiting) = least(one), least(many)
    wall_pair = least(pair)[0] if pair else np.full(len(wall), np.nan)
    rows, columns = [], [*range(len(STAGES)), slice(None)]
    for k in columns:
        alone, together = np.sum(wall[k]), np.sum(wall_many[k])
        if not alone:
            continue  # no such stage
        own, each = np.sum(work[0, k]), work_many[:, k].reshape(len(work_many), -1).sum(1)
        slowest = np.sum(work_many[:, k].max(0))  # stages wait for each other
        inside = waiting[:, k].reshape(len(waiting), -1).sum(1).mean()
        rows.append(("step" if isinstance(k, slice) else STAGES[k], 1e3 * alone, 1e3 * together, alone / together,
                     1e3 * own, 1e3 * each.mean(), each.sum() / own, slowest / each.mean(), 1e3 * inside, own / slowest,
                     len(each) * alone / np.sum(wall_pair[k])))
    return rows


HEAD = ("stage", "wall_ms_1", "wall_ms", "speed_up", "processor_ms_1", "processor_ms_per_rank", "work_over_that_of_one",
        "imbalance", "inside_mpi_ms", "speed_up_of_work", "speed_up_of_machine")


def main(scenes=tuple(SCENES), ranks=2, steps=20, repeats=3, slice=1.0, settle_time=0.3, without_pair=False,
         output="out/strong_scaling", busy=False, progress=True):
    """Time all scenes and return the summary; on one rank."""
    logging.getLogger().setLevel(logging.WARNING)
    folder, numbers, rows = Path(output).resolve(), {}, []
    folder.mkdir(parents=True, exist_ok=True)
    library = folder / "count_messages.so"
    source = Path(__file__).with_name("count_messages.c")
    subprocess.run([communication.compiler(), "-shared", "-fPIC", "-O2", "-o", library, source], check=True)
    for name in tqdm(scenes, disable=not progress):
        options = ["--steps", str(steps), "--slice", str(slice), "--run", name,
                   str(settle(name, folder, slice, settle_time)), str(library)]
        one, many, pair = [], [], []
        for _ in range(repeats):
            one += results(start(options, 1))
            many += results(start(options, ranks, busy))
            if not without_pair:
                at_once = results(*[start(options, 1) for _ in range(ranks)])
                pair.append({"seconds": [r["seconds"][0] for r in at_once]})
        for row in table(one, many, pair):
            rows.append((name, *row))
            numbers |= {f"{name}_{row[0]}_{what}".replace(" ", "_"): value for what, value in zip(HEAD[1:], row[1:])
                        if np.isfinite(value)}
        numbers |= {f"{name}_{what}": many[0][what] for what in ("particles", "cells", "sub_steps", "rebuilds")}
    with open(folder / "strong_scaling.csv", "w", newline="") as file:
        csv.writer(file).writerows([("scene", *HEAD), *rows])
    say(rows, ranks)
    return fe_el.write_summary(folder, MPI.COMM_SELF, steps=steps, repeats=repeats, slice=slice, compared_ranks=ranks,
                               **numbers)


def say(rows, ranks):
    """Print the table as one of a README."""
    print(f"\n| scene | stage | wall, 1 and {ranks} ranks | times as fast | processor outside MPI, 1 and each of {ranks} "
          "| all / one | largest / mean | inside MPI | at most | machine |\n" + "| --- " * 10 + "|")
    for scene, stage, *n in rows:
        print(f"| {scene} | {stage} | {n[0]:.1f}, {n[1]:.1f} ms | {n[2]:.2f} | {n[3]:.1f}, {n[4]:.1f} ms | {n[5]:.2f} | "
              f"{n[6]:.2f} | {n[7]:.1f} ms | {n[8]:.2f} | {n[9]:.2f} |")


if __name__ == "__main__":
    asked = vars(arguments().parse_args())
    one_run = asked.pop("run")
    if one_run:
        logging.getLogger().setLevel(logging.WARNING)
        found = timed(*one_run, asked["steps"], asked["slice"])
        if MPI.COMM_WORLD.rank == 0:
            print(json.dumps(found), flush=True)
    else:
        main(**asked)
