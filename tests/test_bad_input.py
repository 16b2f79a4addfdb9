"""Bad arguments of public calls: each ends in a sentence that names the argument, and leaves a good state as it was."""
import functools
import re

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
    "vector": st.one_of(NOT_NUMBERS, NOT_FINITE, st.floats(), st.lists(st.floats(0, 1), min_size=4, max_size=6),
                        st.lists(st.floats(0, 1), max_size=1), NOT_FINITE.map(lambda x: (0.0, x, 0.0))),
    "index": st.one_of(NOT_NUMBERS, NOT_FINITE, st.integers(max_value=-1), st.just(0.5)),
    "object": st.one_of(NOT_NUMBERS, st.floats(), st.just(fe_el.Drag), st.just(fe_el.LinearSpringDashpot), st.none()),
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
             "youngs_modulus": "Young's modulus"}.get(name, name.replace("_", "[ _]"))
    assert re.search(words, said, re.IGNORECASE) and said.endswith(".") and len(said) > 40, said


@MANY
@given(st.sampled_from(CALLS).flatmap(lambda call: st.tuples(st.just(call), BAD[call[2]])))
def test_a_bad_argument_is_refused_by_name_and_the_scene_goes_on(case):
    (call, name, kind), value = case
    if name in ("density", "skin") and value is None or kind == "positions" and isinstance(value, dict):
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
