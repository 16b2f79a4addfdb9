"""Injectors: rates and balances, places and times, on any number of ranks and through a checkpoint."""
import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

import fe_el
from fe_el.dolfinx_api import scalar_space, vector_space

RHO, D = 2500.0, 20e-6
M = RHO * np.pi / 6 * D ** 3
EQUAL = fe_el.SizeDistribution.listed([5e-6, 20e-6], [1, 1], by="mass")


def box(dimension, comm=MPI.COMM_WORLD):
    mesh, tags = fe_el.box((0.1,) * dimension, (5,) * dimension, comm=comm)
    return fe_el.Particles(mesh, RHO, thickness=0.01 if dimension == 2 else 1.0), tags


def side(dimension):
    return dict(centre=(0, *[0.05] * (dimension - 1)), normal=(1, *[0] * (dimension - 1)), diameter=0.02)


@pytest.mark.ranks
@pytest.mark.parametrize("dimension", [2, 3])
def test_what_comes_in_is_held_or_left(dimension, folder):
    """Two injectors, one of parcels of equal mass and one that is switched; mass and numbers balance to round-off, on all
    ranks as on one, and with a checkpoint in between."""
    ahead, balances = (1.0, *[0.0] * (dimension - 1)), []
    for comm, breaks in ((MPI.COMM_SELF, False), (MPI.COMM_WORLD, False), (MPI.COMM_WORLD, True)):
        def scene(comm=comm):
            p, tags = box(dimension, comm)
            p.remove_at(tags, 2)
            first = fe_el.Injector(p, fe_el.DiscSource(**side(dimension)), ahead, EQUAL, mass_rate=1e-3, seed=1,
                                   number=lambda d: 2e-8 / d ** 3 / RHO)
            second = fe_el.Injector(p, fe_el.FacetSource(tags, 1), ahead, D, seed=2, coarse_graining=20.0,
                                    number_rate=lambda t: 3e8 if t < 0.11 else 0.0)
            return p, first, second
        p, first, second = scene()
        for k in range(100):
            if k == 57 and breaks:
                fe_el.save_checkpoint(folder + "/state.h5", p, first, second)
                p, first, second = scene()
                fe_el.load_checkpoint(folder + "/state.h5", p, first, second)
            first.advance(2e-3)
            second.advance(2e-3)
            p.advance(2e-3)
        mass = p.comm.allreduce(p.mass.sum()) + p.left_mass
        assert mass == pytest.approx(first.mass + second.mass, rel=1e-13)
        assert first.mass + first.waiting == pytest.approx(1e-3 * 0.2, rel=1e-13)
        assert second.number + second.waiting == pytest.approx(3e8 * 0.11, rel=1e-12)
        assert p.total_number + p.left == first.parcels + second.parcels and p.left > 1000
        x = np.zeros((p.next_id, 5))
        x[p.id] = np.column_stack([p.position, p.diameter, p.number])
        balances.append(p.comm.allreduce(x))
    assert np.array_equal(balances[0], balances[1]) and np.array_equal(balances[0], balances[2])


def test_a_jet_has_no_pulses_of_the_steps_length():
    """Distances along a jet of points are those of the rate, not of the step."""
    p, _ = box(3)
    jet = fe_el.Injector(p, fe_el.PointSource([(0.01, 0.05, 0.05)]), (1.0, 0, 0), D, number_rate=1050.0)
    for _ in range(8):
        jet.advance(1e-2)
        p.advance(1e-2)
    x = np.sort(p.position[:, 0])
    assert len(x) == 84 and np.diff(x) == pytest.approx(1 / 1050, rel=1e-9)
    assert x.max() == pytest.approx(0.01 + 0.08 - 1 / 1050, rel=1e-9) and not p.properties


@pytest.mark.parametrize("parts", [1, 7])
def test_what_comes_in_does_not_depend_on_the_step(parts):
    """The same parcels at the same places after one step or several, with a rate that is ramped."""
    found = []
    for steps in (8 * parts, 1):
        p, _ = box(3)
        jet = fe_el.Injector(p, fe_el.DiscSource(**side(3)), (1.0, 0, 0), EQUAL, mass_rate=lambda t: 2e-3 * t, number=1e4,
                             seed=3)
        for _ in range(steps):
            jet.advance(0.08 / steps)
            p.advance(0.08 / steps)
        assert jet.mass + jet.waiting == pytest.approx(1e-3 * 0.08 ** 2, rel=1e-12)
        order = np.argsort(p.id)
        found.append((p.diameter[order], p.position[order, 0]))
    assert len(found[0][0]) > 100 and np.array_equal(found[0][0], found[1][0])
    assert np.abs(found[0][1] - found[1][1]).max() < 0.006  # the rate of an eighth of a step is that of its middle


