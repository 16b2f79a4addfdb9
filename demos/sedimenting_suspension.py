"""A sedimenting suspension in a fully periodic box: the paper's critical test of coupling schemes (Radl et al., section
4.2)."""
import argparse
import logging
import sys
import time
from pathlib import Path

import matplotlib
import numpy as np

import fe_el

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from demos import reports, restarts

matplotlib.use("Agg")
GRAVITY, GAS_DENSITY, GAS_VISCOSITY = 9.81, 1.3, 1.8e-5
REPORTS = {"slip": reports.Report(
    settings=({"coupling": "conservative", "dt_star": 0.1, "mapping": "overlap_volume", "coarse_graining": 1.0, "seed": 1},
              {"coupling": "conservative", "dt_star": 0.1, "mapping": "overlap_volume", "coarse_graining": 1.0, "seed": 2},
              *({"coupling": scheme, "dt_star": step, "mapping": mapping, "coarse_graining": ratio, "seed": 1}
                for scheme, step, mapping, ratio in (
                    ("explicit", 0.1, "overlap_volume", 1.0), ("split", 1.0, "overlap_volume", 1.0),
                    ("conservative", 1.0, "overlap_volume", 1.0), ("conservative", 4.0, "overlap_volume", 1.0),
                    ("conservative", 1.0, "hat", 1.0), ("conservative", 1.0, "overlap_volume", 2.0)))),
    quantities={"slip_velocity": None}, same={"box": (32.0,) * 3, "cells": (4,) * 3, "end_time": 0.06},
    first={"end_time": 1e-3}, within=0.05)}


