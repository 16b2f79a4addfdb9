"""fe_el: finite-element fluid with Lagrangian particles on FEniCSx.

Fluid: VolumeAveragedNavierStokes, SubCycled, Scalar, Probe, TimeAverage, ramp, SolverDiverged;
    eddy viscosities Smagorinsky, Vreman, Wale; wall law Spalding; stabilisations Streamline, Upwind
Particles: Particles, Inlet, LostParticle, Contacts; laws LinearSpringDashpot, HertzMindlin, RollingFriction, ArrayLaw;
    walls FacetWalls, PlaneWall, CylinderWall
Coupling: Coupling; forces Drag, PressureGradient, ViscousStress, Buoyancy, AddedMass, SaffmanLift, MagnusLift, Torque,
    UndisturbedVelocity and own ones; drag_laws; HelmholtzSmoothing, PatchAverage; OverlapVolume, SatellitePoints,
    ParticleCentred, HatKernel, WellMixed; time_scales
Meshes: read_mesh, mesh_geo, box, periodic_box
Running: time_steps, adaptive_steps, ParaViewOutput, stage_seconds, write_summary, save_checkpoint, load_checkpoint,
    StopAndSave

Every public call is collective unless it says otherwise; all numbers are in SI units.
Names are loaded when first used, so a scene without fluid never imports the fluid.
"""
import importlib
import importlib.metadata

from fe_el import dolfinx_api  # noqa: F401 (says at once when dolfinx is missing)

_HOME = {
    "VolumeAveragedNavierStokes": "fluid.volume_averaged_navier_stokes", "SolverDiverged": "fluid.linear_solver",
    "Scalar": "fluid.scalar", "Probe": "fluid.observers", "TimeAverage": "fluid.observers", "ramp": "fluid.boundary_values",
    "Smagorinsky": "fluid.turbulence", "Vreman": "fluid.turbulence", "Wale": "fluid.turbulence",
    "SubCycled": "fluid.sub_cycling", "Spalding": "fluid.wall_laws", "Streamline": "fluid.stabilisation",
         "Upwind": "fluid.stabilisation",
    "Particles": "particles.particles", "LostParticle": "particles.particles", "Contacts": "particles.contacts",
    "LinearSpringDashpot": "particles.contact_laws", "HertzMindlin": "particles.contact_laws",
    "RollingFriction": "particles.contact_laws", "ArrayLaw": "particles.array_law", "Inlet": "particles.open_boundaries",
    "FacetWalls": "particles.wall_shapes",
    "PlaneWall": "particles.wall_shapes", "CylinderWall": "particles.wall_shapes",
    "Coupling": "coupling.coupling", "Drag": "coupling.forces",
    "PressureGradient": "coupling.forces", "ViscousStress": "coupling.forces", "Buoyancy": "coupling.forces",
    "SaffmanLift": "coupling.lift_and_torque", "MagnusLift": "coupling.lift_and_torque",
    "Torque": "coupling.lift_and_torque", "AddedMass": "coupling.added_mass",
    "UndisturbedVelocity": "coupling.undisturbed",
    "HelmholtzSmoothing": "coupling.smoothing", "PatchAverage": "coupling.smoothing", "SatellitePoints": "coupling.mapping",
    "ParticleCentred": "coupling.mapping", "HatKernel": "coupling.mapping", "WellMixed": "coupling.mapping",
    "OverlapVolume": "coupling.overlap",
    "read_mesh": "gmsh_files", "mesh_geo": "gmsh_files", "box": "box_mesh", "periodic_box": "periodic_mesh",
    "time_steps": "output", "adaptive_steps": "output", "ParaViewOutput": "output", "write_summary": "output",
    "stage_seconds": "output", "save_checkpoint": "checkpoint", "load_checkpoint": "checkpoint",
    "StopAndSave": "stopping",
}
_MODULES = ("drag_laws", "time_scales", "schemes", "mapping")
__all__ = list(_HOME) + list(_MODULES)


def __getattr__(name):
    if name == "__version__":
        return importlib.metadata.version("fe_el")
    if name in _MODULES:
        return importlib.import_module("fe_el.coupling." + name)
    if name not in _HOME:
        raise AttributeError(f"fe_el has no {name!r}; it has {', '.join(sorted(__all__))}.")
    return getattr(importlib.import_module("fe_el." + _HOME[name]), name)
