"""What is changed between two steps counts from the next one on, or is refused."""
import numpy as np
import pytest

import fe_el

LAW = fe_el.LinearSpringDashpot(5000.0, 0.9, 0.1)
D = 4e-3
MASS = 2500 * np.pi / 6 * D ** 3


def one_bead(position, walls, law=LAW, gravity=(0, 0, 0), **kind):
    mesh, tags = fe_el.box((0.05, 0.05, 0.05), (4, 4, 4))
    p = fe_el.Particles(mesh, 2500.0, gravity)
    p.insert_at([position], D, **kind)
    return p, fe_el.Contacts(p, law, [fe_el.FacetWalls(tags, 5)] if walls is None else walls)


def advance(p, c, dt, steps):
    for _ in range(steps):
        p.advance(dt, c)
    return p.velocity[0]


def test_a_plate_that_starts_to_rise_throws_a_bead():
    plate = fe_el.PlaneWall((0, 0, 0.01), (0, 0, 1))
    p, c = one_bead((0.025, 0.025, 0.0121), [plate])
    advance(p, c, 1e-4, 1)
    plate.velocity = np.array([0.0, 0.0, 0.1])
    assert advance(p, c, 1e-4, 100)[2] == pytest.approx(0.19, rel=1e-2)
    assert plate.point == pytest.approx((0, 0, 0.011))
    plate.velocity[2] = 0.0  # in place as well
    advance(p, c, 1e-4, 10)
    assert plate.point == pytest.approx((0, 0, 0.011))


def test_a_belt_that_starts_to_run_carries_a_bead():
    p, c = one_bead((0.025, 0.025, D / 2 - 1e-7), None, fe_el.LinearSpringDashpot(5000.0, 0.5, 0.5), (0, 0, -9.81))
    advance(p, c, 1e-3, 20)
    c.walls[0].velocity = (0.1, 0.0, 0.0)
    assert advance(p, c, 1e-3, 50)[0] == pytest.approx(0.2 / 7, rel=1e-3)
    c.walls[0].velocity = (0.1, np.nan, 0.0)
    with pytest.raises(ValueError, match="velocity .*nan.*finite"):
        p.advance(1e-3, c)


def test_a_vibrating_plate_renews_the_lists_seldom():
    plate = fe_el.PlaneWall((0, 0, 0.01), (0, 0, 1))
    p, c = one_bead((0.025, 0.025, 0.02), [plate])
    for k in range(400):
        plate.velocity = (0, 0, 0.05 * np.cos(2 * np.pi * k / 100))
        p.advance(1e-4, c)
    assert c.rebuilds < 40 and plate.point[2] == pytest.approx(0.01, abs=1e-6)


def test_a_wall_that_is_put_elsewhere_is_met_there():
    plate = fe_el.PlaneWall((0, 0, 0.01), (0, 0, 1))
    p, c = one_bead((0.025, 0.025, 0.03), [plate], velocity=(0, 0, -0.1))
    advance(p, c, 1e-4, 3)
    plate.point = (0, 0, 0.03 - D / 2 - 3e-4)
    assert advance(p, c, 1e-4, 60)[2] == pytest.approx(0.09, rel=1e-2)
    plate.normal, plate.point = (0, 0, -1), (0, 0, p.position[0, 2] + D / 2 + 1e-4)  # now above
    assert advance(p, c, 1e-4, 60)[2] == pytest.approx(-0.081, rel=1e-2)


@pytest.mark.parametrize("rest", [0.5, 1.0])
def test_walls_come_and_go_and_the_others_keep_their_springs(rest):
    """A bead rests on a slope of friction; a wall is added and another removed: it does not slip, then falls."""
    slope = 0.1
    floor = fe_el.PlaneWall((0, 0, 0.01), (0, 0, 1))
    law = fe_el.LinearSpringDashpot(5000.0, rest / 2, 0.5, rolling=fe_el.RollingFriction(0.5, True))
    p, c = one_bead((0.025, 0.025, 0.01 + D / 2 - 1e-6), [fe_el.PlaneWall((0, 0, 0), (0, 0, 1)), floor], law,
                    (9.81 * slope, 0, -9.81))
    advance(p, c, 1e-3, 200)
    held, spring = p.position[0, 0], c.lists.shapes.spring[c.lists.shapes.wall == 1]
    c.walls.append(fe_el.PlaneWall((0.04, 0, 0), (-1, 0, 0)))
    del c.walls[0]
    advance(p, c, 1e-3, 1)
    assert c.lists.shapes.spring[c.lists.shapes.wall == 0] == pytest.approx(spring, rel=1e-3, abs=1e-10)
    advance(p, c, 1e-3, 100)
    assert p.position[0, 0] == pytest.approx(held, abs=1e-8)
    c.walls.remove(floor)
    assert advance(p, c, 1e-4, 10)[2] == pytest.approx(-9.81e-3, rel=0.05)


