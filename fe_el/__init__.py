"""fe_el: finite-element fluid with Lagrangian particles on FEniCSx.

Fluid: VolumeAveragedNavierStokes, SubCycled, Scalar, Probe, TimeAverage, ramp, SolverDiverged;
    eddy viscosities Smagorinsky, Vreman, Wale; wall law Spalding; stabilisations Streamline, Upwind;
    turbulent inlets PowerLaw, LogLaw, SyntheticEddies
Particles: Particles, Inlet, LostParticle, Contacts; laws LinearSpringDashpot, HertzMindlin, RollingFriction, ArrayLaw;
    walls FacetWalls, PlaneWall, CylinderWall, SurfaceWall; Injector with FacetSource, DiscSource or PointSource;
    SizeDistribution; MultiphasePIC with SolidsStress in the place of contacts
Coupling: Coupling; forces Drag, PressureGradient, ViscousStress, Buoyancy, AddedMass, SaffmanLift, MagnusLift, Torque,
    UndisturbedVelocity, TurbulentDispersion and own ones; drag_laws; HelmholtzSmoothing, PatchAverage; OverlapVolume,
    SatellitePoints, ParticleCentred, HatKernel, WellMixed; time_scales
Meshes: read_mesh, mesh_geo, box, periodic_box
Running: time_steps, adaptive_steps, ParaViewOutput, stage_seconds, write_summary, save_checkpoint, load_checkpoint,
    Checkpoints, StopAndSave; ParticleFieldAverage, ParticleProfile, PlaneFlux

Every public call is collective unless it says otherwise; all numbers are in SI units.
Names are loaded when first used, so a scene without fluid never imports the fluid.
"""
import importlib
import importlib.metadata

from fe_el import dolfinx_api  # noqa: F401 (says at once when dolfinx is missing)

_NAMES = {
    "coupling.added_mass": "AddedMass",
    "coupling.coupling": "Coupling",
    "coupling.dispersion": "TurbulentDispersion",
    "coupling.forces": "Drag PressureGradient ViscousStress Buoyancy",
    "coupling.lift_and_torque": "SaffmanLift MagnusLift Torque",
    "coupling.mapping": "SatellitePoints ParticleCentred HatKernel WellMixed",
    "coupling.overlap": "OverlapVolume",
    "coupling.smoothing": "HelmholtzSmoothing PatchAverage",
    "coupling.undisturbed": "UndisturbedVelocity",
    "fluid.boundary_values": "ramp",
    "fluid.inlet_profiles": "PowerLaw LogLaw SyntheticEddies",
    "fluid.scalar": "Scalar",
    "fluid.stabilisation": "Streamline Upwind",
    "fluid.sub_cycling": "SubCycled",
    "fluid.turbulence": "Smagorinsky Vreman Wale",
    "fluid.volume_averaged_navier_stokes": "VolumeAveragedNavierStokes",
    "fluid.wall_laws": "Spalding",
    "mesh.box_mesh": "box",
    "mesh.gmsh_files": "read_mesh mesh_geo",
    "mesh.periodic_mesh": "periodic_box",
    "nodes.linear_solver": "SolverDiverged",
    "particles.contacts.array_law": "ArrayLaw",
    "particles.contacts.contact_laws": "LinearSpringDashpot HertzMindlin RollingFriction",
    "particles.contacts.contacts": "Contacts",
    "particles.contacts.wall_shapes": "FacetWalls PlaneWall CylinderWall",
    "particles.contacts.wall_surfaces": "SurfaceWall",
    "particles.injection": "Injector",
    "particles.open_boundaries": "Inlet",
    "particles.migration": "LostParticle",
    "particles.particles": "Particles",
    "particles.size_distribution": "SizeDistribution",
    "particles.sources": "FacetSource DiscSource PointSource",
    "particles.multiphase_pic": "MultiphasePIC",
    "particles.solids_stress": "SolidsStress",
    "run.checkpoint": "save_checkpoint load_checkpoint",
    "run.checkpoints": "Checkpoints",
    "run.observers": "Probe TimeAverage",
    "run.particle_observers": "ParticleFieldAverage ParticleProfile PlaneFlux",
    "run.paraview": "ParaViewOutput",
    "run.stopping": "StopAndSave",
    "run.summary": "write_summary stage_seconds",
    "run.time_steps": "time_steps adaptive_steps",
}
_HOME = {name: module for module, names in _NAMES.items() for name in names.split()}
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


def __dir__():
    return sorted([*__all__, "__version__", "__doc__"])
