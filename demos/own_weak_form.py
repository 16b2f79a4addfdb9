"""A user's own weak form: Taylor-Hood fluid in UFL, coupled to particles through void fraction, drag coefficient and
source."""
import argparse
import logging
import sys
import time
from pathlib import Path

from mpi4py import MPI  # noqa: F401, isort: skip (the wheels of dolfinx find their MPI through it)
import numpy as np
import ufl
from dolfinx import fem

import fe_el
from fe_el.dolfinx_api import linear_problem, taylor_hood_space

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from demos import reports

RHO, MU, INLET_SPEED, SIZE = 1.2, 1.8e-5, 0.3, 0.02
REPORTS = {"fall": reports.Report(
    settings=tuple({"cells": n, "time_step": dt} for n, dt in (
        (12, 1.25e-4), (12, 5e-4), (6, 2.5e-4), (6, 5e-4), (6, 1e-3), (6, 2e-3), (3, 5e-4), (3, 2e-3))),
    quantities={"mean_velocity": None}, first={"end_time": 4e-3}, within=0.005)}  # most of the velocity is free fall


def arguments():
    """Command line of the demo."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    p.add_argument("--dimension", type=int, default=2, choices=(2, 3), help="of space")
    p.add_argument("--cells", type=int, default=6, help="cells across the box, twice as many along it")
    p.add_argument("--particles", type=int, default=400, help="number of beads of 0.5 mm")
    p.add_argument("--end-time", type=float, default=0.02, help="simulated time [s]")
    p.add_argument("--time-step", type=float, default=5e-4, help="[s]")
    p.add_argument("--output", default="out/own_weak_form", help="folder for results")
    return p


def main(dimension=2, cells=6, particles=400, end_time=0.02, time_step=5e-4, output="out/own_weak_form", progress=True):
    """Blow through a cloud of beads and return the summary."""
    logging.getLogger().setLevel(logging.WARNING)
    d, up = dimension, dimension - 1
    lengths = (SIZE,) * up + (2 * SIZE,)
    mesh, tags = fe_el.box(lengths, (cells,) * up + (2 * cells,))
    beads = fe_el.Particles(mesh, density=1000.0, gravity=(0,) * up + (-9.81,), thickness=1e-3)
    beads.insert_in_box((0.1 * SIZE,) * d, (0.9 * SIZE,) * d, particles, diameter=5e-4, seed=1)

    # -- the fluid: momentum of model A and continuity, implicit Euler, Taylor-Hood ------------------------------------
    space = taylor_hood_space(mesh)
    new, old = fem.Function(space), fem.Function(space)
    (u, p), (v, q), (u_new, p_new), (u_old, _) = (ufl.TrialFunctions(space), ufl.TestFunctions(space), ufl.split(new),
                                                  ufl.split(old))
    coupling = fe_el.Coupling(beads, u_new, p_new, RHO, MU, [fe_el.Drag("beetstra"), fe_el.PressureGradient()])
    void, drag, source = coupling.fields
    void_old, dt = fem.Function(void.function_space), fem.Constant(mesh, time_step)
    bottom, top = 2 * up + 1, 2 * up + 2
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=tags)
    a = (RHO * void / dt * ufl.inner(u, v) + RHO * void * ufl.inner(ufl.dot(u_old, ufl.nabla_grad(u)), v)
         + void * MU * ufl.inner(ufl.grad(u), ufl.grad(v)) + void * ufl.inner(ufl.grad(p), v) + drag * ufl.inner(u, v)
         - void * ufl.inner(u, ufl.grad(q))) * ufl.dx
    inflow = INLET_SPEED * q * ds(bottom)
    L = (RHO * void_old / dt * ufl.inner(u_old, v) + ufl.inner(source, v) - (void - void_old) / dt * q) * ufl.dx + inflow
    velocity_space, _ = space.sub(0).collapse()
    pressure_space, _ = space.sub(1).collapse()
    inlet = fem.Function(velocity_space)
    inlet.interpolate(lambda x: np.vstack([np.zeros((up, x.shape[1])), np.full((1, x.shape[1]), INLET_SPEED)]))
    facets = lambda *groups: tags.indices[np.isin(tags.values, groups)]
    on = lambda k, sub, *groups: fem.locate_dofs_topological((space.sub(k), sub), d - 1, facets(*groups))
    sides = [g for g in range(1, 2 * d + 1) if g not in (bottom, top)]
    still, outside = fem.Function(velocity_space), fem.Function(pressure_space)
    bcs = [fem.dirichletbc(inlet, on(0, velocity_space, bottom), space.sub(0)),
           fem.dirichletbc(still, on(0, velocity_space, *sides), space.sub(0)),
           fem.dirichletbc(outside, on(1, pressure_space, top), space.sub(1))]
    solver = {"ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}
    problem = linear_problem(a, L, bcs, new, solver)

    # -- the loop ------------------------------------------------------------------------------------------------------
    out = fe_el.ParaViewOutput(output, beads, [void, drag], every=end_time / 10)
    coupling.to_fluid(time_step)
    void_old.x.array[:] = void.x.array
    worst, seconds, start, processor = 0.0, 0.0, time.perf_counter(), time.process_time()
    for now in fe_el.time_steps(time_step, end_time, progress=progress):
        coupling.to_fluid(time_step)
        tick = time.perf_counter()
        problem.solve()
        seconds += time.perf_counter() - tick
        old.x.array[:], void_old.x.array[:] = new.x.array, void.x.array
        coupling.to_particles(time_step)
        beads.advance(time_step)
        worst = max(worst, coupling.momentum_imbalance)
        out.write(now)
    return fe_el.write_summary(output, mesh.comm, particles=beads.total_number, dimension=d, end_time=end_time,
                               momentum_imbalance=worst, solid_volume_error=coupling.solid_volume_error,
                               mean_velocity=beads.momentum()[up] / mesh.comm.allreduce(beads.mass.sum()),
                               seconds_fluid=seconds,
                               wall_time=time.perf_counter() - start,
                               processor_time=mesh.comm.allreduce(time.process_time() - processor),
                               **fe_el.stage_seconds(coupling, out))


if __name__ == "__main__":
    reports.start(main, arguments(), REPORTS)
