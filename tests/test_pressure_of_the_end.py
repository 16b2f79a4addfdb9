"""The pressure force of the end of the step: dense suspensions lose energy, momentum is exact, contacts and all."""
import numpy as np
import pytest

import fe_el
from demos.benchmarks.coupled_map import BASE, Box
from demos.sedimenting_suspension import Suspension

D, RHO, MU = 1e-3, 1000.0, 1e-3


def suspension(at_end, **changes):
    """A dense suspension whose particles rush at random, and its energies over twenty steps, over that of the start."""
    scene = Box(**{**BASE, "solid": 0.45, **changes})
    forces = [fe_el.Drag("beetstra"), fe_el.PressureGradient(at_end=at_end)]
    scene.coupling = fe_el.Coupling.of(scene.fluid, scene.beads, forces)
    scene.coupling.to_fluid(scene.dt)
    energy = [scene.energy()]
    for _ in range(20):
        scene.advance()
        energy.append(scene.energy())
    return np.array(energy) / energy[0]


def test_a_dense_suspension_loses_energy_in_long_steps():
    """Where the pressure of the step before lets it grow, that of the end does not; a coupling takes it by itself."""
    assert suspension(False)[1:].max() > 2
    energy = suspension(None)
    assert energy[1:].max() < 0.3 and energy[-1] < 5e-3
    assert suspension(True)[-1] == energy[-1]


def test_in_short_steps_both_agree():
    before, end = (suspension(at_end, dt_star=0.1) for at_end in (False, True))
    assert np.abs(end - before).max() < 3e-3


@pytest.mark.parametrize("dt_star, rise", [(0.1, 1e-12), (1.0, 1e-12), (10.0, 1e-12), (1000.0, 1e-6)])
@pytest.mark.parametrize("density", [1500.0, 13.0, 3.0])
def test_energy_never_grows_with_the_pressure_force(density, dt_star, rise):
    """Both phases at random, without gravity, in gas of 1.3 kg/m^3."""
    d = 150e-6
    scene = Suspension(d, density, 0.1, (24,) * 3, (4,) * 3, "conservative", "beetstra", "overlap_volume", "cell", None, 1.0,
                       False, 1)
    air, beads = scene.air, scene.beads
    air.gravity[:] = air.mean_pressure_gradient[:] = beads.gravity[:] = 0.0
    scene.coupling = fe_el.Coupling.of(air, beads, [fe_el.Drag("beetstra"), fe_el.PressureGradient(at_end=True)])
    beads.velocity[:] = np.random.default_rng(2).normal(size=(scene.count, 3))[beads.id]
    dt = dt_star * float(fe_el.time_scales.fluid_relaxation_time(d, 1.3, 1.8e-5, scene.solid))
    scene.coupling.to_fluid(dt)
    energy = [scene.energy()]
    for _ in range(8):
        scene.advance(dt)
        energy.append(scene.energy())
    assert (np.diff(energy) <= rise * energy[0]).all()


@pytest.mark.parametrize("dt_star, steps", [(0.3, 100), (1.0, 40), (10.0, 20)])
def test_crowded_particles_that_nothing_holds_lose_energy(dt_star, steps):
    """A solid fraction of one half at random places without contacts: the flux of solids makes a larger one of the fluid,
    which with the particles' last way alone grew to 8 to 90 times the start."""
    scene = Box(**{**BASE, "no_contacts": 0.5, "dt_star": dt_star})
    energy = [scene.energy()]
    for _ in range(steps):
        scene.advance()
        energy.append(scene.energy())
        assert scene.coupling.momentum_imbalance < 1e-11
    assert scene.coupling.over_filled > 100 and scene.fluid.mass_residual() < 1e-9
    assert max(energy[1:]) < 0.15 * energy[0] and energy[-1] < 1e-3 * energy[0]


def test_what_particles_answer_fades_in_a_steady_state():
    """Flow through cells of different void fraction and drag, by a mean pressure gradient: the same with and without."""
    mesh, _ = fe_el.periodic_box((8e-3,) * 3, (4, 4, 4))
    coupling = fe_el.Coupling.of(fe_el.VolumeAveragedNavierStokes(mesh), fe_el.Particles(mesh, 2.0),
                                 [fe_el.Drag("stokes"), fe_el.PressureGradient(at_end=True)])
    rng, fields, found = np.random.default_rng(3), coupling.fields, []
    fields[0].x.array[:] = rng.uniform(0.3, 0.7, len(fields[0].x.array))
    fields[1].x.array[:] = rng.uniform(100.0, 1000.0, len(fields[1].x.array))
    for k in (4, 5):
        fields[k].x.array[:] = rng.uniform(0.2, 0.7, len(fields[k].x.array)) * (1.0 if k == 4 else 1e-3)
    for count in (4, 6):
        air = fe_el.VolumeAveragedNavierStokes(mesh, None, 1.2, 1.8e-5, tolerance=1e-11, mean_pressure_gradient=(0, 0, 10.0))
        for _ in range(300):
            air.advance(1e-2, fields[:count])
            assert air.mass_residual() < 1e-8
        found.append(air.velocity.x.array.copy())
    assert np.abs(found[1] - found[0]).max() < 1e-6 * np.abs(found[0]).max()


