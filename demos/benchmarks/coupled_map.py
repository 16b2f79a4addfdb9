"""Fluid and particles together, far outside the ordinary range: energy and ledger, one quantity varied at a time.

A periodic box without gravity: a vortex in the fluid, particles that move through it at random with drag, the pressure
gradient and, where they are light, added mass; from a solid fraction of 0.2 on with contacts. Nothing drives the flow, so
the kinetic energy of both may never exceed that of the start; total momentum, solid volume and the number of particles stay.
Two scenes with walls are driven: gas that sets in at 100 m/s under a packed column, and a packed column that is let go.
"""
import argparse
import csv
import logging
import time
import warnings
from pathlib import Path

import numpy as np
from mpi4py import MPI
from tqdm import tqdm

import fe_el

BASE = {"diameter": 1e-3, "density_ratio": 2.5, "solid": 0.1, "dt_star": 1.0, "reynolds": 10.0, "size": 0.3,
        "places": "random"}
AXES = {  # what is varied, and its values
    "diameter": (1e-6, 1e-4, 1e-2), "density_ratio": (1e-3, 0.1, 0.5, 1.0, 10.0, 1e3, 1e4),
    "solid": (1e-6, 1e-3, 0.25, 0.45), "dt_star": (1e-2, 0.1, 10.0, 1e2, 1e3, 1e4), "reynolds": (1e-6, 1e-2, 1e3, 1e5),
    "size": (1e-3, 0.03, 1.0, 3.0), "places": ("none", "one", "one cell", "facets", "edges", "vertices", "half"),
    "no_contacts": (0.2, 0.3, 0.5), "added_mass": (0.25, 0.45)}
FLUID_DENSITY, SPEED, CUBES, MOST = 1.2, 1.0, 5, 1500


