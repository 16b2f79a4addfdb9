"""Bad arguments of public calls: each ends in a sentence that names the argument, and leaves a good state as it was."""
import functools
import re
import tempfile

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import fe_el

MANY = settings(max_examples=1000, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
NOT_NUMBERS = st.one_of(st.text(max_size=5), st.just("1e-3"), st.just(object()), st.just(dict), st.just({}),
                        st.just([[1.0], [1.0, 2.0]]), st.complex_numbers(allow_nan=False))
NOT_FINITE = st.sampled_from([np.nan, np.inf, -np.inf])
BAD = {
    "positive": st.one_of(NOT_NUMBERS, NOT_FINITE, st.floats(max_value=0.0, allow_nan=False)),
    "not negative": st.one_of(NOT_NUMBERS, NOT_FINITE, st.floats(max_value=-1e-300, allow_nan=False)),
    "up to one": st.one_of(NOT_NUMBERS, NOT_FINITE, st.floats(min_value=1.001, allow_nan=False)),
    "vector": st.one_of(NOT_NUMBERS, NOT_FINITE, st.floats(min_value=1e-9),
                        st.lists(st.floats(0, 1), min_size=4, max_size=6),
                        st.lists(st.floats(0, 1), max_size=1), NOT_FINITE.map(lambda x: (0.0, x, 0.0))),
    "index": st.one_of(NOT_NUMBERS, NOT_FINITE, st.integers(max_value=-1), st.just(0.5)),
    "object": st.one_of(NOT_NUMBERS, st.floats(), st.just(fe_el.Drag), st.just(fe_el.LinearSpringDashpot), st.none()),
    "number": st.one_of(NOT_NUMBERS, NOT_FINITE, st.none(), st.just([1.0, 2.0, 3.0, 4.0])),
    "components": st.one_of(NOT_NUMBERS, NOT_FINITE, st.floats(), st.lists(st.floats(0, 1), min_size=4, max_size=6),
                            st.lists(st.floats(0, 1), max_size=2), NOT_FINITE.map(lambda x: (0.0, x, 0.0))),
    "group": st.one_of(st.just("inlet"), st.just(object()), NOT_FINITE, st.integers(min_value=7), st.integers(max_value=0),
                       st.just(1.5), st.just([]), st.just((1, 99)), st.just(True)),
    "count": st.one_of(NOT_NUMBERS, NOT_FINITE, st.integers(max_value=0), st.just(0.5), st.none(), st.just([2])),
    "below one": st.one_of(NOT_NUMBERS, NOT_FINITE, st.floats(max_value=0.999, allow_nan=False)),
    "function": st.one_of(NOT_NUMBERS.filter(lambda x: not callable(x)), st.floats(), st.just(dict), st.just(fe_el.Drag)),
    "no number": st.one_of(st.just(object()), st.just(dict), st.just([1j]), st.just({"a": object()}),
                           st.complex_numbers(allow_nan=False)),
    "folder": st.one_of(st.floats(), st.integers(), st.none(), st.just({}), st.just([])),
    "positions": st.one_of(NOT_NUMBERS, st.floats(), st.just([]), st.just([(0.1, 0.2, 0.3, 0.4)]), st.just([[0.5]]),
                           NOT_FINITE.map(lambda x: [(0.005, x, 0.005)]), st.just([(9.0, 9.0, 9.0)])),
}


@functools.cache
def scene():
    """Beads in gas in a box, and the same tags of another mesh."""
    mesh, tags = fe_el.box((0.01, 0.01, 0.01), (2, 2, 2))
    beads, air = fe_el.Particles(mesh, 2500.0, (0, 0, -9.81)), fe_el.VolumeAveragedNavierStokes(mesh, tags)
    beads.insert_in_box((1e-3,) * 3, (9e-3,) * 3, 30, 1e-3, without_overlap=True)
    contacts = fe_el.Contacts(beads, fe_el.LinearSpringDashpot(500.0, 0.5, 0.3), (tags, (1, 2, 3, 4, 5, 6)))
    coupling = fe_el.Coupling(beads, air.velocity, air.pressure, 1.2, 1.8e-5, [fe_el.Drag("beetstra")])
    other = fe_el.box((0.01, 0.01, 0.01), (2, 2, 2))
    return mesh, tags, beads, air, contacts, coupling, other


def insert(**change):
    return scene()[2].insert_at(**{"position": [(0.005, 0.005, 0.005)], "diameter": 1e-5, **change})


def insert_box(**change):
    return scene()[2].insert_in_box(**{"lower": (0.004,) * 3, "upper": (0.006,) * 3, "count": 2, "diameter": 1e-5, **change})


def linear(**change):
    return fe_el.LinearSpringDashpot(**{"stiffness": 1.0, "restitution": 0.5, "friction": 0.3, **change})


def hertz(**change):
    return fe_el.HertzMindlin(**{"youngs_modulus": 1e6, "poisson_ratio": 0.3, "restitution": 0.5, "friction": 0.3, **change})


def plane(**change):
    return fe_el.PlaneWall(**{"point": (0, 0, 0), "normal": (0, 0, 1), **change})


def cylinder(**change):
    return fe_el.CylinderWall(**{"point": (0, 0, 0), "axis": (0, 0, 1), "radius": 0.1, **change})


def contacts_of(**change):
    return fe_el.Contacts(**{"particles": scene()[2], "law": linear(), **change})


def inlet(**change):
    return fe_el.Inlet(**{"particles": scene()[2], "facet_tags": scene()[1], "group": 6, "mass_rate": 1.0, "diameter": 1e-4,
                          "velocity": (0, 0, -1), **change})


def coupling_of(**change):
    mesh, _, beads, air, *_ = scene()
    return fe_el.Coupling(**{"particles": beads, "velocity": air.velocity, "pressure": air.pressure, "fluid_density": 1.2,
                             "fluid_viscosity": 1e-5, "forces": [fe_el.PressureGradient()], **change})


def particles(**change):
    return fe_el.Particles(**{"mesh": scene()[0], "density": 1.0, **change})


def fluid(**change):
    return fe_el.VolumeAveragedNavierStokes(**{"mesh": scene()[0], "facet_tags": scene()[1], **change})


@functools.cache
def flow():
    """A fluid to which conditions may be given, and a scalar of one that made a step."""
    moved = fluid()
    moved.advance(1e-4)
    return fluid(), fe_el.Scalar(moved, 1e-5)


def steps_of(**change):
    return fe_el.adaptive_steps(**{"fluid": scene()[3], "end_time": 1.0, "first": 0.1, **change})


def output(**change):
    return fe_el.ParaViewOutput(**{"folder": tempfile.gettempdir(), "particles": scene()[2], **change})


FLUID_CALLS = [
    (fluid, "mesh", "object"), (fluid, "facet_tags", "function"), (fluid, "density", "positive"),
    (fluid, "viscosity", "not negative"), (fluid, "gravity", "components"), (fluid, "tolerance", "positive"),
    (fluid, "mean_pressure_gradient", "components"), (fluid, "turbulence", "function"), (fluid, "stabilisation", "function"),
    (fluid, "time_order", "count"), (lambda velocity: flow()[0].set_velocity(5, velocity), "velocity", "components"),
    (lambda group: flow()[0].set_velocity(group, (0, 0, 1.0)), "group", "group"),
    (lambda pressure: flow()[0].set_pressure(6, pressure), "pressure", "number"),
    (lambda group: flow()[0].set_pressure(group), "group", "group"),
    (lambda group: flow()[0].set_slip(group), "group", "group"),
    (lambda group: flow()[0].set_no_slip(group), "group", "group"),
    (lambda law: flow()[0].set_no_slip(1, law=law), "law", "function"),
    (lambda velocity: flow()[0].set_initial_velocity(velocity), "velocity", "components"),
    (lambda time_step: flow()[0].advance(time_step), "time_step", "positive"),
    (lambda fields: flow()[0].advance(1e-4, fields), "fields", "function"),
    (lambda time_step: flow()[0].courant(time_step), "time_step", "positive"),
    (lambda fluid: fe_el.SubCycled(fluid, 2), "fluid", "object"), (lambda steps: fe_el.SubCycled(flow()[0], steps), "steps",
                                                                   "count"),
    (lambda courant: fe_el.SubCycled(flow()[0], courant=courant), "courant", "positive"),
    (lambda most: fe_el.SubCycled(flow()[0], courant=1.0, most=most), "most", "count"),
    (lambda fluid: fe_el.Scalar(fluid, 1.0), "fluid", "object"),
    (lambda diffusivity: fe_el.Scalar(flow()[0], diffusivity), "diffusivity", "positive"),
    (lambda initial: fe_el.Scalar(flow()[0], 1.0, initial), "initial", "number"),
    (lambda tolerance: fe_el.Scalar(flow()[0], 1.0, tolerance=tolerance), "tolerance", "positive"),
    (lambda scalar: flow()[1].set_value(1, scalar), "scalar", "number"),
    (lambda group: flow()[1].set_value(group, 1.0), "group", "group"),
    (lambda scalar: flow()[1].set_inflow(1, scalar), "scalar", "number"),
    (lambda time_step: flow()[1].advance(time_step), "time_step", "positive"),
    (lambda functions: fe_el.Probe(functions, [(0.005,) * 3]), "functions", "function"),
    (lambda probe: fe_el.Probe([flow()[0].pressure], probe), "probe", "positions"),
    (lambda function: fe_el.TimeAverage(function), "function", "object"),
    (lambda time_step: fe_el.TimeAverage(flow()[0].pressure).add(time_step), "time_step", "positive"),
    (lambda ramp: fe_el.ramp((0, 0, 1.0), ramp), "ramp", "positive"), (steps_of, "fluid", "object"),
    (steps_of, "end_time", "positive"), (steps_of, "courant", "positive"), (steps_of, "growth", "below one"),
    (lambda constant: fe_el.Smagorinsky(constant), "constant", "positive"),
    (lambda constant: fe_el.Vreman(constant), "constant", "positive"),
    (lambda constant: fe_el.Wale(constant), "constant", "positive"),
    (lambda factor: fe_el.Streamline(factor), "factor", "positive"),
    (lambda kappa: fe_el.Spalding(kappa), "kappa", "positive"),
    (lambda constant: fe_el.Spalding(0.4, constant), "constant", "positive"),
    (lambda mean: fe_el.PressureGradient(mean), "mean", "vector"),
    (lambda added_mass: fe_el.AddedMass(added_mass), "added_mass", "not negative"),
    (lambda mesh: fe_el.HelmholtzSmoothing(mesh, 1.0), "mesh", "object"),
    (lambda length: fe_el.HelmholtzSmoothing(scene()[0], length), "length", "positive"),
    (lambda tolerance: fe_el.HelmholtzSmoothing(scene()[0], 1e-3, tolerance), "tolerance", "positive"),
    (lambda mesh: fe_el.PatchAverage(mesh), "mesh", "object"),
    (lambda repeats: fe_el.PatchAverage(scene()[0], repeats), "repeats", "count"),
    (coupling_of, "smoothing", "function"), (coupling_of, "velocity", "object"), (coupling_of, "pressure", "object"),
    (lambda fluid: fe_el.Coupling.of(fluid, scene()[2], []), "fluid", "object"), (inlet, "diameter", "positive"),
    (inlet, "group", "group"), (inlet, "tries", "count"), (inlet, "seed", "index"), (insert_box, "seed", "index"),
    (insert, "displacement", "not negative"), (lambda mask: scene()[2].hold(mask), "mask", "function"),
    (lambda group: scene()[2].remove_at(scene()[1], group), "group", "group"),
    (lambda contact_law: contacts_of(wall_law=contact_law), "contact_law", "function"), (contacts_of, "walls", "function"),
    (lambda lengths: fe_el.box(lengths, (2, 2, 2)), "lengths", "components"),
    (lambda cells: fe_el.box((1.0,) * 3, cells), "cells", "count"),
    (lambda lengths: fe_el.periodic_box(lengths, (3, 3, 3)), "lengths", "components"),
    (lambda dimension: fe_el.read_mesh("meshes/fluidised_bed.msh", dimension=dimension), "dimension", "count"),
    (lambda scale: fe_el.read_mesh("meshes/fluidised_bed.msh", scale=scale), "scale", "positive"),
    (lambda path: fe_el.read_mesh(path), "path", "folder"),
    (lambda size: fe_el.mesh_geo("meshes/cylinder.geo", dimension=2, size=size), "size", "number"),
    (output, "particles", "function"), (output, "fields", "function"), (output, "every", "positive"),
    (output, "folder", "folder"), (output, "contacts", "function"), (lambda time: output().write(time), "time", "number"),
    (lambda folder: fe_el.write_summary(folder), "folder", "folder"),
    (lambda summary: fe_el.write_summary("unused", summary=summary), "summary", "no number"),
    (lambda wall_time: fe_el.StopAndSave(print, wall_time), "wall_time", "positive"),
    (lambda every: fe_el.Checkpoints("unused.h5", scene()[2], every=every), "every", "positive"),
    (lambda end: list(fe_el.time_steps(0.1, end, progress=False)), "end", "number"),
    (lambda contact_time: fe_el.ArrayLaw(print, contact_time), "contact_time", "positive"),
]

CALLS = [
    (particles, "density", "positive"), (particles, "thickness", "positive"), (particles, "gravity", "vector"),
    (particles, "mesh", "object"), (insert, "position", "positions"), (insert, "diameter", "positive"),
    (insert, "density", "positive"), (insert, "velocity", "vector"), (insert, "material", "index"),
    (insert, "coarse_graining", "positive"), (insert_box, "lower", "vector"), (insert_box, "count", "index"),
    (insert_box, "diameter", "positive"), (linear, "stiffness", "positive"), (linear, "restitution", "positive"),
    (linear, "restitution", "up to one"), (linear, "friction", "not negative"), (linear, "surface_energy", "not negative"),
    (linear, "tangential_stiffness_ratio", "up to one"), (linear, "tangential_damping_ratio", "up to one"),
    (hertz, "youngs_modulus", "positive"), (hertz, "poisson_ratio", "up to one"), (hertz, "cohesion", "not negative"),
    (lambda **a: fe_el.RollingFriction(**a), "coefficient", "not negative"), (plane, "point", "vector"),
    (plane, "normal", "vector"), (plane, "velocity", "vector"), (plane, "angular_velocity", "vector"),
    (plane, "material", "index"), (cylinder, "axis", "vector"), (cylinder, "radius", "positive"),
    (contacts_of, "particles", "object"), (contacts_of, "law", "object"), (contacts_of, "steps_per_contact", "positive"),
    (contacts_of, "skin", "positive"), (inlet, "mass_rate", "positive"), (inlet, "velocity", "vector"),
    (inlet, "density", "positive"), (inlet, "particles", "object"), (inlet, "facet_tags", "object"),
    (coupling_of, "particles", "object"), (coupling_of, "fluid_density", "positive"),
    (coupling_of, "fluid_viscosity", "positive"), (coupling_of, "forces", "object"),
    (coupling_of, "largest_solid_fraction", "up to one"),
    (lambda time_step: scene()[2].advance(time_step, scene()[4]), "time_step", "positive"),
    (lambda time_step: scene()[2].advance(time_step), "time_step", "positive"),
    (lambda contacts: scene()[2].advance(1e-4, contacts or 1), "contacts", "object"),
    (lambda time_step: scene()[5].to_fluid(time_step), "time_step", "positive"),
    (lambda time_step: scene()[5].to_particles(time_step), "time_step", "positive"),
    (lambda time_step: list(fe_el.time_steps(time_step, 1.0, progress=False)), "time_step", "positive"),
    (lambda time_step: inlet().advance(time_step), "time_step", "positive"),
]


def refused(call, name, value):
    """The sentence with which a call refuses an argument."""
    with pytest.raises(ValueError) as error:
        call(**{name: value})
    said = str(error.value)
    words = {"count": "number of particles", "coefficient": "rolling friction", "position": "position|particle set",
             "youngs_modulus": "Young's modulus", "functions": "functions? of a probe"}.get(name, name.replace("_", "[ _]"))
    assert re.search(words, said, re.IGNORECASE) and said.endswith(".") and len(said) > 40, said


@MANY
@given(st.sampled_from(CALLS + FLUID_CALLS).flatmap(lambda call: st.tuples(st.just(call), BAD[call[2]])))
def test_a_bad_argument_is_refused_by_name_and_the_scene_goes_on(case):
    (call, name, kind), value = case
    if name in ("density", "skin", "steps") and value is None or kind == "positions" and isinstance(value, dict):
        return
    beads, air, contacts, coupling = scene()[2:6]
    before = beads.position.copy(), len(beads), {k: len(a) for k, a in beads.arrays()[0].items()}
    refused(call, name, value)
    assert np.array_equal(beads.position, before[0]) and set(before[2].values()) == {before[1]}
    assert {len(a) for a in beads.arrays()[0].values()} == {before[1]}
    coupling.to_fluid(1e-6)
    coupling.to_particles(1e-6)
    beads.advance(1e-6, contacts)
    assert np.isfinite(beads.velocity).all()


def test_what_belongs_to_another_mesh_or_other_beads_is_refused():
    mesh, tags, beads, air, contacts, coupling, (other, other_tags) = scene()
    foreign, flow = fe_el.Particles(other, 2500.0), fe_el.VolumeAveragedNavierStokes(other)
    for said, call in (
            ("tags of a wall belong to another mesh", lambda: fe_el.Contacts(beads, linear(), (other_tags, 1))),
            ("another mesh", lambda: coupling_of(velocity=flow.velocity)),
            ("another mesh", lambda: coupling_of(pressure=flow.pressure)),
            ("another mesh", lambda: beads.remove_at(other_tags, 1)),
            ("another mesh", lambda: inlet(facet_tags=other_tags)),
            ("not those of these particles", lambda: foreign.advance(1e-4, contacts)),
            ("Drag more than once", lambda: coupling_of(forces=[fe_el.Drag("beetstra"), fe_el.Drag("tang")])),
            ("pass the mesh itself", lambda: fe_el.Particles((mesh, tags), 2500.0)),
            ("is no force", lambda: coupling_of(forces=[fe_el.Drag])),
            ("is no wall", lambda: contacts_of(walls=[fe_el.PlaneWall])),
            ("to_fluid", lambda: (coupling.to_fluid(1e-4), coupling.to_particles(2e-4))),
            ("to_fluid", lambda: coupling_of().to_particles(1e-4)),
            ("two dimensions", lambda: fe_el.Particles(fe_el.box((1.0, 1.0), (2, 2))[0], 1.0).insert_at(
                [(0.5, 0.5)], 0.1, velocity=(0, 0, 1.0)))):
        with pytest.raises(ValueError, match=said):
            call()
