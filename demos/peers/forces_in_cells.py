"""Forces that act in single cells of a viscous fluid, in one cell or in ten: their velocity beside Taylor-Hood elements.

A closed box of liquid at rest, forces upwards in some of its tetrahedra, steps of nu dt / h^2, h the edge of the cubes that
six tetrahedra make up; mean velocity of these cells times 6 pi mu h over the force of one. Taylor-Hood elements (velocity
P2, pressure P1) solve the steady problem on the same mesh.
"""
import argparse
import csv
import logging
import time
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import exterior_facet_indices
from mpi4py import MPI
from tqdm import tqdm

import fe_el
from fe_el.dolfinx_api import linear_problem, scalar_space, taylor_hood_space, vector_space

DIRECT = {"ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}
FORCE = 1e-3


def arguments():
    """Command line of the demo."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    p.add_argument("--cubes", type=int, default=8, help="cubes along an edge of the box")
    p.add_argument("--numbers", type=float, nargs="+", default=(0.05, 5.0, 50.0, 500.0), help="steps nu dt / h^2")
    p.add_argument("--seed", type=int, default=1, help="of the choice of cells")
    p.add_argument("--output", default="out/forces_in_cells", help="folder for results")
    return p


def choices(centre, seed):
    """Cells that forces act in, by name: one, ten scattered, ten of the hundred next to the middle, the ten next to it."""
    rng = np.random.default_rng(seed)
    inner = np.flatnonzero(np.abs(centre - 0.5).max(1) < 0.3)
    near = np.argsort(np.linalg.norm(centre - 0.5, axis=1), kind="stable")
    return {"one": near[:1], "another": inner[5:6], "ten scattered": rng.choice(inner, 10, False),
            "ten of a hundred": rng.choice(near[:100], 10, False), "ten in a heap": near[:10]}


def steady(mesh, source, volume):
    """A function that solves with Taylor-Hood elements for ``source`` as it is and gives upward cell means (cells,)."""
    space = taylor_hood_space(mesh)
    (u, p), (v, q) = ufl.TrialFunctions(space), ufl.TestFunctions(space)
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) - p * ufl.div(v) - q * ufl.div(u) - 1e-10 * p * q) * ufl.dx
    velocity, _ = space.sub(0).collapse()
    mesh.topology.create_connectivity(2, 3)
    dofs = fem.locate_dofs_topological((space.sub(0), velocity), 2, exterior_facet_indices(mesh.topology))
    walls, solution = fem.dirichletbc(fem.Function(velocity), dofs, space.sub(0)), fem.Function(space)
    problem = linear_problem(a, ufl.inner(source, v) * ufl.dx, [walls], solution, DIRECT)
    means = fem.form(ufl.inner(solution.sub(0), ufl.TestFunction(source.function_space)) * ufl.dx)

    def solve():
        problem.solve()
        return fem.assemble_vector(means).array.reshape(-1, 3)[:len(volume), 2] / volume
    return solve


def marched(mesh, tags, fields, number, cubes):
    """The same by fe_el, in steps until 0.3 viscous times of the box, and at least 60."""
    fluid, dt = fe_el.VolumeAveragedNavierStokes(mesh, tags, density=1.0, viscosity=1.0, tolerance=1e-9), number / cubes ** 2
    fluid.set_no_slip(tuple(range(1, 7)))
    for _ in range(max(int(0.3 / dt), 60)):
        fluid.advance(dt, fields)
    return fluid.velocity.x.array.reshape(-1, 3)[:fluid.num_cells, 2]


def main(cubes=8, numbers=(0.05, 5.0, 50.0, 500.0), seed=1, output="out/forces_in_cells", progress=True):
    """Compare both and return the summary; on one rank."""
    logging.getLogger().setLevel(logging.WARNING)
    start, (mesh, tags) = time.perf_counter(), fe_el.box((1.0,) * 3, (cubes,) * 3)
    corner = fe_el.VolumeAveragedNavierStokes(mesh, tags, density=1.0, viscosity=1.0)
    volume, unit = corner.volume, 6 * np.pi / cubes / FORCE
    scalar, vector = scalar_space(mesh, "DG", 0), vector_space(mesh, "DG", 0)
    void, drag, source = fem.Function(scalar), fem.Function(scalar), fem.Function(vector)
    void.x.array[:] = 1.0
    peer, rows, worst = steady(mesh, source, volume), [], {}
    for name, cells in tqdm(choices(corner.corner.mean(1), seed).items(), disable=not progress):
        source.x.array[:] = 0.0
        source.x.array.reshape(-1, 3)[cells, 2] = FORCE / volume[cells]
        right = peer()[cells].mean()
        for number in numbers:
            found = marched(mesh, tags, (void, drag, source), number, cubes)[cells].mean()
            rows.append((name, number, found * unit, right * unit, found / right - 1))
            worst[name] = max(worst.get(name, 0.0), abs(found / right - 1))
    Path(output).mkdir(parents=True, exist_ok=True)
    with open(Path(output) / "forces_in_cells.csv", "w", newline="") as file:
        csv.writer(file).writerows([("forces", "nu_dt_over_h2", "velocity", "velocity_taylor_hood", "deviation"), *rows])
    for row in rows:
        print("{:18s} nu dt / h^2 {:<8g} {:.3f}, Taylor-Hood {:.3f}: {:+.1%}".format(*row))
    return fe_el.write_summary(output, MPI.COMM_SELF, cubes=cubes, wall_time=time.perf_counter() - start,
                               **{"largest_deviation_" + name.replace(" ", "_"): value for name, value in worst.items()})


if __name__ == "__main__":
    for key, value in main(**vars(arguments().parse_args())).items():
        print(f"{key:32s} {value}")