def test_places_lie_on_their_source():
    """Uniform over a disc, its normal turned, over facets, and taking turns at points."""
    p, tags = box(3)
    n = np.array([1.0, 2.0, 2.0]) / 3
    jet = fe_el.Injector(p, fe_el.DiscSource((0.05, 0.05, 0.05), n, 0.02), tuple(n), D, number_rate=4e3)
    jet.advance(1.0)
    x = p.position - 0.05
    r = np.linalg.norm(x, axis=1)
    assert np.abs(x @ n).max() < 1e-9 and r.max() < 0.01 and (r < 0.01 / 2 ** 0.5).mean() == pytest.approx(0.5, abs=0.03)
    assert np.abs(x.mean(0)).max() < 3e-4
    p, tags = box(3)
    jet = fe_el.Injector(p, fe_el.FacetSource(tags, 6), (0, 0, -1.0), D, number_rate=4e3)
    jet.advance(1.0)
    assert np.abs(p.position[:, 2] - 0.1).max() < 1e-9 and (p.velocity[:, 2] == -1).all()
    assert np.histogram2d(*p.position[:, :2].T, bins=4, range=[(0, 0.1)] * 2)[0] == pytest.approx(250, abs=60)
    p, _ = box(2)
    fe_el.Injector(p, fe_el.PointSource([(0.02, 0.05), (0.03, 0.05)]), (0, 1.0), D, number_rate=11.0).advance(1.0)
    assert p.position[np.argsort(p.id), 0] == pytest.approx([0.02, 0.03] * 5 + [0.02])


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_velocity_profile_gives_a_uniform_concentration(dimension):
    """A parabola over a disc: more comes in where it is fast, and the mean square of the radius is that of the flux."""
    p, _ = box(dimension)

    def parabola(time, x):
        v = np.zeros((len(x), 3))
        v[:, 0] = 1 - ((x[:, 1:dimension] - 0.05) ** 2).sum(1) / 0.01 ** 2
        return v
    jet = fe_el.Injector(p, fe_el.DiscSource(**side(dimension)), parabola, D, number_rate=2e4)
    jet.advance(1.0)
    square = ((p.position[:, 1:dimension] - 0.05) ** 2).sum(1).mean() / 0.01 ** 2
    assert len(p) == 20000 and square == pytest.approx({2: 1 / 5, 3: 1 / 3}[dimension], rel=0.02)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_loading_is_that_of_the_fluid_through_the_source(dimension):
    """A plug and a parabola of fluid through a disc, and through facets."""
    area = {2: 0.02 * 0.01, 3: np.pi * 0.01 ** 2}[dimension]
    for velocity, mean in (((3.0, *[0.0] * (dimension - 1)), 3.0), (lambda t, x: np.column_stack(
            [t * (1 - ((x[:, 1:] - 0.05 * (np.arange(2) < dimension - 1)) ** 2).sum(1) / 0.01 ** 2), 0 * x[:, 1:]]),
            {2: 2 / 3, 3: 1 / 2}[dimension])):
        p, tags = box(dimension)
        jet = fe_el.Injector(p, fe_el.DiscSource(**side(dimension)), (1.0, *[0.0] * (dimension - 1)), D, loading=20.8,
                             fluid=(1.1, velocity), number=1e4)
        jet.time = 1.0
        jet.advance(1e-3)
        factor = 1.0 if not callable(velocity) else 1.0005
        assert jet.mass + jet.waiting == pytest.approx(20.8 * 1.1 * mean * factor * area * 1e-3, rel=1e-4)
    p, tags = box(dimension)
    jet = fe_el.Injector(p, fe_el.FacetSource(tags, 1), (1.0, *[0.0] * (dimension - 1)), D, loading=0.5, number=1e4,
                         fluid=(1.1, (2.0, *[0.0] * (dimension - 1))))
    jet.advance(1e-3)
    assert jet.mass + jet.waiting == pytest.approx(0.5 * 1.1 * 2 * 0.1 * {2: 0.01, 3: 0.1}[dimension] * 1e-3, rel=1e-12)


