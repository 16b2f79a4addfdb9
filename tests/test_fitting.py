"""Fluid, particles and forces that fit each other, and steps that do not."""
import warnings

import numpy as np
import pytest

import fe_el

DOWN = (0.0, 0.0, -9.81)


def parts(gravity=DOWN, **kwargs):
    mesh, _ = fe_el.periodic_box((1e-2,) * 3, (3, 3, 3))
    air = fe_el.VolumeAveragedNavierStokes(mesh, None, 1.2, 1.8e-5, gravity, **kwargs)
    beads = fe_el.Particles(mesh, 2500.0, DOWN)
    beads.insert_in_box((0, 0, 0), (1e-2,) * 3, 30, 1e-3, seed=1)
    return air, beads


def test_coupling_takes_from_the_fluid_what_is_its():
    """The same as with all given by hand; of a fluid in several steps their means."""
    mean, found = (0.0, 0.0, 40.0), []
    for steps in (1, 2):
        for by_hand in (False, True):
            air, beads = parts(mean_pressure_gradient=mean)
            fluid = air if steps == 1 else fe_el.SubCycled(air, steps)
            if by_hand:
                kind = {} if steps == 1 else {"mean_velocity": fluid.mean_velocity}
                forces = [fe_el.Drag("beetstra"), fe_el.PressureGradient(mean)]
                pressure = air.pressure if steps == 1 else fluid.mean_pressure
                coupling = fe_el.Coupling(beads, air.velocity, pressure, 1.2, 1.8e-5, forces, **kind)
            else:
                coupling = fe_el.Coupling.of(fluid, beads, [fe_el.Drag("beetstra"), fe_el.PressureGradient()])
            for _ in range(3):
                coupling.to_fluid(1e-4)
                fluid.advance(1e-4, coupling.fields)
                coupling.to_particles(1e-4)
                beads.advance(1e-4)
            found.append(beads.velocity.copy())
    assert np.array_equal(found[0], found[1]) and np.array_equal(found[2], found[3])
    assert np.abs(found[0]).max() > 0


def test_what_contradicts_is_refused():
    air, beads = parts(mean_pressure_gradient=(0.0, 0.0, 40.0))
    gradient = fe_el.PressureGradient((0.0, 0.0, 41.0))
    for words, forces in (("mean pressure gradient", [gradient]), ("without gravity", [fe_el.Buoyancy()]),
                          ("stress_of_mixture", [fe_el.ViscousStress()])):
        with pytest.raises(ValueError, match=words):
            fe_el.Coupling.of(air, beads, [fe_el.Drag("stokes"), *forces])
    with pytest.raises(ValueError, match="Gravity"):
        fe_el.Coupling.of(*other_gravity(), [fe_el.Drag("stokes")])
    with pytest.raises(ValueError, match="meshes"):
        fe_el.Coupling.of(parts()[0], beads, [fe_el.Drag("stokes")])


def other_gravity():
    air, beads = parts()
    air.gravity[:] = 0.0, 0.0, -1.0
    return air, beads


@pytest.mark.parametrize("scheme, dt, words", [("conservative", 1e5, "relaxation times of the fluid"),
                                               ("explicit", 10.0, "unstable beyond 2")])
def test_one_warning_of_a_step_far_beyond_sense(scheme, dt, words):
    """With the number that is exceeded, once; none for a step that makes sense."""
    air, beads = parts()
    coupling = fe_el.Coupling.of(air, beads, [fe_el.Drag("stokes")], scheme=scheme)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        coupling.to_fluid(1e-3)
    coupling = fe_el.Coupling.of(air, beads, [fe_el.Drag("stokes")], scheme=scheme)
    with pytest.warns(RuntimeWarning, match=words):
        coupling.to_fluid(dt)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for _ in range(3):
            coupling.to_fluid(dt)


@pytest.mark.parametrize("dt, sub_cycled, warned", [(2e-3, False, False), (4e-2, False, True), (4e-2, True, False)])
def test_one_warning_of_a_fluid_that_answers_in_one_fast_step(dt, sub_cycled, warned):
    """By its Courant number among the particles, from the second step on; none where the fluid makes smaller steps."""
    air, beads = parts(mean_pressure_gradient=(0.0, 0.0, 40.0))
    air.set_initial_velocity((0.0, 0.0, 1.0))
    fluid = fe_el.SubCycled(air) if sub_cycled else air
    coupling = fe_el.Coupling.of(fluid, beads, [fe_el.Drag("stokes"), fe_el.PressureGradient()])
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", RuntimeWarning)
        for _ in range(3):
            coupling.to_fluid(dt)
            fluid.advance(dt, coupling.fields)
            coupling.to_particles(dt)
    assert [str(m.message).count("Courant number") for m in said if m.category is RuntimeWarning] == [1] * warned