@pytest.mark.ranks
@pytest.mark.parametrize("smoothing", [None, 2e-3])
def test_momentum_is_exact_with_contacts(smoothing):
    """Fluid and particles keep their sum to round-off in every step, while heavy beads collide in a liquid."""
    mesh, _ = fe_el.periodic_box((8e-3,) * 3, (4, 4, 4))
    water, beads = fe_el.VolumeAveragedNavierStokes(mesh, None, RHO, MU, tolerance=1e-12), fe_el.Particles(mesh, 2.5 * RHO)
    beads.insert_in_box((0, 0, 0), (8e-3,) * 3, 250, D, seed=2, without_overlap=True)
    beads.velocity[:] = 0.2 * np.random.default_rng(1).normal(size=(250, 3))[beads.id]
    contacts = fe_el.Contacts(beads, fe_el.LinearSpringDashpot(stiffness=1000.0, restitution=0.9, friction=0.1))
    coupling = fe_el.Coupling.of(water, beads, [fe_el.Drag("beetstra"), fe_el.PressureGradient()],
                                 smoothing=smoothing and fe_el.HelmholtzSmoothing(mesh, smoothing))
    assert len(coupling.fields) == 6
    coupling.to_fluid(1e-3)
    water.void_fraction = coupling.fields[0].x.array[:water.num_cells].copy()
    before = water.momentum() + beads.momentum()
    size = beads.comm.allreduce(float((beads.mass * np.abs(beads.velocity[:, 0])).sum()))
    touched = 0.0
    for _ in range(12):
        coupling.to_fluid(1e-3)
        water.advance(1e-3, coupling.fields)
        coupling.to_particles(1e-3)
        beads.advance(1e-3, contacts)
        assert coupling.momentum_imbalance < 1e-12
        assert np.abs(water.momentum() + beads.momentum() - before).max() < 1e-12 * size
        touched = max(touched, beads.comm.allreduce(float(np.abs(beads.mean_contact_force).sum())))
    assert touched * 1e-3 > 1e-2 * size


def test_whether_it_is_there():
    """For particles less than a thousand times as dense as the fluid, where fluid and scheme take it; else by name."""
    mesh, _ = fe_el.periodic_box((8e-3,) * 3, (4, 4, 4))
    water = fe_el.VolumeAveragedNavierStokes(mesh, None, RHO, MU)
    forces = [fe_el.Drag("beetstra"), fe_el.PressureGradient()]

    def fields(density, forces=forces, fluid=water, **settings):
        return len(fe_el.Coupling.of(fluid, fe_el.Particles(mesh, density), forces, **settings).fields)
    assert fields(500 * RHO) == 6 and fields(1500 * RHO) == 3
    assert fields(50 * RHO, forces[:1]) == 3 and fields(50 * RHO, [forces[0], fe_el.PressureGradient(at_end=False)]) == 3
    assert fields(50 * RHO, scheme="explicit") == 3 and fields(50 * RHO, fluid=fe_el.SubCycled(water, steps=2)) == 3
    assert fields(1500 * RHO, [fe_el.PressureGradient(at_end=True)]) == 6
    for settings, words in (({"scheme": "explicit"}, "needs scheme='conservative'"),
                            ({"fluid": fe_el.SubCycled(water, steps=2)}, "do not go together")):
        with pytest.raises(ValueError, match="pressure force of the end of the step.* " + words):
            fields(50 * RHO, [forces[0], fe_el.PressureGradient(at_end=True)], **settings)
    with pytest.raises(ValueError, match="at_end is 'yes'"):
        fe_el.PressureGradient(at_end="yes")


def test_light_particles_that_come_later_are_refused():
    mesh, _ = fe_el.periodic_box((8e-3,) * 3, (4, 4, 4))
    water, beads = fe_el.VolumeAveragedNavierStokes(mesh, None, RHO, MU), fe_el.Particles(mesh, 2.5 * RHO)
    coupling = fe_el.Coupling.of(water, beads, [fe_el.Drag("beetstra"), fe_el.PressureGradient()])
    beads.insert_at([(4e-3,) * 3], D, density=0.1 * RHO)
    with pytest.raises(ValueError, match="AddedMass"):
        coupling.to_fluid(1e-3)


def test_a_crowd_that_begins_to_fall_in_water_falls_no_faster_than_freely():
    """In its first step nothing is known of the pressure before: the weight of the water is no change to answer."""
    mesh, _ = fe_el.box((0.01, 0.01, 0.03), (4, 4, 12))
    down = (0.0, 0.0, -9.81)
    water = fe_el.VolumeAveragedNavierStokes(mesh, density=1000.0, viscosity=1e-3, gravity=down)
    beads = fe_el.Particles(mesh, 2500.0, down)
    places = np.stack(np.meshgrid(*[np.arange(n) for n in (10, 10, 20)], indexing="ij"), -1).reshape(-1, 3)
    beads.insert_at(1e-3 * (places + 0.5), 0.98e-3)
    coupling = fe_el.Coupling.of(water, beads, [fe_el.Drag("beetstra"), fe_el.PressureGradient()])
    coupling.to_fluid(1e-3)
    water.advance(1e-3, coupling.fields)
    coupling.to_particles(1e-3)
    beads.advance(1e-3)
    assert len(coupling.fields) == 6
    assert -9.81e-3 * (1 - 1000.0 / 2500.0) < beads.velocity[:, 2].mean() < -0.8 * 9.81e-3 * (1 - 1000.0 / 2500.0)
