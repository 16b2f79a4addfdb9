"""Spheres that fall with ``UndisturbedVelocity``, two-way, at many places in their cells, beside what their drag law says.

A sphere is let go in a periodic box whose mean pressure gradient carries the weight. Its images make it slower or faster:
in steady creeping flow by Hasimoto's sum of point forces (1959), else by the same sum for forces that move and have acted
since the start (Oseen's linear flow), which is that over the waves that fit into the box less that over all. Errors are
those of the speed, less what the images make, over the terminal one; without the correction a sphere of a cell at Re 0.08
falls 160 % too fast. ``undisturbed_velocity.csv`` has every fall, the summary the mean and the worst of each case.
"""
import argparse
import csv
import logging
import math
import time
from functools import lru_cache
from pathlib import Path

import numpy as np
from mpi4py import MPI
from tqdm import tqdm

import fe_el

RHO, RHO_P, H, G = 1000.0, 2500.0, 1e-3, 9.81
TRAVEL = 9.0  # cells


def arguments():
    """Command line of the demo."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    p.add_argument("--reynolds", type=float, nargs="+", default=[0.08, 1.0, 20.0, 146.0], help="of the terminal velocity")
    p.add_argument("--ratios", type=float, nargs="+", default=[0.1, 0.5, 1.0, 3.0], help="diameter over the size of a cell")
    p.add_argument("--places", type=int, default=20, help="of the sphere in its cell, at random")
    p.add_argument("--output", default="out/undisturbed_velocity", help="folder for results")
    return p


@lru_cache(maxsize=1)
def _box(cells):
    """The last box of cubes of H."""
    return fe_el.periodic_box(np.array(cells) * H, cells)[0]


def _drag(reynolds):
    """Drag over that of Stokes."""
    return float(fe_el.drag_laws.schiller_naumann(np.zeros(1), np.array([reynolds]))[0])


def fall(ratio, reynolds, seed, cells=(8, 8, 8), travel=0.0, step=0.5, start=0.0, places=None):
    """Mean speed of spheres of ``ratio`` cells, one or at ``places`` in a unit box, relative to the mixture's and over the
    terminal one, two-way in a periodic box; mean of the last quarter."""
    places = np.random.default_rng(seed).uniform(0.3, 0.7, (1, 3)) if places is None else places
    d, length, down = ratio * H, np.array(cells) * H, np.array([0, 0, -G])
    mu = np.sqrt((RHO_P - RHO) * G * d ** 3 * RHO / (18 * reynolds * _drag(reynolds)))
    terminal, solid = reynolds * mu / (RHO * d), len(places) * np.pi / 6 * d ** 3 / length.prod()
    balance = -(solid * RHO_P + (1 - solid) * RHO) * down
    dt = min(step * H * H * RHO / mu, (0.02 if not travel else 0.1) * H / terminal)
    mesh = _box(tuple(cells))
    water = fe_el.VolumeAveragedNavierStokes(mesh, None, RHO, mu, down, 1e-9, mean_pressure_gradient=balance)
    beads = fe_el.Particles(mesh, RHO_P, down)
    beads.insert_at(places * length, d, velocity=(0.0, 0.0, -start * terminal))
    forces = [fe_el.Drag("schiller_naumann"), fe_el.PressureGradient(balance), fe_el.UndisturbedVelocity()]
    coupling, speed = fe_el.Coupling(beads, water.velocity, water.pressure, RHO, mu, forces), []
    for _ in range(int(travel * H / terminal / dt) or max(60, int(4 * H * H * RHO / mu / dt))):
        coupling.to_fluid(dt)
        water.advance(dt, coupling.fields)
        coupling.to_particles(dt)
        beads.advance(dt)
        if not coupling.momentum_imbalance < 1e-12:
            raise RuntimeError(f"Momentum is not kept: imbalance {coupling.momentum_imbalance:g}.")
        speed.append((water.momentum()[2] / (RHO * length.prod()) - beads.velocity[:, 2].mean()) / terminal)
    return float(np.mean(speed[-len(speed) // 4:]))


def images(length, diffusivity, seconds, width=0.07):
    """What the images do in a periodic cube of ``length`` diameters: velocity that a point force of one has made at its own
    place, by its images alone, times density [1/(diameter velocity)], once it has moved for ``seconds`` at velocity one.

    Lengths are in diameters, velocities in the sphere's: ``diffusivity`` is 1/Re. Both sums are of a force spread over
    ``width`` of the box, so little that the images do not see it.
    """
    def answer(k, along):
        rate = diffusivity * k * k - 1j * k * along
        return ((1 - along * along) * (1 - np.exp(-rate * seconds)) / rate).real * np.exp(-0.5 * (k * width * length) ** 2)
    number = np.arange(-12, 13) * 2 * math.pi / length
    wave = np.stack(np.meshgrid(number, number, number, indexing="ij"), -1).reshape(-1, 3)
    k = np.linalg.norm(wave, axis=1)
    box = answer(k[k > 0], wave[k > 0, 2] / k[k > 0]).sum() / length ** 3
    (x, weight), (along, share) = np.polynomial.legendre.leggauss(400), np.polynomial.legendre.leggauss(200)
    most = 7 / (width * length)
    k = 0.5 * most * (x[:, None] + 1)
    return box - 0.5 * most * float(weight @ (k * k * answer(k, along)) @ share) / (4 * math.pi ** 2)


def expected(ratio, reynolds, cells):
    """Speed over the terminal one in a cubic box of so many cells, in the last quarter of a fall."""
    length = cells / ratio
    if reynolds < 0.5:
        return 1 - 2.837 / (2 * length) + math.pi / 6 / length ** 3
    force = 3 * math.pi * _drag(reynolds) / reynolds  # over density, velocity and diameter squared
    return 1 + force * np.mean([images(length, 1 / reynolds, part * TRAVEL / ratio) for part in (0.78, 0.875, 0.97)])


def case(ratio, reynolds, places):
    """Errors (places,) of the speed over the terminal one."""
    creeping, large = reynolds < 0.5, ratio > 1.0
    cells = 18 if large else 8 if creeping else 12
    how = {"step": 2.0 if large else 0.5} if creeping else {"travel": TRAVEL, "start": 1.0}
    exact = expected(ratio, reynolds, cells)
    return np.array([fall(ratio, reynolds, seed, (cells,) * 3, **how) for seed in range(places)]) - exact


def main(reynolds=(0.08, 1.0, 20.0, 146.0), ratios=(0.1, 0.5, 1.0, 3.0), places=20, output="out/undisturbed_velocity",
         progress=True):
    """Let all fall and return the summary; on one rank."""
    logging.getLogger().setLevel(logging.WARNING)
    start, rows, numbers = time.perf_counter(), [], {}
    for ratio, number in tqdm([(a, b) for a in ratios for b in reynolds], disable=not progress):
        errors = case(ratio, number, places)
        rows += [(number, ratio, seed, error) for seed, error in enumerate(errors)]
        key, worst = f"re_{number:g}_ratio_{ratio:g}".replace(".", "_"), errors[np.abs(errors).argmax()]
        numbers |= {f"mean_{key}": float(errors.mean()), f"worst_{key}": float(worst)}
        print(f"Re {number:7g}, d/h {ratio:4g}: mean {100 * errors.mean():+6.1f} %, from {100 * errors.min():+6.1f} to "
              f"{100 * errors.max():+6.1f} %", flush=True)
    Path(output).mkdir(parents=True, exist_ok=True)
    with open(Path(output) / "undisturbed_velocity.csv", "w", newline="") as file:
        csv.writer(file).writerows([("reynolds", "ratio", "place", "error"), *rows])
    return fe_el.write_summary(output, MPI.COMM_SELF, places=places, wall_time=time.perf_counter() - start, **numbers)


if __name__ == "__main__":
    for key, value in main(**vars(arguments().parse_args())).items():
        print(f"{key:40s} {value}")
