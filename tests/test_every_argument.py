"""Every argument of every public call refuses what can be none. They are found from signatures: new ones are tried, too."""
import functools
import inspect
import tempfile

import numpy as np
import pytest

import fe_el

NEVER = (object(), 1j, dict, {}, [[1.0], [1.0, 2.0]], b"1")  # what no argument can be
SWITCHES = {"polydisperse", "relaxing", "at_end", "stress_of_mixture", "elastic_plastic", "torsion", "outside",
            "may_be_open", "without_overlap", "progress",  # true or not
            "comm", "name"}  # handed on to MPI; a text that is only shown
FREE = {("ArrayLaw", "function"), ("StopAndSave", "save")}  # a class may be a function
INNER = {  # methods that fe_el calls with what it has made itself, not the user
    "deposit", "gather", "prepare", "concentration", "near", "solve", "loop", "force", "spin", "density", "coefficient",
    "restore", "follow", "moved", "places", "draw", "of_parcels", "contact_time", "select", "wrap", "locate", "located",
    "reach_halo", "share", "distance", "at_cells", "boundary", "check_closed", "complete", "impose", "inflow_at",
    "nodal_zeros", "set_boundary_values", "theta_of", "at_particles", "to_cells"}
WITHOUT_ARGUMENTS = {"SolverDiverged", "LostParticle"}  # errors
IN_MODULES = {"drag_laws", "time_scales", "schemes", "mapping"}


@functools.cache
def objects():
    """A scene of its own, whose fluid and beads may be given anything."""
    mesh, tags = fe_el.box((0.01,) * 3, (2, 2, 2))
    beads, air = fe_el.Particles(mesh, 2500.0), fe_el.VolumeAveragedNavierStokes(mesh, tags)
    beads.insert_at([(0.005,) * 3], 1e-4)
    law = fe_el.LinearSpringDashpot(1.0, 0.5, 0.3)
    return {"mesh": mesh, "tags": tags, "beads": beads, "air": air, "law": law, "drag": fe_el.Drag("beetstra"),
            "contacts": fe_el.Contacts(beads, law), "wall": fe_el.PlaneWall((0, 0, 0), (0, 0, 1)),
            "scalar": fe_el.Scalar(air, 1e-5), "coupling": fe_el.Coupling.of(air, beads, [fe_el.Drag("beetstra")]),
            "source": fe_el.PointSource((0.005,) * 3)}