def arguments():
    """Command line of the demo."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    p.add_argument("--axes", nargs="+", choices=[*AXES, "walls"], default=[*AXES, "walls"], help="what is varied")
    p.add_argument("--steps", type=int, default=40, help="of every case")
    p.add_argument("--output", default="out/coupled_map", help="folder for results")
    return p


def positions(places, count, cells, lengths, rng):
    """Where particles are put (n, 3)."""
    corner = cells.corner[:cells.owned]
    if places in ("facets", "edges", "vertices"):
        few = {"facets": 3, "edges": 2, "vertices": 1}[places]
        return corner[rng.integers(0, len(corner), count), :few].mean(1)
    if places == "lattice":  # a cubic one that fills the box
        side = round(count ** (1 / 3))
        return (np.stack(np.meshgrid(*[np.arange(side)] * 3), -1).reshape(-1, 3) + 0.5) * lengths / side
    if places == "one cell":
        weights = rng.dirichlet(np.ones(4), count)
        return weights @ corner[len(corner) // 2]
    return rng.uniform(0, 1, (count, 3)) * lengths * ((1, 1, 0.5) if places == "half" else 1)


class Box:
    """A periodic box for the values of one case."""

    def __init__(self, diameter, density_ratio, solid, dt_star, reynolds, size, places, no_contacts=None,
                 added_mass=None):
        solid = no_contacts or added_mass or solid
        dense = no_contacts is None and solid >= 0.2
        places = "lattice" if dense else places
        edge, cubes = diameter / size, max(CUBES, int(np.ceil(2.5 * size)))
        lengths, rng = np.full(3, cubes * edge), np.random.default_rng(1)
        mesh, _ = fe_el.periodic_box(lengths, (cubes,) * 3)
        viscosity = FLUID_DENSITY * SPEED * diameter / reynolds
        self.fluid = fe_el.VolumeAveragedNavierStokes(mesh, None, FLUID_DENSITY, viscosity, tolerance=1e-10)
        wave = 2 * np.pi / lengths[0]
        self.fluid.set_initial_velocity(lambda time, x: SPEED * np.column_stack(
            [np.sin(wave * x[:, 0]) * np.cos(wave * x[:, 1]), -np.cos(wave * x[:, 0]) * np.sin(wave * x[:, 1]),
             0 * x[:, 2]]))
        density = density_ratio * FLUID_DENSITY
        self.beads = fe_el.Particles(mesh, density)
        whole = solid * lengths.prod() * (0.5 if places == "half" else 1) / (np.pi / 6 * diameter ** 3)
        if places == "one cell":
            whole = 0.5 * edge ** 3 / 6 / (np.pi / 6 * diameter ** 3)
        count = {"none": 0, "one": 1, "lattice": int(whole ** (1 / 3) + 1e-9) ** 3}.get(places, int(np.clip(whole, 1, MOST)))
        if count:
            parcel = (whole / count) ** (1 / 3) if whole > MOST and not dense else 1.0
            x = positions(places, count, self.beads.cells, lengths, rng)
            self.beads.insert_at(x, parcel * diameter, velocity=SPEED * rng.normal(size=(count, 3)), coarse_graining=parcel)
        forces = [fe_el.Drag("beetstra"), fe_el.PressureGradient(), *([fe_el.AddedMass()] if added_mass else [])]
        self.coupling = fe_el.Coupling.of(self.fluid, self.beads, forces)
        self.dt, self.contacts = dt_star * density * diameter ** 2 / (18 * viscosity), None
        self.count = self.beads.total_number
        if dense:
            stiffness = 100 * density * diameter * SPEED ** 2  # overlaps of some hundredths of a diameter
            self.contacts = fe_el.Contacts(self.beads, fe_el.LinearSpringDashpot(stiffness, 0.9, 0.1), steps_per_contact=20)
        self.coupling.to_fluid(self.dt)

    def advance(self):
        """One step."""
        self.coupling.to_fluid(self.dt)
        self.fluid.advance(self.dt, self.coupling.fields)
        self.coupling.to_particles(self.dt)
        self.beads.advance(self.dt, self.contacts)

    def void(self):
        """Void fraction of the cells, that of the fluid's last step."""
        last = self.fluid.void_fraction
        return self.coupling.fields[0].x.array[:self.fluid.num_cells] if last is None else last

    def energy(self):
        """Kinetic energy of fluid and particles [J]."""
        q = self.fluid.velocity.x.array.reshape(-1, 3)[:self.fluid.num_cells]
        of_fluid = 0.5 * FLUID_DENSITY * float((self.void() * self.fluid.volume) @ (q ** 2).sum(1))
        return self.fluid.comm.allreduce(of_fluid) + self.beads.kinetic_energy()

    def imbalance(self):
        """Errors of the ledger: momentum handed over, solid volume."""
        return self.coupling.momentum_imbalance, self.coupling.solid_volume_error


class Column(Box):
    """A packed column in a duct: ``gas`` that sets in at once, or let go in gas at rest."""

    def __init__(self, gas):
        h, d = 3e-3, 1e-3
        lengths = np.array([4 * h, 4 * h, 16 * h])
        mesh, tags = fe_el.box(lengths, (4, 4, 16))
        down = (0.0, 0.0, -9.81)
        self.fluid = fe_el.VolumeAveragedNavierStokes(mesh, tags, FLUID_DENSITY, 1.8e-5, down, 1e-10)
        self.fluid.set_no_slip((1, 2, 3, 4))
        self.fluid.set_velocity(5, (0.0, 0.0, gas))
        self.fluid.set_pressure(6, 0.0)
        self.beads = fe_el.Particles(mesh, 2500.0, down)
        lift = 0.0 if gas else 8 * h
        self.beads.insert_on_lattice((0, 0, lift), (lengths[0], lengths[1], lengths[2]), np.full(1000, d), seed=1)
        law = fe_el.LinearSpringDashpot(2000.0, restitution=0.8, friction=0.2)
        self.contacts = fe_el.Contacts(self.beads, law, walls=(tags, (1, 2, 3, 4, 5, 6)), steps_per_contact=20)
        self.coupling = fe_el.Coupling.of(self.fluid, self.beads, [fe_el.Drag("beetstra"), fe_el.PressureGradient()])
        self.dt, self.count = 2e-4, self.beads.total_number


