"""Scenes of ``leaving_out.py`` beside loops by hand of the same kernels: what the package costs around them.

A loop by hand calls the compiled loops, the drag law and the linear solvers that a scene needs, with arrays that lie ready,
and has nothing around them: it takes the time that is spent inside. That is measured by a clock around each call in the very
steps that it is compared with, so on the same data; seconds are processor time, less what the clocks take. What a step takes
beyond its kernels is the package: checks, records, classes and numpy between them, some of which a loop by hand would have,
too. One that is written in Python must at least find the compiled version for its arguments before each call: ``called``.
``kernels.csv`` lists the kernels of each scene with their calls in a step: what a scene leaves out must not be there.
"""
import argparse
import csv
import logging
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
from mpi4py import MPI
from numba.core.registry import CPUDispatcher
from tqdm import tqdm

import fe_el
from fe_el.compiled import direct_calls
from fe_el.nodes.nodal_matrix import NodalMatrix

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from demos.benchmarks import leaving_out

DT = 1e-3
OF_BED = ("everything", "one-way", "frozen flow", "fixed bed", "dry", "no friction", "point particles", "no smoothing",
          "no pressure gradient", "one diameter", "no contacts", "tracers: one-way, no contacts", "gas alone")


def arguments():
    """Command line of the demo."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    p.add_argument("--slice", type=float, default=0.2, help="fraction of the bed's width")
    p.add_argument("--settle-time", type=float, default=0.2, help="time in which the beads settle without gas [s]")
    p.add_argument("--steps", type=int, default=12, help="steps of 1 ms that are measured; half as many go before them")
    p.add_argument("--scenes", nargs="+", default=(), help="names of those to measure; absent: all")
    p.add_argument("--output", default="out/leaving_out_by_hand", help="folder for results")
    return p


class Timed:
    """A compiled loop, or a linear solver, whose calls are counted and timed."""

    def __init__(self, thing, name, kernels):
        self._thing, self._name, self._kernels = thing, name, kernels

    def __call__(self, *arguments, **named):
        return self._kernels.timed(self._name, self._thing, *arguments, **named)

    def __getattr__(self, name):
        value = getattr(self._thing, name)
        return Timed(value, self._name, self._kernels) if name == "solve" else value


class Kernels:
    """Times all compiled loops and linear solvers of the package while it is entered; loops must be compiled before.

    Attributes:
        seconds (float): processor time inside of them.
        finding (float): that of finding their compiled versions, where numba does not do it inside.
        found (int): how often these were looked for.
        calls (Counter): of each, by name.
    """

    def __init__(self, solvers=()):
        self.seconds, self.calls, self.solvers, self._put_back = 0.0, Counter(), list(solvers), []
        self.finding, self.found = 0.0, 0

    def timed(self, name, function, *arguments, **named):
        """Call a function and add its time, that of others inside of it once."""
        before, tick = self.seconds, time.thread_time()
        out = function(*arguments, **named)
        self.seconds = before + time.thread_time() - tick
        self.calls[name] += 1
        return out

    @staticmethod
    def of_clock(number=2000):
        """Processor seconds that the clock of a call adds to a step, and to the kernels in it."""
        kernels, tick = Kernels(), time.thread_time()
        nothing = Timed(int, "nothing", kernels)
        for _ in range(number):
            nothing()
        return (time.thread_time() - tick) / number, kernels.seconds / number

    def __enter__(self):
        for module in [m for name, m in sys.modules.items() if name.startswith("fe_el") and m is not None]:
            for name, value in list(vars(module).items()):
                if isinstance(value, CPUDispatcher):
                    self._replace(module, name, Timed(value, value.__name__, self))
        assemble, coefficient = NodalMatrix.assemble, fe_el.Drag.coefficient

        def call(loop, *arguments):
            tick, kinds = time.thread_time(), []
            direct_calls._add_kinds(arguments, kinds)
            version = loop._entries.get(tuple(kinds), loop.dispatcher)
            self.finding, self.found = self.finding + time.thread_time() - tick, self.found + 1
            return self.timed(loop.dispatcher.__name__, version, *arguments)
        self._replace(direct_calls.Direct, "__call__", call)
        self._replace(NodalMatrix, "assemble", lambda matrix: self.timed("assemble", assemble, matrix))
        self._replace(fe_el.Drag, "coefficient", lambda drag, *given: self.timed("drag law", coefficient, drag, *given))
        for solver in self.solvers:
            self._replace(solver, "ksp", Timed(solver.ksp, "solve " + solver.name, self))
        return self

    def _replace(self, owner, name, new):
        self._put_back.append((owner, name, getattr(owner, name)))
        setattr(owner, name, new)

    def __exit__(self, *_):
        for owner, name, old in reversed(self._put_back):
            setattr(owner, name, old)
        self._put_back.clear()


class Box(leaving_out.Scene):
    """A suspension without walls, in two or three dimensions."""

    def __init__(self, dimension, cells, count):
        self.mesh, _ = fe_el.periodic_box((cells * 3e-3,) * dimension, (cells,) * dimension)
        self.moves = self.back = True
        self.air = fe_el.VolumeAveragedNavierStokes(self.mesh, None, 1.2, 1.8e-5, tolerance=1e-9)
        self.air.set_initial_velocity((0.5,) + (0.0,) * (dimension - 1))
        self.beads = fe_el.Particles(self.mesh, 2500.0)
        self.beads.insert_in_box((0.0,) * dimension, (cells * 3e-3,) * dimension, count, 1e-3, seed=1, without_overlap=True)
        law = fe_el.LinearSpringDashpot(500.0, restitution=0.9, friction=0.1)
        self.contacts = fe_el.Contacts(self.beads, law, steps_per_contact=12)
        self.coupling = fe_el.Coupling.of(self.air, self.beads, [fe_el.Drag("beetstra"), fe_el.PressureGradient()])


def measured(scene, steps):
    """Mean processor seconds of a step, of that inside kernels, and to call these, the least ratio of a step, seconds of the
    ledger, and calls of the kernels in a step."""
    for _ in range(max(steps // 2, 2)):
        scene.step(DT)
    air = scene.air if scene.moves else None
    closed = getattr(air, "_closed_flux", None)
    ledger, kernels = Kernels(), Kernels((*getattr(air, "_solvers", ()), *([closed.solver] if closed else ())))
    whole, inside, of_clock = [], [], np.array([Kernels.of_clock() for _ in range(5)]).min(0)
    with kernels:
        for _ in range(steps):
            before, calls, found, tick = kernels.seconds, kernels.calls.total(), kernels.found, time.thread_time()
            scene.step(DT)
            seconds = np.array([time.thread_time() - tick, kernels.seconds - before])
            seconds -= (kernels.calls.total() - calls) * of_clock
            seconds[0] -= 2 * (kernels.found - found) * of_clock[1]  # a call of the clock takes what two show between them
            whole.append(seconds[0])
            inside.append(seconds[1])
    ratio = min(a / b for a, b in zip(whole, inside))
    if scene.coupling is not None:
        for name in ("_solid_ledger", "_momentum_ledger"):
            setattr(scene.coupling, name, Timed(getattr(scene.coupling, name), name, ledger))
        scene.step(DT)
    calls = {name: count / steps for name, count in kernels.calls.items()}
    called = np.mean(inside) + (kernels.finding - kernels.found * of_clock[1]) / steps
    return np.mean(whole), np.mean(inside), called, ratio, ledger.seconds, calls


def main(slice=0.2, settle_time=0.2, steps=12, output="out/leaving_out_by_hand", scenes=(), progress=True):
    """Measure the named scenes, or all, and return the summary; on one rank."""
    logging.getLogger().setLevel(logging.WARNING)
    start, (position, diameter) = time.perf_counter(), leaving_out.settled(slice, settle_time)
    every = {name: lambda name=name: leaving_out.Scene(slice, position, diameter, **leaving_out.VARIANTS[name])
             for name in OF_BED}
    cells, many = 12 * (slice / 0.2) ** (1 / 3), slice / 0.2  # as full at any size
    every |= {"periodic without walls": lambda: Box(3, round(cells), len(position) // 2),
              "two dimensions": lambda: Box(2, round(60 * many ** 0.5), int(4000 * many))}
    rows, kernels, numbers = [], [], {}
    for name in tqdm(scenes or every, disable=not progress):
        whole, inside, called, ratio, ledger, calls = measured(every[name](), steps)
        rows.append((name, whole, inside, whole - inside, whole / inside, ratio, whole / called, ledger / whole))
        kernels += [(name, kernel, count) for kernel, count in sorted(calls.items())]
        key = name.replace(":", "").replace(",", "").replace(" ", "_").replace("-", "_")
        numbers |= {f"ratio_{key}": whole / inside, f"ledger_{key}": ledger / whole}
        print(f"{name:32s} {1e3 * whole:8.3f} ms, by hand {1e3 * inside:8.3f} ms, beyond {1e3 * (whole - inside):6.3f} ms, "
              f"ratio {whole / inside:.3f} (least {ratio:.3f}, called {whole / called:.3f}), {sum(calls.values()):4.0f} "
              f"calls, ledger {100 * ledger / whole:.2f} %", flush=True)
    Path(output).mkdir(parents=True, exist_ok=True)
    for file, head, lines in (("leaving_out_by_hand", ("scene", "seconds", "seconds_by_hand", "seconds_beyond", "ratio",
                                                        "least_ratio", "ratio_called", "share_of_ledger"), rows),
                              ("kernels", ("scene", "kernel", "calls_in_a_step"), kernels)):
        with open(Path(output) / f"{file}.csv", "w", newline="") as out:
            csv.writer(out).writerows([head, *lines])
    return fe_el.write_summary(output, MPI.COMM_SELF, particles=len(position), steps=steps,
                               wall_time=time.perf_counter() - start, **numbers)


if __name__ == "__main__":
    for key, value in main(**vars(arguments().parse_args())).items():
        print(f"{key:40s} {value}")
