"""Pipes and cones of flat sides beside the law of one contact: restitution, stiffness, and energy that no impact may gain.

Beads without friction fly onto the wall at places from a side's middle to its edge: straight, and with a velocity along the
wall or around it. The sides touch the smooth pipe or cone from outside. One impact lasts from the first touch until the bead
parts from the wall; its restitution is -v.n after over v.n before, where n is the direction of the impulse that the wall
gave. Without friction and on one plane that is the law's, and in general 1 - e^2 is the energy lost over that of v.n before.
Oblique impacts turn the normal on a smooth wall too: their reference is one contact with the smooth wall.
    python demos/benchmarks/curved_walls.py
"""
import argparse
import csv
import logging
from pathlib import Path

import numpy as np
from mpi4py import MPI

import fe_el

D, DENSITY, STIFFNESS = 0.01, 2500.0, 1e4
MASS = DENSITY * np.pi / 6 * D ** 3
OBLIQUE = {"straight": (0.0, 0.0), "45 along": (45.0, 0.0), "20 around": (0.0, 20.0)}  # degrees along the axis, around it
GAP = 0.02 * D, 0.03 * D  # between which distances from the smooth wall beads start [m]
SHARES = (0.001, 0.005, 0.02)  # overlaps over the diameter at which the stiffness is taken