@pytest.mark.ranks
def test_momentum_is_exact_in_the_step_in_which_parcels_come():
    """Fluid and parcels exchange what the ledger says, parts of steps and all, with contacts or without, in gas and in a
    liquid, whose pressure is that of the end of the step."""
    for contact, density in ((False, 1.1), (True, 1.1), (False, 500.0), (True, 500.0)):
        p, tags = box(3)
        air = fe_el.VolumeAveragedNavierStokes(p.mesh, tags, density, 1.9e-5)
        air.set_velocity(1, (1.0, 0, 0))
        air.set_pressure(2)
        jet = fe_el.Injector(p, fe_el.DiscSource((0.05, 0.05, 0.0), (0, 0, 1), 0.02), (0, 0, 2.0), D, mass_rate=1e-4,
                             number=1e3)
        contacts = fe_el.Contacts(p, fe_el.LinearSpringDashpot(1e-3, 0.9, 0.1), steps_per_contact=12) if contact else None
        for scheme in ("conservative", "explicit") if density < 2 else ("conservative",):
            coupling = fe_el.Coupling.of(air, p, [fe_el.Drag("schiller_naumann"), fe_el.PressureGradient(),
                                                  fe_el.SaffmanLift()], scheme=scheme)
            for _ in range(3):
                jet.advance(2e-3)
                before = p.momentum()
                coupling.to_fluid(2e-3)
                air.advance(2e-3, coupling.fields)
                coupling.to_particles(2e-3)
                given = p.comm.allreduce(p.force.sum(0))
                assert coupling.momentum_imbalance < 1e-10
                p.advance(2e-3, contacts)
                assert p.momentum() - before == pytest.approx(2e-3 * given, rel=1e-9)
        assert p.total_number > 20


class Constant:
    """A force of the open list, the same per volume everywhere."""

    needs = ()

    def force(self, fluid):
        """50 N/m^3 along x."""
        return 50.0 * fluid.volume[:, None] * np.eye(fluid.particles.mesh.topology.dim)[0]


def by_id(p, values):
    out = np.zeros(p.next_id)
    out[p.id] = values
    return p.comm.allreduce(out)


@pytest.mark.ranks
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("smoothed", [False, True])
def test_forces_act_on_late_parcels_for_as_long_as_they_are_there(dimension, smoothed):
    """Pressure and a force of the open list along a linear pressure; what is taken back from parcels the fluid receives."""
    p, _ = box(dimension)
    velocity, pressure = (vector_space(p.mesh, "DG", 0), scalar_space(p.mesh, "P", 1))
    velocity, pressure = fem.Function(velocity), fem.Function(pressure)
    pressure.interpolate(lambda x: -300.0 * x[0])
    middle = (0.03, *[0.05] * (dimension - 1))
    jet = fe_el.Injector(p, fe_el.PointSource([middle]), (0.0,) * dimension, 3e-3, number_rate=500.0)
    smoothing = fe_el.HelmholtzSmoothing(p.mesh, 0.01) if smoothed else None
    coupling = fe_el.Coupling(p, velocity, pressure, 1.2, 1.8e-5, [fe_el.PressureGradient(), Constant()],
                              smoothing=smoothing)
    for _ in range(2):
        jet.advance(0.01)
        coupling.to_fluid(0.01)
        coupling.to_particles(0.01)
        late, old = np.zeros(len(p)), p.velocity[:, 0].copy()
        late[:len(p.late)] = p.late
        source = coupling.fields[2].x.array.reshape(-1, dimension)[:p.cells.owned, 0] @ p.cells.volume[:p.cells.owned]
        of_parcels = (p.volume * (300.0 * late - 50.0 * (1 - late))).sum()
        assert p.comm.allreduce(source) == pytest.approx(p.comm.allreduce(of_parcels), rel=1e-11)
        assert p.comm.allreduce(float(late.sum())) > 1 and coupling.momentum_imbalance < 1e-12
        expected = by_id(p, old + (1 - late) * 0.01 * 350.0 / RHO)
        p.advance(0.01)
        assert by_id(p, p.velocity[:, 0]) == pytest.approx(expected, rel=1e-11)
    assert p.total_number == 10


@pytest.mark.ranks
@pytest.mark.parametrize("at_end", [False, True])
def test_the_fluid_keeps_the_mean_gradient_on_parcels_that_are_not_there_yet(at_end):
    """Its void fraction leaves out their volume from the start of the step; at rest nothing else acts."""
    p, _ = box(3)
    velocity, pressure = fem.Function(vector_space(p.mesh, "DG", 0)), fem.Function(scalar_space(p.mesh, "P", 1))
    jet = fe_el.Injector(p, fe_el.PointSource([(0.03, 0.05, 0.05)]), (0.0, 0, 0), 1e-3, number_rate=500.0)
    coupling = fe_el.Coupling(p, velocity, pressure, 1.2, 1.8e-5, [fe_el.PressureGradient((100.0, 0, 0), at_end)])
    jet.advance(0.01)
    late = p.comm.allreduce(float(p.volume @ p.late) if len(p.late) else 0.0)
    coupling.to_fluid(0.01)
    coupling.to_particles(0.01)
    source = coupling.fields[2].x.array.reshape(-1, 3)[:p.cells.owned, 0] @ p.cells.volume[:p.cells.owned]
    assert late > 0 and p.comm.allreduce(source) == pytest.approx(100.0 * late, rel=1e-10)


