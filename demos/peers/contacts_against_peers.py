"""Speed of contacts against LIGGGHTS and LAMMPS: the same settled bed in each code, in million particle-steps per second.

A tile that is periodic to the sides settles in fe_el; copies of it make the bed, with a floor below. All codes get the same
positions, velocities, stiffness, damping, friction and step. The peers run with every skin of ``--skins``, LAMMPS also with
both of its neighbour styles where there are two sizes (that of LIGGGHTS finds no pairs of grains); the fastest of these
counts.
"""
import argparse
import csv
import json
import logging
import re
import shutil
import subprocess
import sys
import time
from collections import namedtuple
from pathlib import Path

import matplotlib
import numpy as np
from mpi4py import MPI
from tqdm import tqdm

import fe_el
from fe_el.parallel.failures import environment_outside_mpirun

matplotlib.use("Agg")
DENSITY, GRAVITY, STEPS_PER_CONTACT, TANGENTIAL_STIFFNESS, TANGENTIAL_DAMPING = 2525.0, 9.81, 22, 2 / 7, 0.5
TIME_OF = r" +(?:time \(%\) = |\| \S+ +\| )"  # before the seconds of a part in the log of LIGGGHTS or LAMMPS
PEERS = {"LIGGGHTS": ("liggghts", "liggghts"), "LAMMPS": ("lmp", "lammps")}  # program, Debian package
# diameters [m] and numbers in a tile of each class, which is a material of its own; (classes, classes); [s]; edge [m]
Scene = namedtuple("Scene", "diameters numbers restitution friction step tile")
PAIRS = np.array([[1, 2], [2, 3]])  # restitution 0.9, 0.8, 0.7 and friction 0.1, 0.2, 0.3 in the mixture
SCENES = {"equal": Scene((1.5e-3,), (1000,), np.array([[0.9]]), np.array([[0.1]]), 1e-5, 0.015),
          "mixture": Scene((1.5e-3, 2.5e-3), (607, 393), 1 - 0.1 * PAIRS, 0.1 * PAIRS, 1e-5, 0.02),
          "wide": Scene((5e-4, 5e-3), (2478, 22), np.full((2, 2), 0.6), np.full((2, 2), 0.1), 1e-6, 0.015)}


