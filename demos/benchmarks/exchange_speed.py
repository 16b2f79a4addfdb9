"""Speed of the exchange: mapping and drag per particle and step, in beds and in suspensions of up to a million particles."""
import argparse
import logging
import resource
import sys
import time
from pathlib import Path

import numpy as np
from mpi4py import MPI

import fe_el

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from demos import fluidised_bed

GAS_DENSITY, GAS_VISCOSITY, DENSITY, DIAMETER, CUBE, PER_CUBE = 1.2, 1.8e-5, 1500.0, 75e-6, 6, 41
SOLID_FRACTION = 0.5  # of the beds, whose lattice is pressed together


def arguments():
    """Command line of the demo."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    p.add_argument("--slices", type=float, nargs="*", default=(0.22, 1.0), help="fractions of the fluidised bed's width")
    p.add_argument("--particles", type=int, nargs="*", default=(10_000, 100_000, 1_000_000), help="particles of suspensions")
    p.add_argument("--steps", type=int, default=10, help="steps that are timed, after two that are not")
    p.add_argument("--output", default="out/exchange_speed", help="folder for results")
    return p


def bed(part):
    """Beads, air and coupling of the fluidised bed, with its beads as close as in a bed at rest, in the order of their
    cells."""
    beads, _, air, coupling = fluidised_bed.assemble(slice=part)
    fluidised_bed.fill(beads, part, 1)
    area = fluidised_bed.WIDTH * part * fluidised_bed.DEPTH
    filled, top = beads.comm.allreduce(beads.volume.sum()), beads.comm.allreduce(beads.position[:, 2].max(initial=0.0),
                                                                                 op=MPI.MAX)
    beads.position[:, 2] *= filled / (SOLID_FRACTION * area * top)
    beads.locate()
    beads.select(np.argsort(beads.cell, kind="stable"))
    return beads, air, coupling


def suspension(number):
    """Particles, gas and coupling of a periodic suspension: about 41 particles of 1/6 of the edge in each cube, in no
    order."""
    cubes = max(round((number / PER_CUBE) ** (1 / 3)), 3)
    edge = cubes * CUBE * DIAMETER
    mesh, _ = fe_el.periodic_box((edge,) * 3, (cubes,) * 3)
    particles = fe_el.Particles(mesh, DENSITY, (0, 0, -9.81))
    particles.insert_in_box((0, 0, 0), (edge,) * 3, number, DIAMETER, seed=1)
    balance = np.array([0, 0, 9.81 * DENSITY * number * np.pi / 6 * DIAMETER ** 3 / edge ** 3])
    gas = fe_el.VolumeAveragedNavierStokes(mesh, None, GAS_DENSITY, GAS_VISCOSITY, mean_pressure_gradient=balance)
    coupling = fe_el.Coupling(particles, gas.velocity, gas.pressure, GAS_DENSITY, GAS_VISCOSITY,
                              [fe_el.Drag("beetstra"), fe_el.PressureGradient(balance)])
    return particles, gas, coupling


def measured(particles, fluid, coupling, dt, steps, moves):
    """Medians over the steps [ns per particle] of mapping, drag and fluid; particles fly freely if they are to move."""
    rows = []
    for step in range(steps + 2):
        before, tick = dict(coupling.seconds), time.perf_counter()
        coupling.to_fluid(dt)
        middle = time.perf_counter()
        fluid.advance(dt, coupling.fields)
        flow = time.perf_counter() - middle
        coupling.to_particles(dt)
        whole = time.perf_counter() - tick
        if moves:
            particles.advance(dt)
        if step > 1:
            rows.append([coupling.seconds[stage] - before[stage] for stage in ("mapping", "drag")] + [flow, whole])
    slowest = np.empty((steps, 4))
    particles.comm.Allreduce(np.array(rows), slowest, op=MPI.MAX)
    return np.median(slowest, axis=0) / particles.total_number * 1e9


def main(slices=(0.22, 1.0), particles=(10_000, 100_000, 1_000_000), steps=10, output="out/exchange_speed", progress=True):
    """Time every scene and return the summary."""
    if steps < 1:
        raise ValueError(f"--steps is {steps}; give 1 or more.")
    logging.getLogger().setLevel(logging.WARNING)
    comm, numbers, suspensions = MPI.COMM_WORLD, {}, []
    for make, size, dt, name in [(bed, s, 1e-3, "bed") for s in slices] + [(suspension, n, 1e-4,
                                                                            "suspension") for n in particles]:
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        scene = make(size)
        mapping, drag, fluid, whole = measured(*scene, dt, steps, make is suspension)
        number = scene[0].total_number
        memory = 1024 * comm.allreduce(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory) / number
        if make is suspension:
            suspensions.append((number, mapping + drag))
        numbers |= {f"{key}_{name}_{number}": value for key, value in (
            ("nanoseconds_of_mapping", mapping), ("nanoseconds_of_drag", drag), ("nanoseconds_of_exchange", mapping + drag),
            ("share_of_fluid", fluid / whole), ("bytes_per_particle", memory),
            ("cells", comm.allreduce(scene[0].cells.owned)), ("momentum_imbalance", scene[2].momentum_imbalance))}
        if comm.rank == 0 and progress:
            print(f"{name:10s} of {number:8d}: mapping {mapping:5.0f} ns, drag {drag:5.0f} ns, together "
                  f"{mapping + drag:5.0f} ns per "
                  f"particle and step, fluid {100 * fluid / whole:3.0f} % of the step, {memory:6.0f} bytes per particle",
                  flush=True)
    if len(suspensions) > 1:
        (few, cost_few), (many, cost_many) = suspensions[0], suspensions[-1]
        numbers["growth_exponent"] = 1 + np.log(cost_many / cost_few) / np.log(many / few)
        if comm.rank == 0 and progress:
            print(f"cost grows with the number to the power {numbers['growth_exponent']:.3f}", flush=True)
    return fe_el.write_summary(output, comm, **numbers)


if __name__ == "__main__":
    main(**vars(arguments().parse_args()))