def arguments():
    """Command line of the benchmark."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--sides", type=int, nargs="+", default=(16, 32, 64, 128, 256), help="flat sides (16 32 64 128 256)")
    p.add_argument("--ratios", type=float, nargs="+", default=(1.3, 2, 4, 10),
                   help="diameter of the wall where it is hit over that of the bead (1.3 2 4 10)")
    p.add_argument("--apex", type=float, nargs="+", default=(0, 20, 40, 60), help="angle of the cone, 0: pipe (0 20 40 60)")
    p.add_argument("--restitution", type=float, nargs="+", default=(0.05, 0.3, 0.5, 0.9, 1), help="(0.05 0.3 0.5 0.9 1)")
    p.add_argument("--points", type=int, default=9, help="places from the middle of a side to its edge (9)")
    p.add_argument("--steps-per-contact", type=int, default=50, help="sub-steps of a contact (50)")
    p.add_argument("--speed", type=float, default=0.5, help="towards the wall; 0.5 m/s: overlaps of 1.8 %% of the diameter")
    p.add_argument("--output", default="out/curved_walls", help="folder for results (out/curved_walls)")
    return p


class Cups:
    """Pieces of wall in a row, one for each bead.

    Attributes:
        contacts, particles: of the scene.
        around (beads,): angle of the bead about the axis of its cup, and ``side``, those of the sides.
    """

    def __init__(self, sides, ratio, apex, points, law, steps):
        self.radius, self.half = ratio * D / 2, np.radians(apex) / 2
        places = np.tile(np.linspace(0, 1, points), len(OBLIQUE))
        count = len(places)
        self.side = 2 * np.pi * np.arange(sides) / sides
        self.around = self.side[np.arange(count) * 3 % sides] + places * np.pi / sides
        pitch = 2 * self.radius / np.cos(np.pi / sides) + 6 * D
        self.origin = pitch * np.column_stack([np.arange(count) + 0.5, np.full(count, 0.5), np.full(count, 0.5)])
        mesh, _ = fe_el.box((count * pitch, pitch, pitch), (count, 1, 1))
        self.particles = fe_el.Particles(mesh, DENSITY)
        wall = fe_el.SurfaceWall(self._surface(sides), may_be_open=True)
        self.particles.insert_at(self.origin, D)
        self.contacts = fe_el.Contacts(self.particles, law, [wall], steps_per_contact=steps)

    def _surface(self, sides):
        """Points and triangles of all cups, from the tip (a pipe: two diameters below) to two diameters above the bead."""
        below = self.radius / np.tan(self.half) if self.half else 2 * D
        edge = self.side + np.pi / sides
        ring = np.column_stack([np.cos(edge), np.sin(edge), 0 * edge]) / np.cos(np.pi / sides)
        low, high = ((self.radius + z * np.tan(self.half)) * ring + (0, 0, z) for z in (-below, 2 * D))
        i = np.arange(sides)
        j = np.roll(i, -1)
        one = np.concatenate([np.column_stack([i, j, sides + j]), np.column_stack([i, sides + j, sides + i])])
        points = (self.origin[:, None] + np.concatenate([low, high])).reshape(-1, 3)
        return points, (2 * sides * np.arange(len(self.origin))[:, None, None] + one).reshape(-1, 3)

    def directions(self):
        """Normal of the smooth wall where each bead is, along the wall and around it: (beads, 3) each."""
        return directions(self.around, self.half)

    def put(self, overlap, velocity):
        """Beads where they overlap with the smooth wall by ``overlap`` (beads,) [m], with a velocity."""
        normal, p = self.directions()[0], self.particles
        foot = self.radius * np.column_stack([np.cos(self.around), np.sin(self.around), 0 * self.around])
        p.position[:] = (self.origin + foot + (D / 2 - overlap)[:, None] * normal)[p.id]
        p.velocity[:] = velocity[p.id]

    def overlaps(self):
        """Of the bead with the deepest plane of its cup, in the order of the ids (beads,) [m]."""
        x = self.particles.position[np.argsort(self.particles.id)] - self.origin
        out = (x[:, :2] @ np.stack([np.cos(self.side), np.sin(self.side)])).max(1)
        return D / 2 - (self.radius + x[:, 2] * np.tan(self.half) - out) * np.cos(self.half)


def directions(around, half):
    """Inward normal of a cone of the half angle, the direction along its wall and that around it (n, 3)."""
    c, s, o = np.cos(around), np.sin(around), 0 * around
    return (np.column_stack([-np.cos(half) * c, -np.cos(half) * s, o + np.sin(half)]),
            np.column_stack([np.sin(half) * c, np.sin(half) * s, o + np.cos(half)]), np.column_stack([-s, c, o]))


def velocities(speed, normal, along, around):
    """With one component towards the wall, (n, 3); an equal number of beads for each of ``OBLIQUE``."""
    each = np.repeat(np.tan(np.radians(list(OBLIQUE.values()))), len(normal) // len(OBLIQUE), 0)
    return speed * (-normal + each[:, :1] * along + each[:, 1:] * around)


def along_the_impulse(before, after):
    """Restitution of velocities (n, 3)."""
    impulse = after - before
    return -(after * impulse).sum(1) / (before * impulse).sum(1)


def stiffness_error(sides, ratio, apex, points):
    """Largest error of the force over stiffness times overlap, where that is more than 1e-4 of the diameter."""
    cups, worst = Cups(sides, ratio, apex, points, fe_el.LinearSpringDashpot(STIFFNESS, 1.0, 0.0), 50), 0.0
    for share in SHARES:
        cups.put(np.full(len(cups.around), share * D), np.zeros((len(cups.around), 3)))
        overlap, p = cups.overlaps(), cups.particles
        p.advance(1e-12, cups.contacts)
        force = np.linalg.norm(p.contact_force, axis=1)[np.argsort(p.id)]
        deep = overlap > 1e-4 * D
        worst = max(worst, np.abs(force[deep] / (STIFFNESS * overlap[deep]) - 1).max(initial=0.0))
    return worst


def impacts(sides, ratio, apex, restitution, points, steps, speed):
    """Restitution of each impact (obliquities, points), and the largest gain of energy over that before, at any time."""
    law = fe_el.LinearSpringDashpot(STIFFNESS, restitution, 0.0)
    cups = Cups(sides, ratio, apex, points, law, steps)
    p, before = cups.particles, velocities(speed, *cups.directions())
    start = np.random.default_rng(0).uniform(*GAP, len(before))  # beads touch at any moment of a sub-step
    cups.put(-start, before)
    energy, after, gain = (before ** 2).sum(1), np.full_like(before, np.nan), 0.0
    touched, time = np.zeros(len(before), bool), law.contact_time(MASS)
    for _ in range(3000):
        p.advance(2 * time / steps, cups.contacts)
        order = np.argsort(p.id)
        v, touches = p.velocity[order], (p.contact_force[order] != 0).any(1)
        gain = max(gain, ((v ** 2).sum(1) / energy).max() - 1)
        parted = touched & ~touches & np.isnan(after[:, 0])
        after[parted] = v[parted]
        touched |= touches
        if not np.isnan(after).any():
            break
    return along_the_impulse(before, after).reshape(len(OBLIQUE), points), gain


def smooth(ratio, apex, restitution, speed, steps=2000):
    """Restitution of one contact with the smooth wall for each obliquity, from the mean start of the beads; NaN where the
    bead does not part in some times the duration of a straight one."""
    law, half = fe_el.LinearSpringDashpot(STIFFNESS, restitution, 0.0), np.radians(apex) / 2
    v = velocities(speed, *directions(np.zeros(len(OBLIQUE)), half))
    x = np.tile([ratio * D / 2, 0.0, 0.0], (len(v), 1)) + (D / 2 + np.mean(GAP)) * directions(0 * v[:, 0], half)[0]
    eta, h = law.damping[0, 0] * np.sqrt(STIFFNESS * MASS), law.contact_time(MASS) / steps
    before, after, touched = v.copy(), np.full_like(v, np.nan), np.zeros(len(v), bool)
    for _ in range(8 * steps):
        middle, mid = v, x + h / 2 * v
        for _ in range(3):  # the rule of the middle, by iterations
            pull, overlap = _pull(mid, middle, ratio, half, eta)
            middle = v + h / 2 * pull
            mid = x + h / 2 * middle
        x, v = x + h * middle, v + h * pull
        parted = touched & (overlap <= 0) & np.isnan(after[:, 0])
        after[parted] = v[parted]
        touched |= overlap > 0
        if not np.isnan(after).any():
            break
    return along_the_impulse(before, after)


def _pull(x, v, ratio, half, eta):
    """Acceleration by the law (n, 3), and overlap with the smooth wall (n,)."""
    normal = directions(np.arctan2(x[:, 1], x[:, 0]), half)[0]
    overlap = D / 2 - (ratio * D / 2 + x[:, 2] * np.tan(half) - np.hypot(x[:, 0], x[:, 1])) * np.cos(half)
    force = (overlap > 0) * (STIFFNESS * overlap - eta * (v * normal).sum(1))
    return force[:, None] / MASS * normal, overlap


def main(sides=(16, 32, 64, 128, 256), ratios=(1.3, 2, 4, 10), apex=(0, 20, 40, 60), restitution=(0.05, 0.3, 0.5, 0.9, 1),
         points=9, steps_per_contact=50, speed=0.5, output="out/curved_walls", progress=True):
    """Run all impacts and return the worst of each kind."""
    logging.getLogger().setLevel(logging.WARNING)
    if MPI.COMM_WORLD.size > 1:
        raise ValueError(f"There are {MPI.COMM_WORLD.size} ranks; run this benchmark on one, without mpirun.")
    rows, weight = [], np.ones(points)
    weight[[0, -1]] = 0.5  # of the mean over a side
    for angle in apex:
        for ratio in ratios:
            stiffness = {n: stiffness_error(n, ratio, angle, points) for n in sides}
            for e in restitution:
                expected = smooth(ratio, angle, e, speed)
                for n in sides:
                    measured, gain = impacts(n, ratio, angle, e, points, steps_per_contact, speed)
                    for name, one, law in zip(OBLIQUE, measured, expected):
                        mean = np.average(one, weights=weight)
                        rows.append({"apex": angle, "ratio": ratio, "sides": n, "restitution": e, "impact": name,
                                     "smooth_wall": law, "mean": mean, "error_of_mean": mean - law,
                                     "worst_single_error": np.abs(one - law).max(), "gain": gain,
                                     "stiffness_error": stiffness[n]})
            if progress:
                print(f"angle {angle:g}, ratio {ratio:g}: {worst_of(rows[-len(sides) * len(restitution) * len(OBLIQUE):])}",
                      flush=True)
    Path(output).mkdir(parents=True, exist_ok=True)
    with open(Path(output) / "curved_walls.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)
    return fe_el.write_summary(output, MPI.COMM_WORLD, impacts=len(rows) * points, **worst_of(rows))


def worst_of(rows):
    """Largest errors of restitution for each obliquity, of stiffness, and gain of energy, of some rows."""
    out = {}
    for name in OBLIQUE:
        for key in ("error_of_mean", "worst_single_error"):
            out[f"{name} {key}"] = max(abs(r[key]) for r in rows if r["impact"] == name)
    return out | {key: max(r[key] for r in rows) for key in ("stiffness_error", "gain")}


if __name__ == "__main__":
    for key, value in main(**vars(arguments().parse_args())).items():
        print(f"{key:32s} {value}")
