"""Several steps of the fluid in one exchange: momentum, energy, accuracy, and where particles are mapped."""
from itertools import pairwise

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

import fe_el
from demos.benchmarks import error_against_run_time
from demos.sedimenting_suspension import Suspension
from fe_el.dolfinx_api import scalar_space, vector_space
from fe_el.mesh.cell_mesh import owned_corners

D, RHO_P, MU = 150e-6, 1500.0, 1.8e-5


def suspension(fluid_steps=4, smoothing_length=None, contacts=False, solid=0.1, box=(24, 24, 24), cells=(4, 4, 4), **kwargs):
    return Suspension(D, RHO_P, solid, box, cells, "conservative", "beetstra", "satellite_points", "cell", smoothing_length,
                      1.0,
                      contacts, 1, fluid_steps, "middle", **kwargs)


def relaxation_time(scene):
    return float(fe_el.time_scales.fluid_relaxation_time(D, 1.3, MU, scene.solid))


@pytest.mark.ranks
@pytest.mark.parametrize("dt_star, kwargs", [(0.4, {}), (17.5, {}), (1000.0, {}), (4.0, {"smoothing_length": 3.0}),
                                             (4.0, {"contacts": True, "fluid_steps": 3})])
def test_momentum_is_kept(dt_star, kwargs):
    """Although the void fraction changes from one step of the fluid to the next."""
    scene = suspension(**kwargs)
    dt = dt_star * relaxation_time(scene)
    scene.coupling.to_fluid(dt)
    before, steps = scene.momentum(), 6
    for _ in range(steps):
        scene.advance(dt)
        assert scene.coupling.momentum_imbalance < 1e-12
        assert scene.coupling.solid_volume_error < 1e-12
        assert scene.air.mass_residual() < 1e-6
    assert np.abs(scene.momentum() - before).max() / (scene.weight * steps * dt) < 1e-10
    assert scene.beads.total_number == scene.count


@pytest.mark.ranks
def test_momentum_is_kept_although_the_number_changes():
    """By its Courant number the fluid makes more and more steps, as many on every rank."""
    scene = suspension(None, tolerance=1e-13)
    dt, numbers = 6 * relaxation_time(scene), []
    scene.coupling.to_fluid(dt)
    before = scene.momentum()
    for _ in range(12):
        expected = min(max(np.ceil(scene.air.courant(dt)), 1), scene.fluid.most)
        scene.advance(dt)
        numbers.append(scene.fluid.steps_last)
        assert numbers[-1] == expected == scene.air.comm.allreduce(numbers[-1]) / scene.air.comm.size
        assert scene.coupling.momentum_imbalance < 1e-13
    assert len(set(numbers)) > 2
    assert np.abs(scene.momentum() - before).max() / (scene.weight * 12 * dt) < 1e-14
    counted = scene.fluid.steps_largest, scene.fluid.steps_total, scene.fluid.advances
    assert counted == (max(numbers), sum(numbers), 12) and scene.air.step == sum(numbers)


@pytest.mark.ranks
def test_a_run_from_a_checkpoint_makes_the_same_steps(tmp_path_factory):
    """Alone to the last bit, with the numbers of steps that it would have chosen, and its counts go on."""
    def parts(scene):
        return scene.beads, scene.air, scene.coupling, scene.fluid

    def state(scene):
        return scene.beads.momentum(), scene.mean_slip(), scene.beads.kinetic_energy()
    comm = MPI.COMM_WORLD
    path = str(comm.bcast(tmp_path_factory.mktemp("sub_cycling") if comm.rank == 0 else None)) + "/state.h5"
    whole, rest, numbers = suspension(None), suspension(None), []
    dt = 6 * relaxation_time(whole)
    for k in range(8):
        if k == 4:
            fe_el.save_checkpoint(path, *parts(whole), time=k * dt)
            numbers.append(whole.fluid.steps_total)
        whole.advance(dt)
    fe_el.load_checkpoint(path, *parts(rest))
    assert rest.fluid.steps_total == numbers[0] and rest.fluid.advances == 4
    for _ in range(4):
        rest.advance(dt)
    counts = [[getattr(scene.fluid, name) for name in ("steps_last", "steps_largest", "steps_total", "advances")]
              for scene in (whole, rest)]
    assert counts[0] == counts[1] and counts[0][3] == 8 < counts[0][2]
    for a, b in zip(state(whole), state(rest)):
        assert np.array_equal(a, b) if comm.size == 1 else b == pytest.approx(a, rel=1e-9, abs=1e-20)