@pytest.mark.parametrize("by", ["buoyancy", "pressure with added mass"])
def test_parcels_as_dense_as_the_liquid_come_in_at_rest_and_stay(by):
    """Gravity and what carries it act for the same part of the step."""
    mesh, _ = fe_el.box((0.1,) * 3, (3,) * 3)
    p = fe_el.Particles(mesh, 1000.0, gravity=(0, 0, -9.81))
    velocity, pressure = fem.Function(vector_space(mesh, "DG", 0)), fem.Function(scalar_space(mesh, "P", 1))
    pressure.interpolate(lambda x: -9810.0 * x[2])
    forces = [fe_el.Buoyancy()] if by == "buoyancy" else [fe_el.PressureGradient(), fe_el.AddedMass()]
    coupling = fe_el.Coupling(p, velocity, pressure, 1000.0, 1e-3, [fe_el.Drag("schiller_naumann"), *forces])
    jet = fe_el.Injector(p, fe_el.PointSource([(0.05,) * 3]), (0.0, 0, 0), 1e-3, number_rate=500.0)
    for _ in range(3):
        jet.advance(0.01)
        coupling.to_fluid(0.01)
        coupling.to_particles(0.01)
        p.advance(0.01)
    assert len(p) == 15 and np.abs(p.velocity).max() < 1e-12


def test_late_parcels_turn_for_as_long_as_they_are_there():
    """Torque in a fluid that turns as one, from its own time in the step on, with the exact relaxation over that part."""
    p, _ = box(3)
    velocity = fem.Function(vector_space(p.mesh, "DG", 0))
    velocity.interpolate(lambda x: np.array([-4.0 * x[1], 4.0 * x[0], 0 * x[0]]))
    coupling = fe_el.Coupling(p, velocity, None, 1.2, 1.8e-5, [fe_el.Torque()])
    jet = fe_el.Injector(p, fe_el.PointSource([(0.05,) * 3]), (0.0, 0, 0), 1e-4, number_rate=1e4)
    jet.advance(1e-3)
    coupling.to_fluid(1e-3)
    coupling.to_particles(1e-3)
    rate, late = 60 * 1.8e-5 / (RHO * 1e-8), p.late.copy()
    assert p.angular_velocity[:, 2] == pytest.approx(-4.0 * np.expm1(-rate * (1 - late) * 1e-3), rel=1e-6)
    assert np.ptp(late) > 0.8


@pytest.mark.parametrize("change, words", [
    ({"mass_rate": 1.0, "number_rate": 1.0}, "has 2 rates"), ({}, "has 0 rates"),
    ({"mass_rate": -1.0}, "rate of an injector at time 0 s is -1"), ({"loading": 1.0}, "needs fluid="),
    ({"mass_rate": 1.0, "velocity": (-1.0, 0, 0)}, "leads out"), ({"mass_rate": 1.0, "diameter": -1.0}, "diameter"),
    ({"mass_rate": 1.0, "velocity": lambda t, x: x[0, 0]}, "has shape"), ({"mass_rate": 1.0, "number": 0.0}, "in a parcel"),
    ({"mass_rate": 1.0, "number": 2.0, "coarse_graining": 2.0}, "give one of them"),
    ({"loading": 1.0, "fluid": (1.0, (1.0, 0, 0)), "source": fe_el.PointSource([(0.05,) * 3])}, "which points do not"),
    ({"mass_rate": 1.0, "source": (0, 0, 0)}, "FacetSource or DiscSource or PointSource")])
def test_bad_injectors_are_refused(change, words):
    p, _ = box(3)
    arguments = {"source": fe_el.DiscSource(**side(3)), "velocity": (1.0, 0, 0), "diameter": D, **change}
    with pytest.raises(ValueError, match=words):
        fe_el.Injector(p, arguments.pop("source"), arguments.pop("velocity"), arguments.pop("diameter"), **arguments)


def test_too_much_at_once_is_refused():
    p, _ = box(3)
    jet = fe_el.Injector(p, fe_el.DiscSource(**side(3)), (1.0, 0, 0), D, mass_rate=1.0)
    with pytest.raises(ValueError, match="parcels in one step; let parcels stand for more"):
        jet.advance(1.0)
