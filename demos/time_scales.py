"""Time scales of a freely sedimenting suspension against the particle diameter (Radl et al., Fig. 2)."""
import argparse
from pathlib import Path

import matplotlib
import numpy as np
from mpi4py import MPI

import fe_el
from fe_el import time_scales

matplotlib.use("Agg")


def arguments():
    """Command line of the demo."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    p.add_argument("--particle-density", type=float, default=1500.0, help="[kg/m^3]")
    p.add_argument("--fluid-density", type=float, default=1.3, help="[kg/m^3]")
    p.add_argument("--viscosity", type=float, default=1.8e-5, help="[Pa s]")
    p.add_argument("--solid-fractions", type=float, nargs="+", default=(0.001, 0.1), help="mean solid fractions")
    p.add_argument("--cell-size", type=float, default=3.0, help="fluid cell in particle diameters, for the Courant time")
    p.add_argument("--drag", default="beetstra", help="name of the drag law")
    p.add_argument("--output", default="out/time_scales", help="folder for results")
    return p


def curves(solid_fraction, diameters, particle_density, fluid_density, viscosity, cell_size, law):
    """tau_p, tau_f and tau_Co [s] of each diameter, at its own settling velocity."""
    rows = []
    for d in diameters:
        slip = time_scales.homogeneous_slip(d, particle_density, fluid_density, viscosity, solid_fraction, law)
        re = fluid_density * (1 - solid_fraction) * slip * d / viscosity
        rows.append((float(time_scales.particle_relaxation_time(d, particle_density, viscosity, solid_fraction, law, re)),
                     float(time_scales.fluid_relaxation_time(d, fluid_density, viscosity, solid_fraction, law, re)),
                     time_scales.courant_time(cell_size * d, slip, 0.5)))
    return np.array(rows).T


def main(particle_density=1500.0, fluid_density=1.3, viscosity=1.8e-5, solid_fractions=(0.001, 0.1), cell_size=3.0,
         drag="beetstra",
         output="out/time_scales", progress=True):
    """Draw the time scales and return the summary: below which diameter tau_p and tau_f are shorter than the Courant
    time."""
    law, diameters = fe_el.Drag(drag).law, np.logspace(-6, -2.5, 200)
    numbers = {"particle_density": particle_density, "fluid_density": fluid_density, "viscosity": viscosity}
    drawn = []
    for s in solid_fractions:
        tau_p, tau_f, tau_c = curves(s, diameters, particle_density, fluid_density, viscosity, cell_size, law)
        drawn.append((s, tau_p, tau_f, tau_c))
        numbers[f"largest_diameter_limited_by_tau_p_at_{s:g}"] = largest(diameters, tau_p < tau_c)
        numbers[f"largest_diameter_limited_by_tau_f_at_{s:g}"] = largest(diameters, tau_f < tau_c)
        numbers[f"time_step_at_20_um_at_{s:g}"] = float(np.interp(20e-6, diameters, np.minimum(np.minimum(tau_p, tau_f),
                                                                                               tau_c)))
    numbers["advice"] = time_scales.advice(150e-6, particle_density, fluid_density, viscosity, solid_fractions[-1], 1.0,
                                                 cell_size * 150e-6, law).sentence
    if MPI.COMM_WORLD.rank == 0:
        Path(output).mkdir(parents=True, exist_ok=True)
        picture(output, diameters, drawn)
    return fe_el.write_summary(output, **numbers)


def largest(diameters, chosen):
    """Largest diameter of the chosen ones [m], zero if there is none."""
    return float(diameters[chosen].max()) if chosen.any() else 0.0


def picture(output, diameters, drawn):
    """PNG: time scales against diameter, one panel per solid fraction."""
    from matplotlib import pyplot as plt
    figure, axes = plt.subplots(1, len(drawn), figsize=(5.2 * len(drawn), 4.4), sharey=True, squeeze=False)
    for axis, (s, tau_p, tau_f, tau_c) in zip(axes[0], drawn):
        for curve, name in ((tau_p, "particle relaxation"), (tau_f, "fluid relaxation"), (tau_c, "Courant number 0.5")):
            axis.loglog(diameters * 1e6, curve, label=name)
        axis.set(xlabel="particle diameter [um]", title=f"solid fraction {s:g}")
        axis.grid(alpha=0.3)
    axes[0][0].set_ylabel("time scale [s]")
    axes[0][0].legend()
    figure.tight_layout()
    figure.savefig(Path(output) / "time_scales.png", dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    summary = main(**vars(arguments().parse_args()))
    if MPI.COMM_WORLD.rank == 0:
        for key, value in summary.items():
            print(f"{key:48s} {value}")