def run(axis, value, steps):
    """One row of the map."""
    tick, reason, driven = time.perf_counter(), "", axis == "walls"
    worst, energy, lost = np.zeros(2), [], 0
    with warnings.catch_warnings(record=True) as messages:
        warnings.simplefilter("always", RuntimeWarning)
        try:
            scene = Column(100.0 if value == "sudden inlet" else 0.0) if driven else Box(**{**BASE, axis: value})
            energy.append(scene.energy())
            for _ in range(steps):
                scene.advance()
                energy.append(scene.energy())
                worst = np.maximum(worst, scene.imbalance())
        except (ValueError, ArithmeticError, RuntimeError) as error:
            reason = f"{type(error).__name__}: {str(error)[:90]}"
    if energy:  # in cases that stop, too: nothing may be lost before the sentence
        lost = scene.count - scene.beads.total_number + int((~np.isfinite(scene.beads.position).all(1)).sum())
    e = np.array(energy) / (energy[0] if energy and energy[0] > 0 else 1.0)
    light = axis == "density_ratio" and value < 1.4  # what is accelerated with them has energy, too
    stable = not reason and bool(np.isfinite(e).all()) and (driven or e.max() < (2.0 if light else 1 + 1e-6))
    said = next((str(m.message)[:90] for m in messages if issubclass(m.category, RuntimeWarning)), "")
    return {"axis": axis, "value": value, "steps": max(len(e) - 1, 0), "max_energy": float(e.max(initial=0.0)),
            "end_energy": float(e[-1]) if len(e) else 0.0, "momentum_imbalance": worst[0], "solid_volume_error": worst[1],
            "lost": lost, "stable": stable, "ledger": bool(worst.max() < 1e-9), "warning": said, "reason": reason,
            "seconds": time.perf_counter() - tick}


def main(axes=(*AXES, "walls"), steps=40, output="out/coupled_map", progress=True):
    """Run all cases and return the summary."""
    logging.getLogger().setLevel(logging.ERROR)
    if MPI.COMM_WORLD.size > 1:
        raise ValueError(f"The map runs on one rank, not {MPI.COMM_WORLD.size}.")
    values = {**AXES, "walls": ("sudden inlet", "sudden release")}
    cases, begin = [(axis, value) for axis in axes for value in values[axis]], time.perf_counter()
    rows = [run(*case, steps) for case in tqdm(cases, disable=not progress or MPI.COMM_WORLD.rank > 0, unit="case")]
    if MPI.COMM_WORLD.rank == 0:
        Path(output).mkdir(parents=True, exist_ok=True)
        with open(Path(output) / "coupled_map.csv", "w", newline="") as file:
            writer = csv.DictWriter(file, rows[0].keys())
            writer.writeheader()
            writer.writerows(rows)
        for r in rows:
            print(f"{r['axis']:<14} {r['value']!s:>14} {r['steps']:4d} steps, largest energy {r['max_energy']:.8g}, end "
                  f"{r['end_energy']:.3g}, momentum {r['momentum_imbalance']:.1e}, "
                  f"solid {r['solid_volume_error']:.1e}, "
                  f"{'stable' if r['stable'] else 'stopped' if r['reason'] else 'NOT STABLE'} {r['seconds']:.1f} s "
                  f"{r['reason'] or r['warning']}")
    return fe_el.write_summary(output, cases=len(rows), stable=sum(r["stable"] for r in rows),
                               lost=sum(r["lost"] for r in rows), ledger_exact=sum(r["ledger"] for r in rows),
                               wall_time=time.perf_counter() - begin,
                               warned=sum(bool(r["warning"]) for r in rows), stopped=sum(bool(r["reason"]) for r in rows))


if __name__ == "__main__":
    summary = main(**vars(arguments().parse_args()))
    if MPI.COMM_WORLD.rank == 0:
        for key, value in summary.items():
            print(f"{key:32s} {value}")