@pytest.mark.ranks
@pytest.mark.parametrize("dt_star", [0.1, 10.0, 1000.0])
def test_energy_of_a_closed_system_never_grows(dt_star):
    """No gravity, random velocities of the particles, drag alone."""
    scene = suspension()
    air, beads = scene.air, scene.beads
    air.gravity[:] = air.mean_pressure_gradient[:] = beads.gravity[:] = 0.0
    scene.coupling.pressure_force = None
    beads.velocity[:] = np.random.default_rng(2).normal(size=(scene.count, 3))[beads.id]
    dt = dt_star * relaxation_time(scene)
    scene.coupling.to_fluid(dt)
    energy = [scene.energy()]
    for _ in range(8):
        scene.advance(dt)
        energy.append(scene.energy())
    assert (np.diff(energy) <= 1e-12 * energy[0]).all()


def test_large_steps_are_more_accurate():
    """At eight fluid relaxation times a step: less than half the error, against a step of 0.1."""
    def run(scheme, dt_star):
        return error_against_run_time.slip_history(error_against_run_time.suspension(scheme, (32.0,) * 3, (4,) * 3, 1),
                                                   dt_star, 0.03)
    reference = run("conservative", 0.1)[0]

    def error(scheme):
        history, drift, stable, _ = run(scheme, 8.0)
        exact = np.interp(history[:, 0], reference[:, 0], reference[:, 1])
        assert stable and drift < 1e-10
        return np.sqrt(np.mean((history[1:, 1] / exact[1:] - 1) ** 2))
    plain = error("conservative")
    assert plain < 0.04
    for scheme in ("sub_cycled", "by_courant"):
        assert error(scheme) < min(0.5 * plain, 0.0159)


def test_fixed_fields_give_what_the_fluid_does_alone():
    """With a void fraction that stays, four steps in one are four steps; the means are the means of these."""
    mesh, _ = fe_el.periodic_box((1.0, 1.0), (8, 8))
    flows = [fe_el.VolumeAveragedNavierStokes(mesh, None, 1.0, 1e-2, tolerance=1e-12) for _ in range(2)]
    fields = [fem.Function(scalar_space(mesh, "DG", 0)) for _ in range(2)]
    fields[0].interpolate(lambda x: 0.7 + 0.2 * np.sin(2 * np.pi * x[0]))
    fields[1].interpolate(lambda x: 3.0 * (x[1] > 0.5))
    source = fem.Function(flows[0].velocity.function_space)
    for air in flows:
        air.set_initial_velocity(lambda t, x: np.column_stack([np.sin(2 * np.pi * x[:, 1]), np.cos(2 * np.pi * x[:, 0])]))
    steps = fe_el.SubCycled(flows[0], 4)
    for _ in range(3):
        steps.advance(0.1, (*fields, source))
        velocity, pressure = [], []
        for _ in range(4):
            flows[1].advance(0.025, (*fields, source))
            velocity.append(flows[1].velocity.x.array.copy())
            pressure.append(flows[1].pressure.x.array.copy())
        assert np.abs(flows[0].velocity.x.array - velocity[-1]).max() < 1e-10
        assert np.abs(steps.mean_velocity.x.array - np.mean(velocity, 0)).max() < 1e-10
        assert np.abs(steps.mean_pressure.x.array - np.mean(pressure, 0)).max() < 1e-8
    assert flows[0].time == pytest.approx(0.3)


def test_void_fraction_changes_linearly_over_the_steps(monkeypatch):
    """Of every step but the first, which knows no other: by equal parts from the old one to the new one."""
    mesh, _ = fe_el.periodic_box((1.0, 1.0), (4, 4))
    air, seen = fe_el.VolumeAveragedNavierStokes(mesh, None, 1.2, 1e-3), []
    advance = air.advance

    def watched(dt, fields, share):
        seen.append(fields[0].x.array.copy())
        advance(dt, fields, share)
    monkeypatch.setattr(air, "advance", watched)
    scalar, vector = scalar_space(mesh, "DG", 0), vector_space(mesh, "DG", 0)
    void, drag, source = fem.Function(scalar), fem.Function(scalar), fem.Function(vector)
    steps, ends = fe_el.SubCycled(air, 5), [np.random.default_rng(k).uniform(0.5, 0.9, air.num_cells) for k in range(4)]
    for end in ends:
        end += 0.7 - air.volume @ end / air.volume.sum()  # a closed box holds the same fluid throughout
        void.x.array[:] = end
        steps.advance(0.05, (void, drag, source))
    for k, (old, new) in enumerate(pairwise(ends)):
        expected = [old + part / 5 * (new - old) for part in range(1, 6)]
        assert np.allclose(seen[5 * (k + 1):5 * (k + 2)], expected, rtol=1e-14)