@functools.cache
def calls():
    """Valid arguments of every public call, those without a default at least: name to function and arguments."""
    o, folder = objects(), tempfile.mkdtemp()
    mesh, tags, beads, air = o["mesh"], o["tags"], o["beads"], o["air"]
    box, low, high, geo = {"lengths": (1.0,) * 3, "cells": (3,) * 3}, (0.001,) * 3, (0.009,) * 3, "meshes/cylinder.geo"
    law = {"restitution": 0.5, "friction": 0.3}
    by_name = {
        "Coupling": {"particles": beads, "velocity": air.velocity, "pressure": air.pressure, "fluid_density": 1.2,
                     "fluid_viscosity": 1e-5, "forces": []},
        "TurbulentDispersion": {"fluid": air, "drag": o["drag"]}, "Drag": {"law": "beetstra"},
        "HelmholtzSmoothing": {"mesh": mesh, "length": 1e-3}, "PatchAverage": {"mesh": mesh},
        "ramp": {"value": 1.0, "duration": 1.0},
        "PowerLaw": {"velocity": 1.0, "thickness": 1.0, "walls": [((0, 0, 0), (0, 0, 1))]},
        "LogLaw": {"velocity": 1.0, "thickness": 1.0, "kinematic_viscosity": 1e-5, "walls": [((0, 0, 0), (0, 0, 1))]},
        "SyntheticEddies": {"fluid": air, "group": 5, "mean": (0, 0, 1.0)}, "Scalar": {"fluid": air, "diffusivity": 1e-5},
        "SubCycled": {"fluid": air}, "VolumeAveragedNavierStokes": {"mesh": mesh}, "box": box, "periodic_box": box,
        "read_mesh": {"path": "meshes/fluidised_bed.msh"}, "mesh_geo": {"path": geo, "dimension": 2},
        "ArrayLaw": {"function": print, "contact_time": 1e-3}, "LinearSpringDashpot": {"stiffness": 1.0, **law},
        "HertzMindlin": {"youngs_modulus": 1e6, "poisson_ratio": 0.3, **law}, "RollingFriction": {"coefficient": 0.1},
        "Contacts": {"particles": beads, "law": o["law"]}, "FacetWalls": {"facet_tags": tags, "groups": 1},
        "PlaneWall": {"point": low, "normal": (0, 0, 1)}, "CylinderWall": {"point": low, "axis": (0, 0, 1), "radius": 1.0},
        "SurfaceWall": {"surface": (np.eye(3), [(0, 1, 2)]), "may_be_open": True},
        "Injector": {"particles": beads, "source": o["source"], "velocity": (0, 0, 1.0), "diameter": 1e-5, "mass_rate": 1.0},
        "Inlet": {"particles": beads, "facet_tags": tags, "group": 6, "mass_rate": 1.0, "diameter": 1e-5,
                  "velocity": (0, 0, -1.0)},
        "Particles": {"mesh": mesh, "density": 1.0}, "SizeDistribution": {"lower": [1.0], "upper": [2.0], "shares": [1.0]},
        "FacetSource": {"facet_tags": tags, "group": 5},
        "DiscSource": {"centre": low, "normal": (0, 0, 1), "diameter": 1e-3},
        "PointSource": {"position": low}, "MultiphasePIC": {"particles": beads},
        "Probe": {"functions": [air.pressure], "points": [low]}, "TimeAverage": {"function": air.pressure},
        "ParticleFieldAverage": {"particles": beads},
        "ParticleProfile": {"particles": beads, "edges": [0.0, 1.0], "quantity": lambda p: p.diameter},
        "PlaneFlux": {"particles": beads, "point": low, "normal": (0, 0, 1)},
        "ParaViewOutput": {"folder": folder, "particles": beads},
        "StopAndSave": {"save": print}, "write_summary": {"folder": folder}, "stage_seconds": {},
        "time_steps": {"dt": 0.1, "end_time": 1.0}, "adaptive_steps": {"fluid": air, "end_time": 1.0}}
    out = {name: (getattr(fe_el, name), arguments) for name, arguments in by_name.items()}
    inject, path = by_name["Injector"], {"path": folder + "/a.h5"}
    out |= {"FacetWalls": (lambda **a: fe_el.Contacts(beads, o["law"], fe_el.FacetWalls(**a)), by_name["FacetWalls"]),
            "FacetSource": (lambda **a: fe_el.Injector(**{**inject, "source": fe_el.FacetSource(**a)}),
                            by_name["FacetSource"]),
            "save_checkpoint": (lambda path: fe_el.save_checkpoint(path, beads), path),
            "load_checkpoint": (lambda path: fe_el.load_checkpoint(path, beads), path),
            "Checkpoints": (lambda path, **a: fe_el.Checkpoints(path, beads, **a), path)}
    insert, sizes = {"diameter": 1e-5}, fe_el.SizeDistribution
    of_objects = {
        beads: {"advance": {"dt": 1e-6}, "hold": {}, "release": {}, "insert_at": {"position": [low], **insert},
                "insert_in_box": {"lower": low, "upper": high, "count": 1, **insert},
                "insert_on_lattice": {"lower": low, "upper": high, **insert},
                "rebound_at": {"facet_tags": tags, "groups": 1}, "remove_at": {"facet_tags": tags, "groups": 2}},
        air: {"advance": {"dt": 1e-6}, "courant": {"dt": 1e-6}, "boundary_force": {"group": 1},
              "set_initial_velocity": {"value": low}, "set_no_slip": {"groups": 1}, "set_pressure": {"groups": 6},
              "set_slip": {"groups": 2}, "set_velocity": {"groups": 5, "value": (0, 0, 1.0)}},
        o["scalar"]: {"advance": {"dt": 1e-6}, "set_inflow": {"group": 5, "value": 1.0},
                      "set_value": {"group": 1, "value": 1.0}},
        o["coupling"]: {"to_fluid": {"dt": 1e-6}, "to_particles": {"dt": 1e-6}}, o["contacts"]: {"advance": {"dt": 1e-6}},
        fe_el.SubCycled(air): {"advance": {"dt": 1e-6, "fields": o["coupling"].fields}},
        fe_el.MultiphasePIC(beads): {"advance": {"dt": 1e-6}},
        fe_el.Inlet(**by_name["Inlet"]): {"advance": {"dt": 1e-6}},
        fe_el.Injector(**by_name["Injector"]): {"advance": {"dt": 1e-6}},
        fe_el.Checkpoints(folder + "/b.h5", beads): {"after": {"time": 1.0}},
        fe_el.Probe([air.pressure], [low]): {"record": {"time": 1.0}}, fe_el.TimeAverage(air.pressure): {"add": {"dt": 1.0}},
        fe_el.ParticleFieldAverage(beads): {"add": {"dt": 1.0}},
        fe_el.ParticleProfile(**by_name["ParticleProfile"]): {"add": {"dt": 1.0}},
        fe_el.PlaneFlux(**by_name["PlaneFlux"]): {"add": {"dt": 1.0}},
        fe_el.ParaViewOutput(folder, beads): {"write": {"time": 1.0}}}
    for thing, methods in of_objects.items():
        out |= {f"{type(thing).__name__}.{name}": (getattr(thing, name), a) for name, a in methods.items()}
    out |= {"Coupling.of": (fe_el.Coupling.of, {"fluid": air, "particles": beads, "forces": []}),
            "SizeDistribution.listed": (sizes.listed, {"diameters": [1.0], "shares": [1.0]}),
            "SizeDistribution.normal": (sizes.normal, {"mean": 1.0, "deviation": 0.1, "smallest": 0.5, "largest": 2.0}),
            "SizeDistribution.lognormal": (sizes.lognormal, {"median": 1.0, "spread": 0.1, "smallest": 0.5, "largest": 2.0}),
            "SizeDistribution.rosin_rammler": (sizes.rosin_rammler, {"size": 1.0, "exponent": 3.0, "smallest": 0.5,
                                                                     "largest": 2.0}),
            "SizeDistribution.sieves": (sizes.sieves, {"openings": [1.0, 2.0], "passing": [0.0, 1.0]})}
    return out