def arguments():
    """Command line of the demo."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    p.add_argument("--diameter", type=float, default=150e-6, help="particle diameter [m]")
    p.add_argument("--particle-density", type=float, default=1500.0, help="[kg/m^3]")
    p.add_argument("--solid-fraction", type=float, default=0.1, help="mean solid fraction")
    p.add_argument("--box", type=float, nargs=3, default=(48.0, 48.0, 96.0), help="box in particle diameters")
    p.add_argument("--cells", type=int, nargs=3, default=(6, 6, 12), help="cubes per direction, six tetrahedra each")
    p.add_argument("--coupling", default="conservative", help="scheme: " + ", ".join(sorted(fe_el.schemes.SCHEMES)))
    p.add_argument("--dt-star", type=float, default=1.0, help="time step in fluid relaxation times of eq. 10 (Stokes)")
    p.add_argument("--smoothing-length", type=float, help="in particle diameters; absent: no smoothing")
    p.add_argument("--drag", default="beetstra", help="name of the drag law")
    p.add_argument("--mapping", default="overlap_volume", help="name of the mapping: " +
                   ", ".join(sorted(fe_el.mapping.MAPPINGS)))
    p.add_argument("--fluid-velocity", default="cell", help="at the particle: cell or linear")
    p.add_argument("--fluid-steps", type=int,
                   help="steps of the fluid in one; absent: as many as its Courant number asks for")
    p.add_argument("--positions", choices=("start", "middle"),
                   help="of the particles that are mapped, in the step; absent: what suits the fluid")
    p.add_argument("--correct-momentum", action="store_true",
                   help="take the drift of total momentum back by a force, as the paper does")
    p.add_argument("--contacts", action="store_true", help="resolve contacts")
    p.add_argument("--coarse-graining", type=float, default=1.0, help="parcel diameter over particle diameter")
    p.add_argument("--end-time", type=float, default=0.5, help="simulated time [s]")
    p.add_argument("--seed", type=int, default=1, help="seed of the positions")
    p.add_argument("--output-every", type=float, default=0.05, help="time between ParaView outputs [s]")
    p.add_argument("--output", default="out/sedimenting_suspension", help="folder for results")
    restarts.add_arguments(p)
    return p


class Suspension:
    """Fluid, particles and coupling in a periodic box that carries its weight by a mean pressure gradient.

    ``fluid_steps`` of the fluid in one, ``None``: by its Courant number.
    """

    def __init__(self, diameter, particle_density, solid_fraction, box, cells, coupling, drag, mapping, fluid_velocity,
                 smoothing_length, coarse_graining, contacts, seed, fluid_steps=1, positions=None, tolerance=1e-10):
        lengths = np.array(box, float) * diameter
        self.mesh, _ = fe_el.periodic_box(lengths, cells)
        size = coarse_graining * diameter
        count = round(solid_fraction * lengths.prod() / (np.pi / 6 * size ** 3))
        self.solid = count * np.pi / 6 * size ** 3 / lengths.prod()
        down = np.array([0, 0, -GRAVITY])
        mixture = self.solid * particle_density + (1 - self.solid) * GAS_DENSITY
        self.balance = -mixture * down
        law = fe_el.Drag(drag)
        self.slip = fe_el.time_scales.homogeneous_slip(diameter, particle_density, GAS_DENSITY, GAS_VISCOSITY, self.solid,
                                                       law.law)
        self.air = fe_el.VolumeAveragedNavierStokes(self.mesh, None, GAS_DENSITY, GAS_VISCOSITY, down, tolerance,
                                                    mean_pressure_gradient=self.balance)
        self.beads = fe_el.Particles(self.mesh, particle_density, down)
        fall = -self.slip * (1 - self.solid) * GAS_DENSITY / mixture  # total momentum zero at the homogeneous slip
        self.beads.insert_in_box((0, 0, 0), lengths, count, size, velocity=(0, 0, fall), seed=seed,
                                 without_overlap=bool(contacts), coarse_graining=coarse_graining)
        self.air.set_initial_velocity((0, 0, fall + self.slip))
        smoothing = fe_el.HelmholtzSmoothing(self.mesh, smoothing_length * diameter) if smoothing_length else None
        self.fluid = self.air if fluid_steps == 1 else fe_el.SubCycled(self.air, fluid_steps)
        mean = {} if fluid_steps == 1 else {"mean_velocity": self.fluid.mean_velocity}
        pressure = self.fluid.mean_pressure if mean else self.air.pressure
        self.coupling = fe_el.Coupling(self.beads, self.air.velocity, pressure, GAS_DENSITY, GAS_VISCOSITY,
                                       [law, fe_el.PressureGradient(self.balance)], coupling, mapping, smoothing,
                                       fluid_velocity, positions=positions, **mean)
        self.contacts, self.count, self.first = None, count, np.zeros(3)
        self.weight = count * np.pi / 6 * size ** 3 * particle_density * GRAVITY
        if contacts:
            mass = np.pi / 6 * diameter ** 3 * particle_density
            stiffness = mass / 2 * (self.slip / (0.02 * size)) ** 2  # overlaps of about 2 % at the slip velocity
            self.contacts = fe_el.Contacts(self.beads, fe_el.LinearSpringDashpot(stiffness, restitution=0.9, friction=0.1),
                                           steps_per_contact=25)

    def parts(self):
        """What a checkpoint keeps."""
        return (self.beads, self.contacts, self.air, self.coupling, self.fluid if self.fluid is not self.air else None, self)

    def saved(self):
        """The pressure gradient that corrects the momentum, and the momentum it is to keep."""
        return {"same": (None, {"gradient": self.air.mean_pressure_gradient, "first": self.first})}

    def restore(self, state):
        """Take them back."""
        self.first = state["same"]["first"]
        self.air.mean_pressure_gradient[:] = self.coupling.pressure_force.mean[:] = state["same"]["gradient"]

    def advance(self, dt):
        """One time step."""
        self.coupling.to_fluid(dt)
        self.fluid.advance(dt, self.coupling.fields)
        self.coupling.to_particles(dt)
        self.beads.advance(dt, self.contacts)

    def momentum(self):
        """Total momentum (3,) [kg m/s]."""
        return self.fluid_momentum() + self.beads.momentum()

    def correct_momentum(self, dt):
        """Make the mean pressure gradient of the next step take back what momentum drifted; returns that force over the
        weight."""
        drift, volume = self.momentum() - self.first, self.air.comm.allreduce(self.air.volume.sum())
        gradient = self.balance - drift / (volume * dt)
        self.air.mean_pressure_gradient[:] = self.coupling.pressure_force.mean[:] = gradient
        return drift[2] / (dt * self.weight)

    def fluid_momentum(self):
        """Momentum of the fluid, with the void fraction of the last mapping (3,) [kg m/s]."""
        air = self.air
        mass = GAS_DENSITY * self.coupling.fields[0].x.array[:air.num_cells] * air.volume
        return air.comm.allreduce(mass @ air.velocity.x.array.reshape(-1, 3)[:air.num_cells])

    def mean_slip(self):
        """Momentum-averaged velocity of the fluid less that of the particles, upwards [m/s]."""
        air, beads = self.air, self.beads
        phi = self.coupling.fields[0].x.array[:air.num_cells]
        mass = air.comm.allreduce(np.array([GAS_DENSITY * phi @ air.volume, beads.mass.sum()]))
        return self.fluid_momentum()[2] / mass[0] - beads.momentum()[2] / mass[1]

    def energy(self):
        """Kinetic energy of both phases [J]."""
        air = self.air
        u = air.velocity.x.array.reshape(-1, 3)[:air.num_cells]
        phi = self.coupling.fields[0].x.array[:air.num_cells]
        fluid = air.comm.allreduce(0.5 * GAS_DENSITY * float((phi * air.volume) @ (u ** 2).sum(1)))
        return fluid + self.beads.kinetic_energy()


def mean_and_error(values, blocks=8):
    """Mean and its standard error from block means, which are long against the correlation time."""
    values = np.asarray(values)
    if len(values) < 2 * blocks:
        return values.mean(), values.std(ddof=1) / np.sqrt(len(values)) if len(values) > 1 else 0.0
    means = np.array([b.mean() for b in np.array_split(values, blocks)])
    return values.mean(), means.std(ddof=1) / np.sqrt(blocks)


def loop(scene, times, dt, rows, correct_momentum, after):
    """Advance the suspension and record it: whether it was stable, and why not."""
    for now in times:
        try:
            scene.advance(dt)
        except (FloatingPointError, fe_el.SolverDiverged, fe_el.LostParticle) as error:
            return False, str(error)
        rows.append((now, scene.mean_slip(), scene.coupling.momentum_imbalance, scene.coupling.max_solid_fraction,
                     scene.coupling.solid_volume_error, scene.air.mass_residual(),
                     scene.correct_momentum(dt) if correct_momentum else 0.0))
        if not abs(rows[-1][1]) < 10 * scene.slip:
            return False, f"the slip velocity grew to {rows[-1][1]:g} m/s"
        for call in after:
            call(now)
    return True, ""


def main(diameter=150e-6, particle_density=1500.0, solid_fraction=0.1, box=(48.0, 48.0, 96.0), cells=(6, 6, 12),
         coupling="conservative", dt_star=1.0, smoothing_length=None, drag="beetstra", mapping="overlap_volume",
         fluid_velocity="cell", fluid_steps=None, positions=None, correct_momentum=False, contacts=False,
         coarse_graining=1.0, end_time=0.5, seed=1, output_every=0.05,
         output="out/sedimenting_suspension", checkpoint_every=None, restart=None, wall_time=None, progress=True):
    """Run the suspension and return the summary."""
    if not 0 < solid_fraction < 0.6 or not dt_star > 0:
        raise ValueError(f"--solid-fraction is {solid_fraction} and --dt-star {dt_star}; give a fraction in (0, 0.6) and a "
                         "positive step.")
    logging.getLogger().setLevel(logging.WARNING)
    scene = Suspension(diameter, particle_density, solid_fraction, box, cells, coupling, drag, mapping, fluid_velocity,
                       smoothing_length, coarse_graining, contacts, seed, fluid_steps, positions)
    beads, comm = scene.beads, scene.beads.comm
    tau_f = float(fe_el.time_scales.fluid_relaxation_time(diameter, GAS_DENSITY, GAS_VISCOSITY, scene.solid))
    dt = dt_star * tau_f
    out = fe_el.ParaViewOutput(output, beads, [scene.air.velocity, scene.air.pressure, scene.coupling.fields[0]],
                               output_every)
    keep, rows = restarts.Restarts(output, dt, checkpoint_every, restart, wall_time), restarts.Rows()
    if not keep.going_on():
        scene.coupling.to_fluid(dt)  # the void fraction that the first momentum is taken with
        scene.first = scene.momentum()
    checkpoints, start, processor = keep.checkpoints(*scene.parts(), out, rows), time.perf_counter(), time.process_time()
    with checkpoints:
        stable, reason = loop(scene, keep.steps(checkpoints.time, max(end_time, dt), progress), dt, rows,
                              correct_momentum, (out.write, checkpoints.after))
    wall_time, processor = time.perf_counter() - start, comm.allreduce(time.process_time() - processor)
    rows = np.array(rows).reshape(-1, 7)
    if not stable and comm.rank == 0:
        print(f"Unstable after {len(rows)} steps: {reason}")
    late = rows[rows[:, 0] > 0.5 * rows[-1, 0], 1] if len(rows) else np.array([np.nan])
    slip, error = mean_and_error(late)
    correction = mean_and_error(rows[rows[:, 0] > 0.5 * rows[-1, 0], 6]) if len(rows) else (np.nan, np.nan)
    drift = np.abs(scene.momentum() - scene.first).max() / (scene.weight * rows[-1, 0]) if len(rows) else np.nan
    law = scene.coupling.drag.law
    re = GAS_DENSITY * (1 - scene.solid) * scene.slip * diameter / GAS_VISCOSITY
    numbers = {
        "particles": beads.total_number, "cells": comm.allreduce(scene.air.num_cells), "coupling": coupling,
               "mapping": mapping,
        "fluid_steps": scene.air.step / max(len(rows), 1), "positions": positions, "dt_star": dt_star, "time_step": dt,
               "end_time": end_time, "steps": len(rows), "slip_velocity": slip,
        "slip_velocity_error": error, "homogeneous_slip": scene.slip, "drift_over_weight": drift, "stable": stable,
        **({"correction_over_weight": correction[0], "correction_over_weight_error": correction[1]} if correct_momentum
           else {}),
        "tau_f": tau_f, "tau_f_drag_law": float(fe_el.time_scales.fluid_relaxation_time(
            diameter, GAS_DENSITY, GAS_VISCOSITY, scene.solid, law, re)),
        "tau_p": float(fe_el.time_scales.particle_relaxation_time(diameter, particle_density, GAS_VISCOSITY)),
        "max_solid_fraction": rows[:, 3].max(initial=0.0), "momentum_imbalance": rows[:, 2].max(initial=0.0),
        "solid_volume_error": rows[:, 4].max(initial=0.0), "mass_residual": rows[:, 5].max(initial=0.0),
        "over_filled_cells": scene.coupling.over_filled_total, "courant": scene.air.courant(dt),
        "lost_particles": scene.count - beads.total_number, "wall_time": wall_time,
        "processor_time": processor,
        **fe_el.stage_seconds(scene.contacts, scene.air, scene.coupling, out)}
    if scene.fluid is not scene.air:
        numbers["largest_fluid_steps"] = scene.fluid.steps_largest
    if scene.contacts:
        numbers["contact_steps_per_fluid_step"] = scene.contacts.steps_last
    if comm.rank == 0:
        picture(output, rows, numbers)
    return fe_el.write_summary(output, comm, **numbers)


def picture(output, rows, numbers):
    """PNG: slip velocity against time."""
    from matplotlib import pyplot as plt
    figure, axis = plt.subplots(figsize=(7, 4))
    axis.plot(rows[:, 0], rows[:, 1], lw=0.9, label=f"{numbers['coupling']}, dt* = {numbers['dt_star']:g}")
    axis.axhline(numbers["homogeneous_slip"], color="k", ls="--", label="uniform suspension")
    axis.set(xlabel="time [s]", ylabel="slip velocity [m/s]", ylim=(0, None))
    axis.legend()
    figure.tight_layout()
    figure.savefig(Path(output) / "slip_velocity.png", dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    reports.start(main, arguments(), REPORTS)
