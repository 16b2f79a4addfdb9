"""No-slip walls of the fluid: forces on walls, moving walls, edges, wall law, refusals."""
import numpy as np
import pytest
from dolfinx import fem
from dolfinx import mesh as dmesh

import fe_el
from fe_el.dolfinx_api import scalar_space, vector_space


def fields_of(mesh, void, drag):
    """Void fraction, drag coefficient and no source."""
    scalar, vector = scalar_space(mesh, "DG", 0), vector_space(mesh, "DG", 0)
    out = fem.Function(scalar), fem.Function(scalar), fem.Function(vector)
    out[0].x.array[:], out[1].x.array[:] = void, drag
    return out


@pytest.mark.ranks
@pytest.mark.parametrize("d, viscosity", [(2, 1e-2), (2, 1.0), (3, 1e-2), (3, 1.0)])
def test_forces_on_walls_balance_momentum_to_round_off(d, viscosity):
    """Resting, moving and slip walls, random drag and sources, from the first step on: what walls receive the fluid
    loses."""
    mesh, tags = fe_el.periodic_box((1.0,) * d, (6,) * d, (True,) + (False,) * (d - 1))
    pull = np.array([2.0] + [0.0] * (d - 1))
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, 1.3, viscosity, tolerance=1e-12, mean_pressure_gradient=pull)
    air.set_no_slip([3] if d == 2 else [3, 6])
    air.set_no_slip(4, velocity=lambda t, x: np.column_stack([np.full(len(x), np.sin(3 * t))] + [0 * x[:, 0]] * (d - 1)))
    if d == 3:
        air.set_slip(5)
    fields = fields_of(mesh, 1.0, 0.0)
    x = air.corner.mean(1)
    drag, source = 50 * np.abs(np.sin(37 * x.sum(1))) ** 5, np.sin(np.outer(x.sum(1), np.arange(11, 11 + d)))
    n, dt = air.num_cells, 0.02
    fields[1].x.array[:n], fields[2].x.array[:n * d] = drag, source.ravel()
    before = air.momentum()
    for _ in range(10):
        air.advance(dt, fields)
        q = air.velocity.x.array.reshape(-1, d)[:n]
        outer = air.comm.allreduce(air.volume @ (source - drag[:, None] * q)) + pull
        walls = sum(sum(air.boundary_force(g)) for g in range(3, 2 * d + 1))
        after = air.momentum()
        assert np.abs((after - before) / dt - outer + walls).max() < 1e-12
        before = after


@pytest.mark.parametrize("void", [1.0, 0.5])
def test_a_moving_wall_beside_beads_moves_the_fluid_with_its_own_speed(void):
    """Couette flow: the velocity of a wall is interstitial, whatever room beads leave; also if it is given as a function."""
    for velocity in ((1.0, 0.0), lambda t, x: (1.0, 0.0), None):
        mesh, tags = fe_el.periodic_box((1.0, 1.0), (4, 10), periodic=(True, False))
        fluid = fe_el.VolumeAveragedNavierStokes(mesh, tags, density=1.0, viscosity=1.0)
        if velocity is None:  # a velocity along a boundary makes it a wall
            fluid.set_velocity(4, (1.0, 0.0))
        else:
            fluid.set_no_slip(4, velocity=velocity)
        fluid.set_no_slip(3)
        fields = fields_of(mesh, void, 0.0)
        for _ in range(100):
            fluid.advance(0.05, fields)
        y, u = fluid.corner.mean(1)[:, 1], fluid.velocity.x.array.reshape(-1, 2)[:, 0]
        assert np.abs(u - y).max() < 1e-6


def test_a_wall_drags_along_what_a_packed_bed_holds_back():
    """Between plates that move through a packed bed at rest the fluid in the core rests, and the force is Brinkman's."""
    beta, mu = 400.0, 1e-3
    mesh, tags = fe_el.periodic_box((1.0, 1.0), (4, 8), periodic=(True, False))
    fluid = fe_el.VolumeAveragedNavierStokes(mesh, tags, density=1.0, viscosity=mu, tolerance=1e-11)
    fluid.set_no_slip([3, 4], velocity=(1.0, 0.0))
    fields = fields_of(mesh, 1.0, beta)
    for _ in range(100):
        fluid.advance(0.01, fields)
    force = fluid.boundary_force(3)[1][0] + fluid.boundary_force(4)[1][0]
    assert force == pytest.approx(-2 * np.sqrt(mu * beta), rel=0.03)
    y, u = fluid.corner.mean(1)[:, 1], fluid.velocity.x.array.reshape(-1, 2)[:, 0]
    assert np.abs(u[np.abs(y - 0.5) < 0.25]).max() < 1e-3


def test_edges_and_corners_of_one_group_hold_in_all_their_directions():
    """A box whose six sides are one wall: two directions at each edge, three at corners, one elsewhere; a cylinder has
    one."""
    mesh, tags = fe_el.box((1.0, 1.0, 1.0), (3, 3, 3))
    one = dmesh.meshtags(mesh, 2, tags.indices, np.ones_like(tags.values))
    air = fe_el.VolumeAveragedNavierStokes(mesh, one)
    air.set_no_slip(1)
    air.advance(0.1)
    sides = ((air.node_position < 1e-9) | (air.node_position > 1 - 1e-9)).sum(1)
    count = np.bincount(air.slip_nodes, minlength=air.nodes)
    assert (count[sides == 1] == 1).all() and (count[sides == 2] == 2).all() and (count[sides == 0] == 0).all()
    assert (air.fixed == (sides == 3)).all()