def public():
    """Names of all public calls that take an argument, with their signatures."""
    out = {}
    for name in fe_el.__all__:
        thing = getattr(fe_el, name)
        if name in WITHOUT_ARGUMENTS | IN_MODULES:
            continue
        out[name] = inspect.signature(thing)
        for method, function in inspect.getmembers(thing, callable) if inspect.isclass(thing) else ():
            if not method.startswith("_") and method not in INNER:
                out[f"{name}.{method}"] = inspect.signature(function)
    return {name: signature for name, signature in out.items()
            if any(p != "self" for p in signature.parameters)}


def test_every_public_call_is_tried():
    """A new one needs valid arguments in ``calls``, or a place among those that users do not call."""
    plain = {name for name, signature in public().items()
             if all(p.default is not p.empty for p in signature.parameters.values())}
    assert public().keys() - calls().keys() - plain == set()


def arguments():
    """Call and argument, for all that are tried."""
    kinds = inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL
    return [(name, p.name) for name, signature in public().items() for p in signature.parameters.values()
            if p.name not in SWITCHES | {"self"} and p.kind not in kinds and (name, p.name) not in FREE]


@pytest.mark.parametrize("name,argument", arguments())
def test_what_an_argument_can_never_be_is_refused_in_a_sentence(name, argument):
    call, valid = calls().get(name) or (getattr(fe_el, name), {})
    for value in NEVER:
        with pytest.raises(ValueError) as error:
            result = call(**{**valid, argument: value})
            list(result) if inspect.isgenerator(result) else None
        assert str(error.value).endswith(".") and len(str(error.value)) > 40, (value, str(error.value))


@pytest.mark.parametrize("name,argument", [
    ("ramp", "value"), ("LinearSpringDashpot", "cohesion"), ("RollingFriction", "coefficient"), ("Inlet", "diameter"),
    ("Particles.insert_on_lattice", "diameter"), ("Particles.insert_at", "diameter"), ("HertzMindlin", "friction")])
def test_nothing_is_no_number(name, argument):
    call, valid = calls()[name]
    with pytest.raises(ValueError, match=r"\.$") as error:
        call(**{**valid, argument: []})
    assert argument.split("_")[-1] in str(error.value) or "rolling friction" in str(error.value) or name == "ramp"
