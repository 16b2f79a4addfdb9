"""Walls that a load drives: a lid of some mass that particles carry."""
import numpy as np
import pytest

import fe_el

D, RHO, K = 2e-3, 2500.0, 2000.0
MASS = RHO * np.pi / 6 * D ** 3


def lidded(lid, positions, restitution=0.3, hold=False, gravity=(0, 0, -9.81), law=None):
    mesh, tags = fe_el.box((0.02, 0.02, 0.02), (2, 2, 2), slices_along=0)  # two scenes are then cut alike
    p = fe_el.Particles(mesh, RHO, gravity)
    p.insert_at(positions, D)
    if hold:
        p.hold()
    law = law or fe_el.LinearSpringDashpot(K, restitution, 0.3)
    return p, fe_el.Contacts(p, law, [fe_el.FacetWalls(tags, (1, 2, 3, 4, 5, 6)), lid])


def lid_of(kind, height):
    if kind == "plane":
        return fe_el.PlaneWall((0, 0, height), (0, 0, -1))
    plate = ([(-1, -1, height), (1, -1, height), (1, 1, height), (-1, 1, height)], [(0, 1, 2), (0, 2, 3)])
    return fe_el.SurfaceWall(plate, point=(0, 0, height), may_be_open=True)


@pytest.mark.ranks
@pytest.mark.parametrize("kind", ["plane", "surface"])
def test_a_lid_comes_to_rest_on_beads_that_carry_its_load(kind):
    """Four beads in the corners, on any number of ranks: each bends as a quarter of the load and its weight ask for."""
    lid, load = lid_of(kind, 2.1e-3), 0.02
    lid.load = (0, 0, -load), 1e-3
    p, c = lidded(lid, [(x, y, 1.001e-3) for x in (0.004, 0.016) for y in (0.004, 0.016)])
    for _ in range(400):
        p.advance(1e-3, c)
    assert lid.force == pytest.approx([0, 0, load], abs=1e-6 * load) and np.abs(lid.velocity).max() < 1e-6
    sink = (load / 4 + MASS * 9.81) / K + load / 4 / K
    assert lid.point[2] == pytest.approx(D - sink, abs=1e-9)
    assert c.walls[0].force[2] == pytest.approx(-load - 4 * MASS * 9.81, rel=1e-5)


def test_a_lid_on_a_spring_swings_at_its_frequency_without_loss():
    """Two contacts in a row, a bead between floor and lid, so light that they are one spring: half the stiffness."""
    lid, heavy = lid_of("plane", D), 0.1
    lid.load = (0, 0, -0.5), heavy
    p, c = lidded(lid, [(0.01, 0.01, D / 2)], 1.0, gravity=(0, 0, 0))
    heights, dt = [], 2e-4
    for _ in range(1200):
        p.advance(dt, c)
        heights.append(lid.point[2])
    heights = np.array(heights)
    amplitude, middle = np.ptp(heights) / 2, 0.5 * (heights.max() + heights.min())
    assert D - middle == pytest.approx(0.5 / (K / 2), rel=0.01) and amplitude == pytest.approx(0.5 / (K / 2), rel=0.01)
    crossing = np.flatnonzero((heights[1:] > middle) & (heights[:-1] <= middle))
    period = np.diff(crossing).mean() * dt
    assert period == pytest.approx(2 * np.pi * np.sqrt(heavy / (K / 2)), rel=0.01)
    assert np.ptp(heights[-320:]) == pytest.approx(np.ptp(heights[:320]), rel=0.02)


def test_a_lid_falls_freely_and_with_a_law_of_arrays():
    lid = lid_of("plane", 0.015)
    lid.load = (0, 0, -0.01), 1e-3
    p, c = lidded(lid, [(0.01, 0.01, D / 2)], law=fe_el.LinearSpringDashpot(K, 0.5, 0.0))
    for _ in range(30):
        p.advance(1e-3, c)
    assert lid.velocity[2] == pytest.approx(-0.3, rel=1e-3) and 0.015 - lid.point[2] == pytest.approx(4.5e-3, rel=0.01)


@pytest.mark.ranks
def test_a_restarted_lid_goes_on(folder):
    def run():
        lid = lid_of("plane", 2.1e-3)
        lid.load = (0, 0, -0.02), 1e-3
        return lidded(lid, [(x, y, 1.001e-3) for x in (0.004, 0.016) for y in (0.004, 0.016)], 0.8)
    whole, again = run(), run()
    for _ in range(20):
        whole[0].advance(1e-3, whole[1])
    fe_el.save_checkpoint(folder + "/a.h5", *whole)
    fe_el.load_checkpoint(folder + "/a.h5", *again)
    for p, c in (whole, again):
        for _ in range(20):
            p.advance(1e-3, c)
    assert np.array_equal(whole[1].walls[1].point, again[1].walls[1].point)
    assert np.array_equal(whole[0].position, again[0].position)


def test_loads_are_checked():
    for load in (1.0, ((0, 0, 0), 1.0), ((0, 0, 1.0), -1.0), ((0, 0, np.nan), 1.0), ((0, 0, 1.0),)):
        lid = lid_of("plane", 0.015)
        lid.load = load
        p, c = lidded(lid, [(0.01, 0.01, D / 2)])
        with pytest.raises(ValueError, match="load|mass"):
            p.advance(1e-4, c)


@pytest.mark.ranks
def test_insertion_without_overlap_minds_planes_cylinders_and_surfaces():
    mesh, _ = fe_el.box((0.02, 0.02, 0.02), (2, 2, 2))
    p = fe_el.Particles(mesh, RHO)
    plate = ([(-1, -1, 0.012), (1, -1, 0.012), (1, 1, 0.012), (-1, 1, 0.012)], [(0, 1, 2), (0, 2, 3)])
    walls = [fe_el.PlaneWall((0, 0, 0.004), (0, 0, 1)), fe_el.CylinderWall((0.01, 0.01, 0), (0, 0, 1), 0.008),
             fe_el.SurfaceWall(plate, may_be_open=True)]
    p.insert_in_box((0, 0, 0), (0.02,) * 3, 60, D, without_overlap=True, walls=walls)
    contacts = fe_el.Contacts(p, fe_el.LinearSpringDashpot(K, 0.5, 0.0), walls)
    p.advance(1e-12, contacts)
    assert p.comm.allreduce(contacts.touching) == 0 and p.total_number == 60
    assert p.comm.allreduce(np.abs(p.contact_force).sum()) == 0
