"""Cost of wall contacts: processor time per bead and sub-step of beads that fly, slide on a floor and roll in a pipe.

Scenes: far from walls; one layer on a floor of mesh facets; a row in a pipe whose flat sides are facets of the mesh; the
same where they are triangles of a surface (as from an STL file). Scenes take turns, and the least of the repeats counts, so
that other work on the machine disturbs little. Where beads touch, each touches one wall: what is more than in free flight
is a contact's.
    python demos/benchmarks/wall_contacts.py
"""
import argparse
import logging
import time

import numpy as np
from dolfinx import mesh as dmesh
from mpi4py import MPI

import fe_el
from fe_el.dolfinx_api import create_mesh

DIAMETER, DENSITY = 1e-3, 2500.0
LAW = fe_el.LinearSpringDashpot(100.0, 0.5, 0.3)
SCENES = ("free", "floor", "pipe", "surface")


def arguments():
    """Command line of the benchmark."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--scenes", nargs="+", default=SCENES, choices=SCENES, help=" ".join(SCENES))
    p.add_argument("--sides", type=int, default=64, help="flat sides of the pipe (64)")
    p.add_argument("--ratio", type=float, default=4.0, help="diameter of the pipe over that of the beads (4)")
    p.add_argument("--beads", type=int, default=2025, help="on the floor and in flight (2025); a fifth of them in the pipe")
    p.add_argument("--steps", type=int, default=2000, help="sub-steps that are timed at once (2000)")
    p.add_argument("--repeats", type=int, default=12, help="of which the least time counts (12)")
    p.add_argument("--output", default="out/wall_contacts", help="folder for results (out/wall_contacts)")
    return p


def layer(beads, falls):
    """A square layer of beads that slide on the floor, or fly above it if they do not fall: particles and contacts."""
    across = int(np.sqrt(beads))
    length = 2 * DIAMETER * (across + 1)
    mesh, tags = fe_el.box((length, length, 4 * DIAMETER), (across // 2, across // 2, 2))
    particles = fe_el.Particles(mesh, DENSITY, (0, 0, -9.81 * falls))
    places = 2 * DIAMETER * (np.arange(across) + 1)
    x = np.array([(a, b, DIAMETER / 2 if falls else 3 * DIAMETER) for a in places for b in places])
    slide = np.random.default_rng(1).uniform(-0.01, 0.01, x.shape) * (1, 1, 0)
    particles.insert_at(x, DIAMETER, velocity=falls * slide)
    return particles, fe_el.Contacts(particles, LAW, (tags, 5))


def pipe(radius, sides, length, layers):
    """Flat sides that touch the circle: points (n, 3), tetrahedra of the inside and triangles of the sides."""
    around = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    ring = radius / np.cos(np.pi / sides) * np.column_stack([np.cos(around), np.sin(around)])
    points = np.array([(*p, length * k / layers) for k in range(layers + 1) for p in ((0, 0), *ring)])
    a = np.repeat((sides + 1) * np.arange(layers), sides)
    b = a + 1 + np.tile(np.arange(sides), layers)
    c = a + 1 + np.tile((np.arange(sides) + 1) % sides, layers)
    d, e, f = (corner + sides + 1 for corner in (a, b, c))
    cells = np.concatenate([np.column_stack(corners) for corners in ((a, b, c, f), (a, b, e, f), (a, d, e, f))])
    return points, cells, np.concatenate([np.column_stack([b, c, f]), np.column_stack([b, e, f])])


def row_in_pipe(beads, sides, ratio, of_mesh):
    """A row of beads that roll at the bottom of a lying pipe, of mesh facets or of a surface's: particles and contacts."""
    radius, length = ratio * DIAMETER / 2, 1.5 * DIAMETER * beads
    points, cells, triangles = pipe(radius, sides, length, max(beads // 2, 1))
    if of_mesh:
        mesh = create_mesh(MPI.COMM_SELF, cells, points)
        mesh.topology.create_connectivity(2, 3)
        mesh.topology.create_connectivity(2, 0)
        facets = np.sort(dmesh.exterior_facet_indices(mesh.topology))
        x = dmesh.compute_midpoints(mesh, 2, facets)
        facets = facets[np.hypot(x[:, 0], x[:, 1]) > 0.8 * radius].astype(np.int32)
        wall = fe_el.FacetWalls(dmesh.meshtags(mesh, 2, facets, np.ones(len(facets), np.int32)), 1)
    else:
        mesh, _ = fe_el.box((4 * radius, 4 * radius, length), (2, 2, max(beads // 2, 1)), MPI.COMM_SELF)
        points = points + (2 * radius, 2 * radius, 0)
        wall = fe_el.SurfaceWall((points, triangles), may_be_open=True)
    particles, at = fe_el.Particles(mesh, DENSITY, (0, -9.81, 0)), radius - DIAMETER / 2
    angle = np.random.default_rng(1).uniform(-0.3, 0.3, beads) - np.pi / 2
    particles.insert_at(points[0] + np.column_stack([at * np.cos(angle), at * np.sin(angle),
                                                     1.5 * DIAMETER * (np.arange(beads) + 0.5)]), DIAMETER)
    return particles, fe_el.Contacts(particles, LAW, [wall])


def main(scenes=SCENES, sides=64, ratio=4.0, beads=2025, steps=2000, repeats=12, output="out/wall_contacts"):
    """Time all scenes in turn and return the summary."""
    logging.getLogger().setLevel(logging.WARNING)
    if MPI.COMM_WORLD.size > 1:
        raise ValueError(f"There are {MPI.COMM_WORLD.size} ranks; run this benchmark on one, without mpirun.")
    make = {"free": lambda: layer(beads, 0), "floor": lambda: layer(beads, 1),
            "pipe": lambda: row_in_pipe(beads // 5, sides, ratio, True),
            "surface": lambda: row_in_pipe(beads // 5, sides, ratio, False)}
    made = {name: make[name]() for name in scenes}
    spent = {name: [] for name in scenes}
    for particles, contacts in made.values():
        particles.advance(0.02, contacts)  # compiled, fallen, rolling
    for _ in range(repeats):
        for name, (particles, contacts) in made.items():
            time_step = steps * contacts.step_limit()
            begin = time.process_time()
            particles.advance(time_step, contacts)
            spent[name].append((time.process_time() - begin) / contacts.steps_last / len(particles) * 1e9)
    numbers = {f"nanoseconds_per_bead_{name}": min(each) for name, each in spent.items()}
    numbers |= {f"contacts_per_bead_{name}": contacts.touching / len(beads) for name, (beads, contacts) in made.items()}
    return fe_el.write_summary(output, MPI.COMM_WORLD, **numbers)


if __name__ == "__main__":
    for key, value in main(**vars(arguments().parse_args())).items():
        print(f"{key:32s} {value}")
