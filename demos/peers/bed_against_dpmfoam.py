"""Cost of the fluidised bed beside OpenFOAM's DPMFoam with pairCollision on the same beads.

The beads settle without gas in fe_el. Both codes start from these positions, at rest, with the gas on: DPMFoam at its own
step, fe_el at the same step and sub-steps, and once more at those that ``fluidised_bed.py --report`` recommends. DPMFoam's
contacts are those of Hertz with a modulus of 1 MPa (it has no linear ones), fe_el's linear.
"""
import argparse
import logging
import sys
import time
from pathlib import Path

import matplotlib
import numpy as np
from mpi4py import MPI

import fe_el

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from demos import fluidised_bed as bed
from demos.peers import dpm_foam

matplotlib.use("Agg")


def arguments():
    """Command line of the demo."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    p.add_argument("--superficial-velocity", type=float, default=1.3, help="gas velocity at the inlet [m/s]")
    p.add_argument("--slice", type=float, default=1.0, help="fraction of the bed's width, same height")
    p.add_argument("--settle-time", type=float, default=0.25, help="time in which the beads settle [s]")
    p.add_argument("--time-step", type=float, default=1e-4, help="time step of both [s]")
    p.add_argument("--steps", type=int, default=60, help="steps; the median of the last two thirds counts")
    p.add_argument("--steps-per-contact", type=int, default=20, help="contact steps in the shortest contact, in both")
    p.add_argument("--recommended", type=float, nargs=2, default=(1e-3, 12), metavar=("STEP", "SUB_STEPS"),
                   help="fe_el's own step [s] and contact steps")
    p.add_argument("--peer-cell-size", type=float, default=0.005, help="edge of DPMFoam's cubes [m]")
    p.add_argument("--output", default="out/bed_against_dpmfoam", help="folder for results")
    return p


def collisions(steps_per_contact, restitution=0.9, friction=0.1):
    """DPMFoam's pair and wall models and what beads do at the patches."""
    damping = -np.sqrt(5) * np.log(restitution) / np.hypot(np.log(restitution), np.pi)
    common = (f"alpha {damping:.9g}; b 1.5; mu {friction:g}; cohesionEnergyDensity 0; useEquivalentSize no; "
              f"collisionResolutionSteps {steps_per_contact};")
    pair = ("collisionModel pairCollision; pairCollisionCoeffs { U U.air; "
            f"maxInteractionDistance {bed.LARGE:g}; writeReferredParticleCloud no; "
            f"pairModel pairSpringSliderDashpot; pairSpringSliderDashpotCoeffs {{ {common} }} wallModel "
            f"wallSpringSliderDashpot; "
            f"wallSpringSliderDashpotCoeffs {{ {common} youngsModulus 1e6; poissonsRatio 0.3; }} }}")
    wall = ("patchInteractionModel localInteraction; localInteractionCoeffs { patches ( top { type escape; } "
            f'"walls|bottom" {{ type rebound; e {restitution:g}; mu {friction:g}; }} ); }}')
    return pair, wall


def write_peer(folder, position, diameter, velocity, fraction, dt, steps, cell_size, steps_per_contact):
    """The bed as a case of DPMFoam."""
    lengths, upwards = (bed.WIDTH * fraction, bed.DEPTH, bed.HEIGHT), f"uniform (0 0 {velocity:g});"
    flux = "type fixedFluxPressure; phi phi.air; value uniform 0;"
    inlet = f"type interstitialInletVelocity; inletVelocity {upwards} value {upwards} phi phi.air; alpha alpha.air;"
    outlet = "type pressureInletOutletVelocity; phi phi.air; inletValue uniform (0 0 0); value uniform (0 0 0);"
    patches = {"walls": ("wall", "", "x- x+ y- y+", "type noSlip;", flux), "bottom": ("wall", "", "z-", inlet, flux),
               "top": ("patch", "", "z+", outlet, "type fixedValue; value uniform 0;")}
    pair, wall = collisions(steps_per_contact)
    dpm_foam.write_case(folder, lengths, [max(round(a / cell_size), 1) for a in lengths], patches, dt, steps,
                        (bed.GAS_DENSITY, bed.GAS_VISCOSITY), -bed.GRAVITY, bed.BEAD_DENSITY,
                        {name: (position[np.isclose(diameter, d)], d, 1, 0.0) for name,
                         d in (("small", bed.SMALL), ("large", bed.LARGE))},
                        initial=velocity, interaction=wall, collisions=pair)


