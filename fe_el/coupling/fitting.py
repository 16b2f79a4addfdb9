"""Whether fluid, particles, forces and the step of a coupling fit each other."""
import numpy as np

from fe_el.checks import require_particles, same_mesh
from fe_el.coupling.added_mass import AddedMass
from fe_el.coupling.forces import Buoyancy, Drag, PressureGradient, ViscousStress
from fe_el.coupling.light_particles import lightest_of

LIGHT = 0.001  # density of a fluid over that of particles, from which on they take its pressure of the end of the step
LARGEST = 1000.0  # relaxation times in a step, beyond which it tells little of what happens in it
FAST = 7.0  # Courant number from which one step of the fluid in an exchange puts the slip of a suspension off by 5 %


def fitting(flow, particles, forces, takes_shares=False):
    """The forces, with the fluid's mean pressure gradient where none was given.

    Args:
        flow: a fluid with ``mesh``, ``gravity``, ``mean_pressure_gradient`` and ``stress_of_mixture``.
        takes_shares (bool): whether fluid and scheme take a share of the pressure gradient.

    Raises:
        ValueError: where they contradict each other.
    """
    d, out = particles.mesh.topology.dim, []
    alone = not any(isinstance(f, AddedMass) or isinstance(f, Drag) and f.relaxing for f in forces)
    at_end = takes_shares and alone and flow.density > LIGHT * lightest_of(particles)
    down, mean = np.asarray(flow.gravity, float), np.asarray(flow.mean_pressure_gradient, float)
    if flow.mesh is not particles.mesh:
        raise ValueError("Fluid and particles live on different meshes; make both with the same one.")
    if down.any() and not np.array_equal(down, particles.gravity[:d]):
        raise ValueError(f"Gravity is {down.tolist()} in the fluid and {particles.gravity[:d].tolist()} for the particles; "
                         "give both the same.")
    for force in forces:
        if isinstance(force, Buoyancy) and down.any():
            raise ValueError("Buoyancy() is for fluids without gravity; this one has it in its pressure: use "
                             "PressureGradient().")
        if isinstance(force, ViscousStress) and not flow.stress_of_mixture:
            raise ValueError("ViscousStress() wants a fluid that carries the whole stress: stress_of_mixture=True.")
        if isinstance(force, PressureGradient):
            if force.mean.any() and not np.array_equal(force.mean[:d], mean):
                raise ValueError(f"The mean pressure gradient is {mean.tolist()} in the fluid and {force.mean[:d].tolist()} "
                                 "for the particles; leave out the latter.")
            force = PressureGradient(mean, at_end if force.at_end is None else force.at_end)
        out.append(force)
    return out


def check_list(particles, forces):
    """Refuse what are no particles, or no list of forces."""
    require_particles(particles)
    if not isinstance(forces, (list, tuple)):
        raise ValueError(f"The forces are {forces!r}; give a list, for instance [Drag('beetstra'), PressureGradient()].")


def check_functions(mesh, velocity, pressure, mean_velocity):
    """Refuse what is no function of the mesh; pressure and mean velocity may be ``None``."""
    for name, function in (("velocity", velocity), ("pressure", pressure), ("mean velocity", mean_velocity)):
        if not hasattr(function, "ufl_shape") and (function is not None or name == "velocity"):
            raise ValueError(f"The {name} of the fluid is {function!r}; pass its Function, or a UFL expression.")
        same_mesh(f"values of the {name}", function, mesh)


def step_beyond_sense(dt, fluid_rate, particle_rate, explicit):
    """What is wrong with a step of ``dt`` [s] at the largest rates of relaxation of fluid and particles [1/s]; or None."""
    if explicit and fluid_rate * dt > 2:
        return (f"The step of {dt:.3g} s is {fluid_rate * dt:.3g} relaxation times of the fluid in its fullest cell; "
                f"explicit drag is unstable beyond 2. Use scheme='conservative', or steps below {2 / fluid_rate:.2g} s.")
    for name, rate in (("fluid", fluid_rate), ("particles", particle_rate)):
        if rate * dt > LARGEST:
            return (f"The step of {dt:.3g} s is {rate * dt:.3g} relaxation times of the {name} ({1 / rate:.2g} s). It is "
                    f"stable, but beyond {LARGEST:g} little of what happens in a step is resolved.")
    return None


def step_too_fast(dt, courant):
    """What is wrong with one step of the fluid of ``dt`` [s] at the largest Courant number among particles; or None."""
    if courant > FAST:
        return (f"The step of {dt:.3g} s has a Courant number of {courant:.3g} among the particles, and the fluid makes it "
                f"in one. It is stable, but beyond {FAST:g} the slip of a sedimenting suspension was off by more than 5 %. "
                "Couple fe_el.SubCycled(fluid), which makes smaller steps of the fluid for the same exchange.")
    return None