def test_facet_walls_come_and_go():
    p, c = one_bead((0.025, 0.025, D / 2 - 1e-7), None, gravity=(0, 0, -9.81))
    tags, floor = c.walls[0].facet_tags, c.walls[0]
    advance(p, c, 1e-3, 20)
    before = p.position.copy()
    c.walls[:] = [fe_el.FacetWalls(tags, 1), floor]
    advance(p, c, 1e-3, 20)
    assert p.position == pytest.approx(before, abs=1e-7) and c.touching == 1
    c.walls.append("lid")
    with pytest.raises(ValueError, match="'lid' is no wall"):
        p.advance(1e-3, c)


def test_diameter_density_and_material_are_taken_up():
    """Two beads that grow into each other part; twice the density is half the speed."""
    mesh, _ = fe_el.box((0.05, 0.05, 0.05), (4, 4, 4))
    speeds = []
    for density in (2500.0, 5000.0):
        p = fe_el.Particles(mesh, 2500.0)
        p.insert_at([(0.02, 0.025, 0.025), (0.025, 0.025, 0.025)], D)
        c = fe_el.Contacts(p, fe_el.LinearSpringDashpot(5000.0, 1.0, 0.0))
        p.advance(1e-4, c)
        assert not p.velocity.any()
        p.diameter[:], p.density[:] = 1.3 * D, density
        for _ in range(40):
            p.advance(1e-4, c)
        speeds.append(np.abs(p.velocity[:, 0]))
        stored = 0.25 * 5000.0 * (1.3 * D - 0.005) ** 2
        assert speeds[-1] == pytest.approx(np.sqrt(2 * stored / p.mass), rel=1e-3)
    p.material[:] = 1
    with pytest.raises(ValueError, match="material 1"):
        p.advance(1e-4, c)


@pytest.mark.parametrize("name,value", [("diameter", np.array([-1e-3])), ("density", np.array([np.nan])), ("diameter", 1e-3),
                                        ("velocity", np.zeros(3)), ("position", np.zeros((1, 2))),
                                        ("position", np.full((1, 3), np.nan)), ("force", np.zeros((2, 3)))])
def test_arrays_that_cannot_be_are_refused_by_name(name, value):
    p, c = one_bead((0.025, 0.025, 0.02), None)
    for contacts in (c, None):
        p.advance(1e-4, contacts)
        kept = getattr(p, name)
        setattr(p, name, value)
        with pytest.raises(ValueError, match=name):
            p.advance(1e-4, contacts)
        setattr(p, name, kept)
        p.advance(1e-4, contacts)


def test_a_bead_that_is_put_elsewhere_meets_what_is_there():
    mesh, _ = fe_el.box((0.05, 0.05, 0.05), (4, 4, 4))
    p = fe_el.Particles(mesh, 2500.0)
    p.insert_at([(0.01, 0.025, 0.025), (0.04, 0.025, 0.025)], D, velocity=[(0.1, 0, 0), (0, 0, 0)])
    c = fe_el.Contacts(p, fe_el.LinearSpringDashpot(5000.0, 1.0, 0.0))
    p.advance(1e-4, c)
    p.position[p.velocity[:, 0] > 0] = (0.04 - D - 1e-5, 0.025, 0.025)
    for _ in range(40):
        p.advance(1e-4, c)
    assert np.sort(p.velocity[:, 0]) == pytest.approx([0, 0.1], abs=1e-3)


def test_another_law_counts_for_pairs_and_walls():
    p, c = one_bead((0.025, 0.025, D / 2 + 1e-4), None, velocity=(0, 0, -0.2))
    advance(p, c, 1e-5, 3)
    c.law = fe_el.LinearSpringDashpot(5000.0, 0.3, 0.1)
    assert advance(p, c, 1e-4, 30)[2] == pytest.approx(0.06, rel=0.03)
    c.law = fe_el.LinearSpringDashpot(5000.0, 0.3, 0.1, rolling=fe_el.RollingFriction(0.1))
    with pytest.raises(ValueError, match="rolling friction"):
        p.advance(1e-4, c)
    with pytest.raises(AttributeError, match="new law"):
        c.law.restitution = 0.5
