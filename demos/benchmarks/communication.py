"""Messages and bytes that each rank sends in a step, by stage, in a suspension that grows with the ranks; and what they mean
for a thousand million particles.

A library that is loaded before MPI (count_messages.c, compiled by mpicc) counts all calls: those of compiled loops, of
Python, and of PETSc and hypre. Without it nothing is counted and nothing costs. Ranks may be more than processors.
    python demos/benchmarks/communication.py
"""
import argparse
import csv
import ctypes
import json
import logging
import shutil
import subprocess
import sys
from pathlib import Path

import matplotlib
import numpy as np
from mpi4py import MPI

import fe_el
from fe_el.parallel.failures import environment_outside_mpirun

matplotlib.use("Agg")
CUBES, EDGE, DIAMETER, DENSITY, SOLID = 4, 6e-4, 1.5e-4, 1500.0, 0.3  # cubes of 0.6 mm along each edge of a rank's block
GAS_DENSITY, GAS_VISCOSITY, DT = 1.2, 1.8e-5, 1e-4
STAGES = ("mapping and drag", "fluid", "answer", "contacts and moves")
KINDS = ("halo", "single", "objects", "reductions", "gathers", "all_to_all", "others")  # as in count_messages.c
LATENCY, BANDWIDTH, NEIGHBOURS = 2e-6, 1e10, 26  # [s], [bytes/s], ranks around one
HANDLING, SEARCH = 2e-6, 1e-9  # of a Python object by mpi4py, and of a particle in the search of another rank's ghosts [s]