def arguments():
    """Command line of the demo."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    p.add_argument("--scene", nargs="+", choices=SCENES, default=tuple(SCENES), help="1.5 mm; 1.5 and 2.5 mm; 0.5 and 5 mm")
    p.add_argument("--particles", type=int, nargs="+", default=(10000, 50000), help="about so many, in whole tiles")
    p.add_argument("--ranks", type=int, default=1, help="MPI ranks of every code")
    p.add_argument("--repeats", type=int, default=3, help="runs of each code, in turn; the median counts")
    p.add_argument("--steps", type=int, default=400, help="steps that are timed, after")
    p.add_argument("--warm-up", type=int, default=200, help="so many that are not")
    p.add_argument("--settle-time", type=float, default=0.2, help="time in which the tile settles [s]")
    p.add_argument("--agitation", type=float, default=0.0,
                   help="random velocity on top, that makes lists go out of date [m/s]")
    p.add_argument("--skins", type=float, nargs="+", default=(0.05, 0.2, 0.8), help="of the peers, in smallest diameters")
    p.add_argument("--output", default="out/contacts_against_peers", help="folder for results")
    return p


def coefficients(scene):
    """Stiffness [N/m] and tables (classes and floor, the same) of damping over reduced mass [1/s] and friction."""
    inverse = np.append(6 / (DENSITY * np.pi * np.array(scene.diameters) ** 3), 0.0)
    rate, rows = inverse[:, None] + inverse, np.append(np.arange(len(inverse) - 1), 0)
    log, friction = np.abs(np.log(scene.restitution))[np.ix_(rows, rows)], scene.friction[np.ix_(rows, rows)]
    stiffness = (np.pi ** 2 + log.min() ** 2) / (rate[0, 0] * (STEPS_PER_CONTACT * scene.step) ** 2)
    return stiffness, 2 * log / np.hypot(np.pi, log) * np.sqrt(stiffness * rate), friction


def beads_and_contacts(scene, tiles, height, comm, kind, position=None, velocity=0.0):
    """The scene in fe_el, periodic to the sides, on a floor of facets; without positions at random, below a ceiling."""
    cells = (3 * tiles[0], 3 * tiles[1], max(round(3 * height / scene.tile), 1))
    size, diameter = np.array([scene.tile * tiles[0], scene.tile * tiles[1], float(height)]), np.array(scene.diameters)[kind]
    mesh, tags = fe_el.periodic_box(size, cells, (True, True, False), comm, slices_along=0)
    beads, gap = fe_el.Particles(mesh, DENSITY, (0, 0, -GRAVITY)), np.array([0, 0, diameter.max() / 2])
    if position is None:
        beads.insert_in_box(gap, size - gap, len(kind), diameter, seed=1, without_overlap=True, material=kind)
    else:
        beads.insert_at(position, diameter, velocity=velocity, material=kind)
    law = fe_el.LinearSpringDashpot(coefficients(scene)[0], *scene[2:4], TANGENTIAL_STIFFNESS, TANGENTIAL_DAMPING)
    return beads, fe_el.Contacts(beads, law, (tags, (5, 6) if position is None else 5), steps_per_contact=STEPS_PER_CONTACT)


def settled_tile(scene, settle_time, progress):
    """Positions, velocities and size classes of one settled tile, and the height of its box."""
    kind, diameters = np.repeat(np.arange(len(scene.numbers)), scene.numbers), np.array(scene.diameters)
    height = np.pi / 6 * (diameters[kind] ** 3).sum() / (0.3 * scene.tile ** 2) + diameters.max()
    beads, contacts = beads_and_contacts(scene, (1, 1), height, MPI.COMM_SELF, kind)
    for _ in tqdm(range(max(round(settle_time / scene.step / 1000), 1)), desc="settle", disable=not progress, mininterval=1):
        beads.advance(1000 * scene.step, contacts)
    order = np.argsort(beads.id)
    return beads.position[order] % [scene.tile, scene.tile, np.inf], beads.velocity[order], kind, height


def write_bed(folder, scene, wanted, tile, agitation):
    """Write the bed for fe_el (bed.npz) and for the peers (.data); returns the number of beads."""
    x, v, kind, height = tile
    number = max(round(wanted / len(x)), 1)
    narrow = max(k for k in range(1, int(np.sqrt(number)) + 1) if number % k == 0)
    tiles = (number // narrow, narrow)
    x = (scene.tile * np.array([(*index, 0) for index in np.ndindex(tiles)])[:, None] + x).reshape(-1, 3)
    v, kind = np.tile(v, (number, 1)) + agitation * np.random.default_rng(1).normal(size=x.shape), np.tile(kind, number)
    np.savez(folder / "bed.npz", position=x, velocity=v, kind=kind, tiles=tiles, height=height)
    atoms = "\n".join(f"{i} {k + 1} {scene.diameters[k]:g} {DENSITY:g} {p[0]:.12g} {p[1]:.12g} {p[2]:.12g}"
                      for i, (k, p) in enumerate(zip(kind, x), 1))
    speeds = "\n".join(f"{i} {u[0]:.9g} {u[1]:.9g} {u[2]:.9g} 0 0 0" for i, u in enumerate(v, 1))
    for code, types in (("LIGGGHTS", len(scene.diameters) + 1), ("LAMMPS", len(scene.diameters))):
        (folder / f"{code}.data").write_text(
            f"bed\n\n{len(x)} atoms\n{types} atom types\n\n0 {tiles[0] * scene.tile:.9g} xlo xhi\n0 "
            f"{tiles[1] * scene.tile:.9g} "
            f"ylo yhi\n{-max(scene.diameters):g} {height:g} zlo zhi\n\nAtoms\n\n{atoms}\n\nVelocities\n\n{speeds}\n")
    return len(x)


def law_of(code, scene):
    """Law of a peer; its floor has an atom type of its own or is there once for each class, to have the damping of a
    wall."""
    k, damping, friction = coefficients(scene)
    kt, n, model = TANGENTIAL_STIFFNESS * k, len(scene.diameters), "model hooke/stiffness tangential history"
    if code == "LIGGGHTS":
        tables = {"kn": 0 * damping + k, "kt": 0 * damping + kt, "gamman": damping, "gammat": TANGENTIAL_DAMPING * damping,
                  "coefficientFriction": friction}
        return [*(f"fix {name} all property/global {name} peratomtypepair {n + 1} " + " ".join(f"{a:.9g}"
                                                                                               for a in table.ravel())
                  for name, table in tables.items()),
                f"pair_style gran {model}", "pair_coeff * *",
                f"fix floor all wall/gran {model} primitive type {n + 1} zplane 0"]
    plain = [[f"gran/hooke/history {k:.9g} {kt:.9g} {c:.9g} {TANGENTIAL_DAMPING * c:.9g} {m:g} 1" for c, m in zip(*row)]
             for row in zip(damping, friction)]
    lines = [f"pair_style {plain[0][0]}", "pair_coeff * *"] if n == 1 else ["pair_style granular"] + [
        f"pair_coeff {i + 1} {j + 1} hooke {k:.9g} {damping[i, j]:.9g} damping mass_velocity tangential linear_history "
        f"{kt:.9g} "
        f"{TANGENTIAL_DAMPING:g} {friction[i, j]:g}" for i in range(n) for j in range(i, n)]
    return lines + [line for i in range(n) for line in (
        f"group class{i} type {i + 1}", f"fix floor{i} class{i} wall/{plain[i][n].replace('/', ' ', 1)} zplane 0 NULL")]


def peer_input(code, scene, skin, style, warm_up, steps):
    """The input script of a peer."""
    lammps, mode = code == "LAMMPS", " mode multi" if style == "multi" else ""
    return "\n".join([
        "units si", "atom_style " + ("sphere" if lammps else "granular"), "atom_modify map array", "boundary p p f",
                      "newton off",
        f"neighbor {skin * min(scene.diameters):g} {style}", "neigh_modify delay 0", "processors * 1 1",
        f"comm_modify{mode} vel yes" if lammps else "communicate single vel yes", f"read_data {code}.data",
                      *law_of(code, scene),
        f"timestep {scene.step:g}", f"fix weight all gravity {GRAVITY} vector 0 0 -1", "fix move all nve/sphere",
        "compute height all reduce ave z", "thermo_style custom step c_height", f"thermo {warm_up + steps}",
                      f"run {warm_up}",
        f"run {steps}\n"])


def launch(command, ranks, folder, log):
    """Run a command on so many ranks; returns what it printed, or ``None`` if it failed."""
    if ranks > 1:
        command = ["mpirun", "--oversubscribe", "--allow-run-as-root", "--bind-to", "none", "-n", str(ranks), *command]
    env = environment_outside_mpirun() | {"OMP_NUM_THREADS": "1"}
    env["PYTHONPATH"] = str(Path(fe_el.__file__).resolve().parents[1])
    run = subprocess.run(command, check=False, cwd=folder, env=env, capture_output=True, text=True)
    (folder / f"{log}.log").write_text(run.stdout + run.stderr)
    return None if run.returncode or "ERROR" in run.stdout else run.stdout


def run_peer(code, scene, ranks, warm_up, steps, folder, skin, style):
    """Speed and what else the log of a peer says; ``None`` if it refuses the input."""
    name = f"{code}_{skin:g}_{style}"
    (folder / f"{name}.in").write_text(peer_input(code, scene, skin, style, warm_up, steps))
    text = launch([PEERS[code][0], "-log", "none", "-in", f"{name}.in"], ranks, folder, name)
    if not text:
        return None
    seconds, atoms, pair, search, rebuilds, pairs, height = (float(re.findall("(?m)" + key + r"(\S+)",
                                                                              text)[-1]) for key in (
        "^Loop time of ", "^Loop time .* with ", "^Pair" + TIME_OF, "^Neigh" + TIME_OF, "^Neighbor list builds = ",
        "^Ave neighs/atom = ", f"^ *{warm_up + steps} +"))
    return {"speed": atoms * steps / seconds * 1e-6, "search": search / seconds, "forces": pair / seconds,
            "rebuilds": rebuilds,
            "pairs": pairs, "height": height}


def worker(scene, warm_up, steps):
    """Time fe_el on the bed in the present folder, in a process (or several) of its own; prints one JSON line."""
    logging.getLogger().setLevel(logging.WARNING)
    comm = MPI.COMM_WORLD
    beads, contacts = beads_and_contacts(scene, comm=comm, **np.load("bed.npz"))
    beads.advance(warm_up * scene.step, contacts)
    before, built, tick = dict(contacts.seconds), contacts.rebuilds, time.perf_counter()
    beads.advance(steps * scene.step, contacts)
    wall = comm.allreduce(time.perf_counter() - tick, op=MPI.MAX)
    number, part = beads.total_number, {k: comm.allreduce(contacts.seconds[k] - before[k]) / comm.size / wall
                                        for k in before}
    out = {"speed": number * contacts.steps_last / wall * 1e-6, "search": part["neighbours"], "forces": part["contacts"],
           "rebuilds": contacts.rebuilds - built, "pairs": comm.allreduce(len(contacts.lists.pairs.first)) / number,
           "height": comm.allreduce(beads.position[:, 2].sum()) / number}
    print(json.dumps(out) if comm.rank == 0 else "", flush=True)


def time_codes(name, peers, ranks, repeats, warm_up, steps, skins, folder, progress):
    """One row for each code, the fastest of its settings by the median of interleaved runs on the bed in the folder."""
    scene, runs, rows = SCENES[name], {}, {}
    settings = [("fe_el", 0.0, "own")] + [(code, skin, style) for code in peers for skin in skins for style in ("bin",
                                                                                                                "multi")
                                          if style == "bin" or code == "LAMMPS" and len(scene.diameters) > 1]
    me = [sys.executable, "-m", "mpi4py", str(Path(__file__).resolve()), "--worker", name, str(warm_up), str(steps)]
    for code, skin, style in tqdm(settings * repeats, desc=folder.name, unit="run", disable=not progress):
        if code == "fe_el":
            out = json.loads((launch(me, ranks, folder, code) or "null").strip().splitlines()[-1])
        else:
            out = run_peer(code, scene, ranks, warm_up, steps, folder, skin, style)
        runs.setdefault((code, skin, style), []).append(out)
    for (code, skin, style), outs in runs.items():
        if not all(outs):
            print(f"{code} (skin {skin:g}, {style}) stopped with an error: see {folder}/{code}*.log.", flush=True)
        elif code not in rows or np.median([o["speed"] for o in outs]) > rows[code]["speed"]:
            medians = {key: float(np.median([o[key] for o in outs])) for key in outs[0]}
            rows[code] = {"code": code, **medians, "skin": skin, "style": style}
    return list(rows.values())


def main(scene=tuple(SCENES), particles=(10000, 50000), ranks=1, repeats=3, steps=400, warm_up=200, settle_time=0.2,
         agitation=0.0, skins=(0.05, 0.2, 0.8), output="out/contacts_against_peers", progress=True):
    """Time every code on every bed and return the summary; not under mpirun, which the runs use themselves."""
    logging.getLogger().setLevel(logging.WARNING)
    start, rows, numbers, peers = time.perf_counter(), [], {}, [code for code in PEERS if shutil.which(PEERS[code][0])]
    for code in set(PEERS) - set(peers):
        print(f"{code} is not installed; on Debian: apt-get install {PEERS[code][1]}.", flush=True)
    for name in scene:
        tile = settled_tile(SCENES[name], settle_time, progress)
        for wanted in particles:
            folder = Path(output).resolve() / f"{name}_{wanted}"
            folder.mkdir(parents=True, exist_ok=True)
            number = write_bed(folder, SCENES[name], wanted, tile, agitation)
            new = time_codes(name, peers, ranks, repeats, warm_up, steps, skins, folder, progress)
            own = next((r["speed"] for r in new if r["code"] == "fe_el"), float("nan"))
            for r in new:
                rows.append({"scene": name, "particles": number, "ranks": ranks, **r, "fe_el_over_it": own / r["speed"]})
                bed = f"{name}_{number}_{r['code'].lower()}"
                numbers |= {f"million_particle_steps_per_second_{bed}": r["speed"], f"fe_el_over_it_{bed}": own / r["speed"],
                            f"share_of_neighbour_search_{bed}": r["search"]}
    table(output, rows)
    return fe_el.write_summary(output, MPI.COMM_SELF, ranks_of_runs=ranks, wall_time=time.perf_counter() - start, **numbers)


def table(output, rows):
    """CSV, the same as a table on the screen, and a picture with a bar for each code."""
    from matplotlib import pyplot as plt
    with open(Path(output) / "contacts_against_peers.csv", "w", newline="") as file:
        csv.writer(file).writerows([rows[0].keys(), *(r.values() for r in rows)])
    print("scene      beads ranks code      million/s  fe_el/it  search  forces rebuilds pairs/bead  mean height [m] skin, "
          "style")
    line = ("{scene:<8} {particles:7d} {ranks:5d} {code:<9} {speed:9.2f} {fe_el_over_it:9.2f} {search:7.1%} {forces:7.1%} "
            "{rebuilds:8.0f} {pairs:10.2f} {height:15.8f} {skin:g} {style}")
    print(*(line.format(**r) for r in rows), sep="\n")
    beds = list(dict.fromkeys((r["scene"], r["particles"]) for r in rows))
    figure, axis = plt.subplots(figsize=(2 + 1.3 * len(beds), 4), layout="constrained")
    for k, code in enumerate(dict.fromkeys(r["code"] for r in rows)):
        bars = [(beds.index((r["scene"], r["particles"])) + 0.27 * k, r["speed"]) for r in rows if r["code"] == code]
        axis.bar(*zip(*bars), 0.25, label=code)
    axis.set_xticks(0.27 + np.arange(len(beds)), ["\n".join(map(str, bed)) for bed in beds])
    axis.legend(title="million particle-steps per second", loc="lower left")
    figure.savefig(Path(output) / "contacts_against_peers.png", dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--worker"]:
        worker(SCENES[sys.argv[2]], *map(int, sys.argv[3:]))
    else:
        main(**vars(arguments().parse_args()))