def test_number_of_steps_follows_the_courant_number():
    """A uniform stream at Courant number 3.5: four steps of at most one, also if nothing is said; two of at most two; and
    two where that is the limit."""
    mesh, _ = fe_el.periodic_box((1.0, 1.0), (8, 8))
    air = fe_el.VolumeAveragedNavierStokes(mesh, None, 1.0, 1e-3)
    air.set_initial_velocity((1.0, 0.0))
    fields = [fem.Function(scalar_space(mesh, "DG", 0)) for _ in range(2)]
    fields[0].x.array[:] = 1.0
    dt = 3.5 / air.courant(1.0)
    for kwargs, expected in (({"courant": 1.0}, 4), ({}, 4), ({"courant": 2.0}, 2), ({"most": 2}, 2)):
        steps = fe_el.SubCycled(air, **kwargs)
        steps.advance(dt, (*fields, fem.Function(air.velocity.function_space)))
        assert steps.steps_last == expected


@pytest.mark.ranks
def test_particles_are_mapped_where_they_will_be():
    """Half a step ahead; a particle that would leave the mesh is mapped where it is; none is moved or changes rank."""
    mesh, _ = fe_el.box((4.0, 1.0, 1.0), (4, 1, 1))
    beads = fe_el.Particles(mesh, 1000.0)
    beads.insert_at(np.array([[0.5, 0.3, 0.6], [3.5, 0.3, 0.6]]), 0.01, velocity=(1.0, 0.0, 0.0))
    here = beads.position.copy()
    cell, position = beads.located(2.0)
    assert np.array_equal(beads.position, here)
    expected = here + np.where(here[:, :1] < 1.0, [2.0, 0.0, 0.0], 0.0)
    assert np.abs(position - expected).max(initial=0.0) < 1e-14
    lowest = (beads.cells.barycentric[cell] @ np.column_stack([position, np.ones(len(cell))])[:, :, None]).min(initial=0.0)
    assert lowest > -1e-12
    coupling = fe_el.Coupling(beads, fem.Function(vector_space(mesh, "DG", 0)), None, 1.0, 1e-3,
                              [fe_el.Drag("stokes")], mapping="particle_centred", positions="middle")
    coupling.to_fluid(4.0)
    n = beads.cells.owned
    solid, centre = coupling.solid[:n, 0] * beads.cells.volume[:n], owned_corners(mesh)[0].mean(1)
    where = mesh.comm.allreduce(np.array([solid[(centre[:, 0] > x) & (centre[:, 0] < x + 1)].sum() for x in range(4)]))
    assert where / (np.pi / 6e6) == pytest.approx([0, 0, 1, 1])


def heights(comm, order, steps=40):
    """Heights of beads, by number, after a fall in which half a step ahead is up to a third of a cell."""
    mesh, _ = fe_el.periodic_box((24 * D,) * 3, (4, 4, 4), comm=comm)
    mixture = 0.1 * RHO_P * np.array([0, 0, -9.81])
    air = fe_el.VolumeAveragedNavierStokes(mesh, None, 1.3, MU, tolerance=1e-12, mean_pressure_gradient=-mixture)
    fluid = fe_el.SubCycled(air, 3)
    beads = fe_el.Particles(mesh, RHO_P, (0, 0, -9.81))
    beads.insert_at(np.random.default_rng(3).uniform(0, 24 * D, (900, 3))[order], D, velocity=(0.1, 0.0, -0.5))
    coupling = fe_el.Coupling(beads, air.velocity, fluid.mean_pressure, 1.3, MU,
                              [fe_el.Drag("beetstra"), fe_el.PressureGradient(-mixture)], positions="middle",
                              mean_velocity=fluid.mean_velocity)
    for _ in range(steps):
        coupling.to_fluid(1e-3)
        fluid.advance(1e-3, coupling.fields)
        coupling.to_particles(1e-3)
        beads.advance(1e-3)
    z = np.zeros(900)
    z[order[beads.id]] = beads.position[:, 2]
    return comm.allreduce(z)


@pytest.mark.ranks
def test_result_does_not_depend_on_ranks_or_order():
    alone = heights(MPI.COMM_SELF, np.arange(900))
    together = heights(MPI.COMM_WORLD, np.random.default_rng(5).permutation(900))
    assert np.ptp(alone) > 12 * D
    assert np.abs(alone - together).max() < 1e-10


def test_bad_choices_are_refused():
    mesh, _ = fe_el.periodic_box((1.0, 1.0), (3, 3))
    air = fe_el.VolumeAveragedNavierStokes(mesh)
    for words, kwargs in (("steps= or courant=", {"steps": 2, "courant": 1.0}), ("whole number", {"steps": 0}),
                          ("whole number", {"steps": 1.5}), ("greater than zero", {"courant": 0.0}),
                          ("1 or more", {"courant": 1.0, "most": 0})):
        with pytest.raises(ValueError, match=words):
            fe_el.SubCycled(air, **kwargs)
    with pytest.raises(ValueError, match="start.*middle"):
        fe_el.Coupling(fe_el.Particles(mesh, 1000.0), air.velocity, air.pressure, 1.0, 1e-3, [fe_el.Drag("stokes")],
                       positions="end")
