"""fe_el: finite-element fluid with Lagrangian particles on FEniCSx.

Fluid: VolumeAveragedNavierStokes
Particles: Particles, LostParticle, Contacts; laws LinearSpringDashpot, HertzMindlin, RollingFriction, ArrayLaw;
    walls FacetWalls, PlaneWall, CylinderWall
Coupling: Coupling, Drag, PressureGradient, drag_laws
Meshes: read_mesh, mesh_geo, box
Running: time_steps, ParaViewOutput, write_summary

Every public call is collective unless it says otherwise; all numbers are in SI units.
Names are loaded when first used, so a scene without fluid never imports the fluid.
"""
import importlib

_HOME = {
    "VolumeAveragedNavierStokes": "fluid.volume_averaged_navier_stokes", "SolverDiverged": "fluid.linear_solver",
    "Particles": "particles.particles", "LostParticle": "particles.particles", "Contacts": "particles.contacts",
    "LinearSpringDashpot": "particles.contact_laws", "HertzMindlin": "particles.contact_laws",
    "RollingFriction": "particles.contact_laws", "ArrayLaw": "particles.array_law", "FacetWalls": "particles.wall_shapes",
    "PlaneWall": "particles.wall_shapes", "CylinderWall": "particles.wall_shapes",
    "Coupling": "coupling.coupling", "Drag": "coupling.forces",
    "PressureGradient": "coupling.forces", "read_mesh": "mesh", "mesh_geo": "mesh", "box": "box_mesh",
    "time_steps": "output", "ParaViewOutput": "output", "write_summary": "output",
}
__all__ = [*_HOME, "drag_laws"]


def __getattr__(name):
    if name == "drag_laws":
        return importlib.import_module("fe_el.coupling.drag_laws")
    if name not in _HOME:
        raise AttributeError(f"fe_el has no {name!r}; it has {', '.join(sorted(__all__))}.")
    return getattr(importlib.import_module("fe_el." + _HOME[name]), name)