def time_fe_el(position, diameter, velocity, fraction, dt, steps, steps_per_contact, progress):
    """Seconds of each step, and the last one's number of contact steps."""
    beads, contacts, air, coupling = bed.assemble(velocity, fraction, steps_per_contact=steps_per_contact)
    beads.insert_at(position, diameter)
    seconds = []
    for _ in fe_el.time_steps(dt, steps * dt, progress=progress):
        tick = time.perf_counter()
        coupling.to_fluid(dt)
        air.advance(dt, coupling.fields)
        coupling.to_particles(dt)
        beads.advance(dt, contacts)
        seconds.append(time.perf_counter() - tick)
    return np.array(seconds), contacts.steps_last


def main(superficial_velocity=1.3, slice=1.0, settle_time=0.25, time_step=1e-4, steps=60, steps_per_contact=20,
         recommended=(1e-3, 12), peer_cell_size=0.005, output="out/bed_against_dpmfoam", progress=True):
    """Run both codes and return the summary; on one rank."""
    logging.getLogger().setLevel(logging.WARNING)
    start = time.perf_counter()
    beads, contacts, _, _ = bed.assemble(0.0, slice)
    bed.fill(beads, slice, 1)
    for _ in fe_el.time_steps(20 * time_step, settle_time, progress=progress):
        beads.advance(20 * time_step, contacts)
    position, diameter, late = beads.position.copy(), beads.diameter.copy(), -(-steps // 3)
    seconds, sub_steps = time_fe_el(position, diameter, superficial_velocity, slice, time_step, steps, steps_per_contact,
                                    progress)
    own_step, own_sub_steps = float(recommended[0]), int(recommended[1])
    own, _ = time_fe_el(position, diameter, superficial_velocity, slice, own_step, steps, own_sub_steps, progress)
    numbers = {"seconds_per_step_fe_el": float(np.median(seconds[late:])), "contact_steps_fe_el": sub_steps,
               "seconds_per_simulated_second_fe_el": float(np.median(own[late:])) / own_step,
               "recommended_time_step": own_step, "recommended_steps_per_contact": own_sub_steps}
    folder, curves = Path(output).resolve() / "dpmfoam", {"fe_el": seconds, f"fe_el, {1e3 * own_step:g} ms": own}
    if dpm_foam.installed():
        write_peer(folder, position, diameter, superficial_velocity, slice, time_step, steps, peer_cell_size,
                   steps_per_contact)
        out = dpm_foam.run(folder, limit=3600.0)
        if out["stopped"]:
            raise RuntimeError(f"DPMFoam ended after {len(out['time'])} of {steps} steps: {out['stopped']}.")
        peer = float(np.median(out["seconds"][late:]))
        numbers |= {"seconds_per_step_dpmfoam": peer, "contact_steps_dpmfoam": float(out["sub_steps"][-1]),
                    "particles_dpmfoam": int(out["parcels"][-1]),
                    "dpmfoam_over_fe_el": peer / numbers["seconds_per_step_fe_el"],
                    "seconds_per_simulated_second_dpmfoam": peer / time_step,
                    "dpmfoam_over_fe_el_recommended": peer / time_step / numbers["seconds_per_simulated_second_fe_el"]}
        curves["DPMFoam"] = out["seconds"]
    else:
        print("DPMFoam is not installed; on Debian: apt-get install openfoam.", flush=True)
    Path(output).mkdir(parents=True, exist_ok=True)
    picture(output, curves)
    return fe_el.write_summary(output, MPI.COMM_SELF, particles=len(position), slice=slice, time_step=time_step, steps=steps,
                               steps_per_contact=steps_per_contact, wall_time=time.perf_counter() - start, **numbers)


def picture(output, curves):
    """PNG: seconds of every step."""
    from matplotlib import pyplot as plt
    figure, axis = plt.subplots(figsize=(6, 4), layout="constrained")
    for name, seconds in curves.items():
        axis.semilogy(seconds, label=name)
    axis.set(xlabel="step", ylabel="seconds")
    axis.legend()
    figure.savefig(Path(output) / "bed_against_dpmfoam.png", dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    for key, value in main(**vars(arguments().parse_args())).items():
        print(f"{key:32s} {value}")