def arguments():
    """Command line of the benchmark."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--ranks", type=int, nargs="+", default=(2, 4, 8, 16), help="numbers of ranks (2 4 8 16)")
    p.add_argument("--steps", type=int, default=20, help="steps that are counted, after five that are not (20)")
    p.add_argument("--output", default="out/communication", help="folder for results (out/communication)")
    p.add_argument("--count", metavar="LIBRARY", help="what each run of this benchmark is started with; prints a table")
    return p


def suspension(blocks, filled=True):
    """A dense periodic suspension with contacts of some blocks of cubes: beads (none unless ``filled``), contacts, gas and
    coupling."""
    cubes = CUBES * np.array(MPI.Compute_dims(blocks, 3))
    lengths, down = cubes * EDGE, np.array([0, 0, -9.81])
    middles = (np.stack(np.meshgrid(*[np.arange(n) for n in cubes], indexing="ij"), -1).reshape(-1, 3) + 0.5) * EDGE
    mesh, _ = fe_el.periodic_box(lengths, cubes.tolist(), balance=middles)
    beads = fe_el.Particles(mesh, DENSITY, down)
    if filled:
        count = round(SOLID * lengths.prod() / (np.pi / 6 * DIAMETER ** 3))
        beads.insert_in_box((0, 0, 0), lengths, count, DIAMETER, seed=1, without_overlap=True)
        beads.velocity[:] = 0.05 * np.random.default_rng(1).normal(size=(count, 3))[beads.id]
    weight = -(SOLID * DENSITY + (1 - SOLID) * GAS_DENSITY) * down
    gas = fe_el.VolumeAveragedNavierStokes(mesh, None, GAS_DENSITY, GAS_VISCOSITY, down, mean_pressure_gradient=weight)
    contacts = fe_el.Contacts(beads, fe_el.LinearSpringDashpot(2.0, 0.9, 0.1), steps_per_contact=12)
    return beads, contacts, gas, fe_el.Coupling.of(gas, beads, [fe_el.Drag("beetstra"), fe_el.PressureGradient()])


def scene(ranks):
    """A step of the suspension of one block for each rank, as functions by stage."""
    beads, contacts, gas, coupling = suspension(ranks)
    return contacts, beads, (lambda: coupling.to_fluid(DT), lambda: gas.advance(DT, coupling.fields),
                             lambda: coupling.to_particles(DT), lambda: beads.advance(DT, contacts))


def compiler():
    """mpicc of the MPI whose mpirun starts runs.

    Raises:
        RuntimeError: where there is none, or MPI is one that this cannot count.
    """
    here = [shutil.which(name) for name in ("mpirun", "mpicc")]
    if not all(here) or Path(here[0]).parent != Path(here[1]).parent:
        raise RuntimeError(f"mpirun is {here[0]}, mpicc is {here[1]}; both of one MPI are needed, beside each other "
                           "(Debian: libopenmpi-dev).")
    if MPI.Get_version()[0] > 3:  # mpi4py then calls functions with large counts, which are not wrapped
        raise RuntimeError(f"This MPI has version {MPI.Get_version()}; messages are counted up to version 3 (Debian's "
                           "OpenMPI).")
    return here[1]


def count_compiled_calls(library):
    """Let compiled loops call MPI through the library, which is returned, too."""
    import llvmlite.binding

    import fe_el.parallel.messages  # noqa: F401  has told compiled loops its functions; they get those that count
    counter = ctypes.CDLL(library)
    for name in ("MPI_Startall", "MPI_Waitall", "MPI_Allreduce"):
        ours = getattr(counter, name if name != "MPI_Startall" else "halo_startall")
        llvmlite.binding.add_symbol(name, ctypes.cast(ours, ctypes.c_void_p).value)
    return counter


def count(library, steps):
    """Table (stages, kinds, 3) of calls, messages and bytes per rank and step, means over the ranks; on every rank."""
    counter, comm = count_compiled_calls(library), MPI.COMM_WORLD
    stage = ctypes.c_int.in_dll(counter, "stage")
    table = np.ctypeslib.as_array((ctypes.c_double * (32 * len(KINDS) * 3)).in_dll(counter, "counted")).reshape(32, -1, 3)
    contacts, beads, parts = scene(comm.size)
    for step in range(steps + 5):
        if step == 5:
            before, sub_steps, rebuilds = table.copy(), 0, contacts.rebuilds
        for k, part in enumerate(parts):
            stage.value = k + 1
            part()
        stage.value, sub_steps = 0, (sub_steps if step > 5 else 0) + contacts.steps_last
    mean = comm.allreduce((table - before)[1:1 + len(parts)]) / (comm.size * steps)
    return {"table": mean.tolist(), "particles": beads.total_number, "cells": comm.allreduce(beads.cells.owned),
            "sub_steps": sub_steps / steps, "rebuilds": (contacts.rebuilds - rebuilds) / steps}


def started(ranks, steps, library):
    """What a run on some ranks counts."""
    own = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1", "OMPI_MCA_rmaps_base_oversubscribe": "1",
           "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe"}
    command = ["mpirun", "-n", str(ranks), "env", f"LD_PRELOAD={library}", sys.executable, "-W", "ignore", "-m", "mpi4py",
               __file__, "--steps", str(steps), "--count", str(library)]
    run = subprocess.run(command, capture_output=True, text=True, env=environment_outside_mpirun() | own,
                         stdin=subprocess.DEVNULL)
    if run.returncode:
        raise RuntimeError(f"The run on {ranks} ranks failed:\n{run.stderr[-2000:]}")
    return json.loads(run.stdout.splitlines()[-1])


def seconds(runs, ranks, particles):
    """Model of what a step's communication takes [s], by kind, on many ranks with ``particles`` on each.

    Bytes for neighbours grow with the surface of a rank's part, reductions with the logarithm of the ranks; what all send to
    all, or gather from them, grows with the ranks themselves, as a straight line through the runs says.
    """
    numbers, tables = np.array([r["ranks"] for r in runs]), np.array([r["table"] for r in runs]).sum(1)
    calls, messages, sent = (dict(zip(KINDS, column)) for column in tables[-1].T)
    surface, deep = (particles * runs[-1]["ranks"] / runs[-1]["particles"]) ** (2 / 3), np.log2(ranks)
    more = NEIGHBOURS * calls["halo"] / messages["halo"]  # neighbours than in the largest run
    out = {kind: messages[kind] * more * LATENCY + sent[kind] * surface / BANDWIDTH for kind in ("halo", "single")}
    out["reductions"], out["objects"] = 2 * calls["reductions"] * deep * LATENCY, calls["objects"] * deep * HANDLING
    for kind, rounds in (("gathers", deep), ("all_to_all", ranks)):
        line = np.polyfit(numbers, tables[:, KINDS.index(kind), 2], min(1, len(runs) - 1))
        out[kind] = calls[kind] * (rounds * LATENCY + 0.5 * ranks * HANDLING) + max(np.polyval(line, ranks), 0) / BANDWIDTH
    out["search_for_ghosts"] = runs[-1]["rebuilds"] * NEIGHBOURS * particles * SEARCH
    return out


def main(ranks=(2, 4, 8, 16), steps=20, output="out/communication", count=None, progress=True):
    """Count on all numbers of ranks and return the summary."""
    folder, runs = Path(output).resolve(), []
    folder.mkdir(parents=True, exist_ok=True)
    library, source = folder / "count_messages.so", Path(__file__).with_name("count_messages.c")
    subprocess.run([compiler(), "-shared", "-fPIC", "-O2", "-o", library, source], check=True)
    for n in ranks:
        runs.append({"ranks": n, **started(n, steps, library)})
        if progress:
            _, messages, sent = np.sum(runs[-1]["table"], axis=(0, 1))
            together = np.sum(runs[-1]["table"], axis=0)[KINDS.index("reductions"):, 0].sum()
            print(f"{n:3d} ranks: {messages:6.0f} messages, {together:5.0f} calls of all together, {sent / 1024:6.0f} kB "
                  "per rank and step", flush=True)
    rows = [(r["ranks"], stage, kind, *numbers) for r in runs for stage, table in zip(STAGES, r["table"])
            for kind, numbers in zip(KINDS, table)]
    with open(folder / "communication.csv", "w", newline="") as file:
        csv.writer(file).writerows([("ranks", "stage", "kind", "calls", "messages", "bytes"), *rows])
    picture(folder / "communication.png", runs)
    last, model = np.array(runs[-1]["table"]), seconds(runs, 1e4, 1e5)
    return fe_el.write_summary(
        folder, MPI.COMM_SELF, largest_ranks=runs[-1]["ranks"], steps=steps,
        particles_per_rank=runs[-1]["particles"] / runs[-1]["ranks"], cells_per_rank=runs[-1]["cells"] / runs[-1]["ranks"],
        sub_steps=runs[-1]["sub_steps"], rebuilds=runs[-1]["rebuilds"],
        **{f"{what}_{stage.replace(' ', '_')}": last[k, :, n].sum() for k, stage in enumerate(STAGES)
           for n, what in ((0, "calls"), (1, "messages"), (2, "bytes"))},
        **{f"model_seconds_{kind}": value for kind, value in model.items()})


def picture(name, runs):
    """PNG: messages, or calls of collectives, and bytes per rank and step against the number of ranks, by kind."""
    from matplotlib import pyplot as plt
    figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    tables, numbers = np.array([r["table"] for r in runs]).sum(1), [r["ranks"] for r in runs]
    for axis, what in zip(axes, ("messages or calls", "bytes")):
        for k, kind in enumerate(KINDS):
            values = tables[:, k, 2] if what == "bytes" else tables[:, k, :2].max(1)
            axis.plot(numbers, np.maximum(values, 0.1), "o-", label=kind.replace("_", " "))
        axis.set(xscale="log", yscale="log", xticks=numbers, xticklabels=numbers)
        axis.set(xlabel="ranks", ylabel=f"{what} per rank and step")
        axis.minorticks_off()
    axes[0].legend(fontsize=8)
    figure.savefig(name, dpi=100)
    plt.close(figure)


if __name__ == "__main__":
    options = vars(arguments().parse_args())
    if options["count"]:
        logging.getLogger().setLevel(logging.WARNING)
        counts = count(options["count"], options["steps"])
        if MPI.COMM_WORLD.rank == 0:
            print(json.dumps(counts), flush=True)
    else:
        for key, value in main(**options).items():
            print(f"{key:40s} {value}")