def test_spalding_is_laminar_near_the_wall_and_logarithmic_far_from_it():
    law = fe_el.Spalding()
    speed = np.array([0.0, 1e-6, 1.0, 20.0])
    coefficient = law(speed, np.array([1e-3, 1e-3, 0.1, 1.0]), 1.2, 1.8e-5)
    assert coefficient[:2] == pytest.approx(1.8e-5 / 1e-3, rel=1e-6)
    friction = np.sqrt(coefficient[2:] * speed[2:] / 1.2)
    plus = friction * np.array([0.1, 1.0]) * 1.2 / 1.8e-5
    assert speed[2:] / friction == pytest.approx(np.log(plus) / 0.4 + 5.5, rel=5e-3)


def test_a_wall_law_raises_the_friction_of_a_layer_that_the_mesh_does_not_resolve():
    """A fast stream over a coarse mesh: the force on the wall is that of the law at the cell's velocity."""
    forces = []
    for law in (None, fe_el.Spalding()):
        mesh, tags = fe_el.periodic_box((1.0, 1.0), (4, 4), periodic=(True, False))
        air = fe_el.VolumeAveragedNavierStokes(mesh, tags, 1.0, 1e-5, tolerance=1e-11)
        air.set_no_slip(3, law=law)
        air.set_slip(4)
        air.set_initial_velocity((1.0, 0.0))
        for _ in range(5):
            air.advance(1e-3)
        forces.append(air.boundary_force(3)[1][0])
    h = 0.25 / 2  # of the triangles behind the wall: half a square's height, crossed diagonals
    expected = fe_el.Spalding()(np.ones(1), np.array([h / 3]), 1.0, 1e-5)[0]
    assert forces == pytest.approx([4 * 1e-5 / h, expected], rel=0.05)


@pytest.mark.ranks
def test_the_last_condition_of_a_group_counts():
    """A second velocity takes the place of the first, a group that became a wall lets nothing in."""
    mesh, tags = fe_el.box((1.0, 1.0), (4, 4))
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags, 1.0, 1e-3, tolerance=1e-10)
    air.set_velocity(1, (0.1, 0.0))
    air.set_pressure((2,), 0.0)
    air.set_slip((3, 4))
    air.set_velocity(1, lambda t, x: np.column_stack([0.3 * np.sqrt(1 - x[:, 0]),
                                                      0 * x[:, 0]]) if (x[:, 0] < 0.5).all() else np.nan)
    air.advance(0.1)
    assert air.momentum()[0] == pytest.approx(0.3, rel=1e-6)
    air.set_slip(1)
    for _ in range(3):
        air.advance(0.1)
    assert abs(air.momentum()[0]) < 1e-8


@pytest.mark.ranks
def test_bad_walls_are_refused_with_a_sentence():
    mesh, tags = fe_el.box((1.0, 1.0), (4, 4))
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags)
    with pytest.raises(ValueError, match="whole number"):
        air.set_no_slip(1.5)
    with pytest.raises(ValueError, match="no boundary group 7"):
        air.set_no_slip((1, 7))
    with pytest.raises(ValueError, match="leads through the wall"):
        air.set_no_slip(1, velocity=(1.0, 0.0))
    with pytest.raises(RuntimeError, match="advance"):
        air.set_no_slip(1)
        air.boundary_force(1)
    for words, make in (("Karman", lambda: fe_el.Spalding(0.0)), ("wall law", lambda: fe_el.Spalding(constant=-1.0))):
        with pytest.raises(ValueError, match=words):
            make()
    inner = dmesh.locate_entities(mesh, 1, lambda x: np.isclose(x[0], 0.5))
    baffle = fe_el.VolumeAveragedNavierStokes(mesh, dmesh.meshtags(mesh, 1, inner, np.full(len(inner), 9, np.int32)))
    with pytest.raises(ValueError, match="between two cells"):
        baffle.set_no_slip(9)
    beads = fe_el.Particles(mesh, 1000.0)
    with pytest.raises(ValueError, match="between two cells"):
        fe_el.Contacts(beads, fe_el.LinearSpringDashpot(100.0, 0.9, 0.1), walls=(baffle.facet_tags, 9))


def test_a_drag_a_little_below_zero_beside_a_wall_does_no_harm():
    """Smoothing leaves such beside a jet: the flow is that of as little drag above zero."""
    mesh, tags = fe_el.box((1.0, 1.0), (4, 4))
    ends = []
    for drag in (1e-12, -1e-12):
        air = fe_el.VolumeAveragedNavierStokes(mesh, tags, 1.0, 1e-2)
        air.set_velocity(1, (1.0, 0.0))
        air.set_pressure(2)
        air.set_no_slip((3, 4))
        fields = fields_of(mesh, 1.0, drag)
        for _ in range(3):
            air.advance(0.1, fields)
        ends.append(air.velocity.x.array.copy())
    assert np.abs(ends[0] - ends[1]).max() < 1e-9


def test_what_takes_one_group_refuses_several():
    mesh, tags = fe_el.box((1.0, 1.0), (3, 3))
    air = fe_el.VolumeAveragedNavierStokes(mesh, tags)
    with pytest.raises(ValueError, match="one group"):
        fe_el.Scalar(air, 1e-3, 0.0).set_value((1, 2), 1.0)
