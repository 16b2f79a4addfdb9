"""Speed of contacts: a settled bed of beads, tiled to a thousand up to a million of them; cost and memory per particle."""
import argparse
import logging
import resource
import time
from pathlib import Path

import matplotlib
import numpy as np
from mpi4py import MPI
from numba import njit

import fe_el
from fe_el.particles.contacts.records import Drift
from fe_el.particles.contacts.velocity_verlet import kick_and_drift

matplotlib.use("Agg")
DIAMETER, DENSITY, RESTITUTION, FRICTION, CONTACT_STEP = 1.5e-3, 2525.0, 0.9, 0.1, 1e-5
TILE, HEIGHT, TILE_PARTICLES = 0.015, 0.03, 1000


def arguments():
    """Command line of the demo."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    p.add_argument("--tiles", type=int, nargs="+", default=(1, 3, 10), help="tiles per direction; each holds 1000 beads")
    p.add_argument("--steps", type=int, default=400, help="contact steps that are timed, after as many that are not")
    p.add_argument("--settle-steps", type=int, default=12000, help="contact steps in which the first tile settles")
    p.add_argument("--output", default="out/contact_speed", help="folder for results")
    return p


def contact_law():
    """Linear law with a contact time of 22 steps, tangential springs and rotation on."""
    mass = DENSITY * np.pi / 6 * DIAMETER ** 3
    rate = -2 * np.log(RESTITUTION) / (22 * CONTACT_STEP)
    stiffness = mass / 2 * ((np.pi / (22 * CONTACT_STEP)) ** 2 + rate ** 2 / 4)
    return fe_el.LinearSpringDashpot(stiffness, RESTITUTION, FRICTION)


def bed(tiles, position, velocity):
    """Beads on a floor of facets in a box that is periodic to the sides: copies of one tile."""
    cells = (3 * tiles, 3 * tiles, 4)
    mesh, tags = fe_el.periodic_box((TILE * tiles, TILE * tiles, HEIGHT), cells, (True, True, False), slices_along=0)
    beads = fe_el.Particles(mesh, DENSITY, (0, 0, -9.81))
    shift = TILE * np.array([(i, j, 0) for i in range(tiles) for j in range(tiles)])
    beads.insert_at((position + shift[:, None]).reshape(-1, 3), DIAMETER, velocity=np.tile(velocity, (tiles ** 2, 1)))
    return beads, fe_el.Contacts(beads, contact_law(), (tags, 5), steps_per_contact=22)


def settled_tile(steps):
    """Positions and velocities of one settled tile, the same on every rank."""
    mesh, tags = fe_el.periodic_box((TILE, TILE, HEIGHT), (3, 3, 4), (True, True, False))
    beads = fe_el.Particles(mesh, DENSITY, (0, 0, -9.81))
    beads.insert_on_lattice((0, 0, 0), (TILE, TILE, HEIGHT), np.full(TILE_PARTICLES, DIAMETER * 0.999), seed=1)
    beads.diameter[:] = DIAMETER * 0.999
    contacts = fe_el.Contacts(beads, contact_law(), (tags, 5), steps_per_contact=22)
    for _ in range(max(steps // 100, 1)):
        beads.advance(100 * CONTACT_STEP, contacts)
    beads.locate()  # back into the periodic box
    parts = beads.comm.allgather((beads.id, beads.position, beads.velocity))
    ids, x, v = (np.concatenate([p[i] for p in parts]) for i in range(3))
    order = np.argsort(ids)
    return x[order], v[order]


@njit
def _integrate(rows, drift, owned, repeats):
    """Kicks and drifts of some sub-steps, one after the other."""
    for _ in range(repeats):
        kick_and_drift(rows, drift, 1.0, CONTACT_STEP, 0, owned)


def integration_seconds(contacts, repeats=20):
    """Seconds that kicks and drifts of one step take by themselves, on copies of the particles of this rank."""
    lists, p = contacts.lists, contacts.particles
    rows = lists.rows._replace(x=lists.rows.x.copy(), state=lists.rows.state.copy(), force=lists.rows.force.copy())
    drift = Drift(np.zeros((len(p), 3)), 10 / (p.mass * p.diameter ** 2), lists.x0, np.zeros((0, 4)))
    _integrate(rows, drift, len(p), 1)
    start = time.perf_counter()
    _integrate(rows, drift, len(p), repeats)
    return (time.perf_counter() - start) / repeats


def main(tiles=(1, 3, 10), steps=400, settle_steps=12000, output="out/contact_speed", progress=True):
    """Time every size and return the summary."""
    logging.getLogger().setLevel(logging.WARNING)
    comm, numbers, rows = MPI.COMM_WORLD, {}, []
    tile = settled_tile(settle_steps)
    start = time.perf_counter()
    for count in tiles:
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        beads, contacts = bed(count, *tile)
        beads.advance(steps * CONTACT_STEP, contacts)
        before, tick = dict(contacts.seconds), time.perf_counter()
        beads.advance(steps * CONTACT_STEP, contacts)
        wall = comm.allreduce(time.perf_counter() - tick, op=MPI.MAX)
        number, pairs = beads.total_number, comm.allreduce(len(contacts.lists.pairs.first))
        memory = comm.allreduce(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory)
        share = (contacts.seconds["neighbours"] - before["neighbours"]) / wall
        integration = comm.allreduce(integration_seconds(contacts), op=MPI.MAX) * contacts.steps_last / wall
        rows.append((number, wall / number / contacts.steps_last * 1e9))
        numbers[f"nanoseconds_per_particle_step_{number}"] = rows[-1][1]
        numbers[f"million_particle_steps_per_second_{number}"] = 1e3 / rows[-1][1]
        numbers[f"share_of_neighbour_search_{number}"] = share
        numbers[f"share_of_integration_{number}"] = integration
        numbers[f"share_of_forces_{number}"] = 1 - share - integration
        numbers[f"neighbours_per_particle_{number}"] = pairs / number
        numbers[f"contacts_per_particle_{number}"] = comm.allreduce(contacts.touching) / number
        numbers[f"bytes_per_particle_{number}"] = 1024 * memory / number
        if comm.rank == 0 and progress:
            print(f"{number:9d} beads: {1e3 / rows[-1][1]:6.2f} million particle-steps per second, {rows[-1][1]:6.1f} ns "
                  f"each, "
                  f"{100 * share:4.1f} % search, {100 * integration:4.1f} % integration, {1024 * memory / number:6.0f} "
                  f"bytes per particle", flush=True)
    numbers["wall_time"] = time.perf_counter() - start
    if comm.rank == 0:
        Path(output).mkdir(parents=True, exist_ok=True)
        picture(output, np.array(rows))
    return fe_el.write_summary(output, comm, **numbers)


def picture(output, rows):
    """PNG: nanoseconds per particle and step against the number of particles."""
    from matplotlib import pyplot as plt
    figure, axis = plt.subplots(figsize=(6, 4))
    axis.semilogx(rows[:, 0], rows[:, 1], marker="o")
    axis.set(xlabel="particles", ylabel="time per particle and step [ns]", ylim=(0, None))
    axis.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(Path(output) / "contact_speed.png", dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    main(**vars(arguments().parse_args()))
