"""Walls from surfaces of triangles that need not be facets of the mesh: read, checked, moved; force and torque on walls."""
import numpy as np
import pytest
from mpi4py import MPI

import fe_el

D, RHO, K = 2e-3, 2500.0, 2000.0
MASS = RHO * np.pi / 6 * D ** 3
LAW = fe_el.LinearSpringDashpot(K, 0.6, 0.4)


def box_surface(lower, upper):
    """Points and triangles of a closed box."""
    points = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * (np.subtract(upper, lower)) + lower
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return points, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def stl(path, points, triangles):
    """Write an STL file, each triangle with vertices of its own."""
    with open(path, "w") as file:
        file.write("solid s\n")
        for t in np.asarray(points)[np.asarray(triangles)]:
            corners = "".join("vertex {:.9g} {:.9g} {:.9g}\n".format(*x) for x in t)
            file.write(f"facet normal 0 0 0\nouter loop\n{corners}endloop\nendfacet\n")
        file.write("endsolid s\n")
    return str(path)


def scene(positions, walls, gravity=(0, 0, -9.81), law=LAW, **kind):
    mesh, tags = fe_el.box((0.03, 0.03, 0.03), (3, 3, 3), slices_along=0)  # two scenes are then cut alike
    p = fe_el.Particles(mesh, RHO, gravity)
    p.insert_at(positions, D, **kind)
    walls = walls(tags) if callable(walls) else walls
    return p, fe_el.Contacts(p, law, walls)


@pytest.mark.ranks
def test_a_bead_rests_on_a_box_from_a_file(folder):
    """In the middle of a face of two triangles, on a step inside the mesh; the wall carries its weight where it lies."""
    path = folder + "/step.stl"
    if MPI.COMM_WORLD.rank == 0:
        stl(path, *[a if k else 1000 * a for k, a in enumerate(box_surface((5e-3, 5e-3, 5e-3), (25e-3, 25e-3, 10e-3)))])
    MPI.COMM_WORLD.barrier()
    step = fe_el.SurfaceWall(path, scale=1e-3)
    assert step.open_edges == 0 and len(step.vertex) == 12
    p, c = scene([(0.015, 0.012, 0.0115)], [step])
    for _ in range(60):
        p.advance(5e-3, c)
    height = p.comm.allreduce(p.position[:, 2].sum())
    assert height == pytest.approx(0.010 + D / 2 - MASS * 9.81 / K, abs=1e-10)
    assert step.force == pytest.approx([0, 0, -MASS * 9.81], abs=1e-9 * MASS)
    assert step.torque == pytest.approx(np.cross((0.015, 0.012, 0.010), step.force), abs=1e-10 * MASS)


def test_force_and_torque_of_every_kind_of_wall_are_those_of_the_particles():
    """What walls get is the momentum, and the angular momentum about their point, that particles lose."""
    def walls(tags):
        return [fe_el.FacetWalls(tags, (5, 6), point=(0.01, 0.0, 0.003)), fe_el.PlaneWall((0, 0.001, 0), (0, 1, 0)),
                fe_el.CylinderWall((0.015, 0.015, 0), (0, 0, 1), 0.0149),
                fe_el.SurfaceWall(box_surface((0.02, -0.01, -0.01), (0.04, 0.04, 0.04)), point=(0.02, 0.0, 0.0))]
    rolling = fe_el.LinearSpringDashpot(K, 0.6, 0.4, rolling=fe_el.RollingFriction(0.2))
    random = np.random.default_rng(0)
    at = [(x, y, z) for x in (0.008, 0.013, 0.017) for y in (0.008, 0.015) for z in (0.004, 0.02)]
    p, c = scene(at, walls, (0, 0, 0), rolling, velocity=random.uniform(-1, 1, (12, 3)))
    p.angular_velocity[:] = random.uniform(-300, 300, (12, 3))

    def spin(about):
        return (p.mass[:, None] * np.cross(p.position - about, p.velocity)
                + 0.1 * (p.mass * p.diameter ** 2)[:, None] * p.angular_velocity).sum(0)
    forces, torques = np.zeros(3), np.zeros(3)
    before = p.momentum(), spin(np.zeros(3))
    hit = np.zeros(4)
    while not hit.all() or c.touching:
        p.advance(1e-3, c)
        for k, wall in enumerate(c.walls):
            hit[k] += np.linalg.norm(wall.force)
            forces += 1e-3 * wall.force
            torques += 1e-3 * (wall.torque + np.cross(wall.point, wall.force))
    gained = p.momentum() - before[0], spin(np.zeros(3)) - before[1]
    assert gained[0] == pytest.approx(-forces, abs=1e-10 * MASS)
    assert gained[1] == pytest.approx(-torques, abs=1e-10 * MASS * 0.03)


@pytest.mark.ranks
def test_a_surface_that_moves_takes_beads_along():
    """A plate that rises, at 0.1 m/s, and a box that turns about the axis of the mesh: beads go with it."""
    plate = fe_el.SurfaceWall(([(-1, -1, 0.004), (1, -1, 0.004), (1, 1, 0.004), (-1, 1, 0.004)], [(0, 1, 2), (0, 2, 3)]),
                              velocity=(0, 0, 0.1), may_be_open=True)
    assert plate.open_edges == 4
    p, c = scene([(0.01, 0.01, 0.005), (0.02, 0.02, 0.005)], [plate])
    for _ in range(100):
        p.advance(1e-3, c)
    assert plate.point[2] == pytest.approx(0.01) and plate.corners()[0, 0, 2] == pytest.approx(0.014)
    assert p.position[:, 2] == pytest.approx(0.014 + D / 2, abs=1e-5) and p.velocity[:, 2] == pytest.approx(0.1, abs=1e-3)


@pytest.mark.ranks
def test_a_turning_box_is_exact_and_keeps_its_shape():
    """Five turns in 500 steps: no corner is off by more than round-off, and the beads inside stay there."""
    drum = fe_el.SurfaceWall(box_surface((0.007, 0.007, 0.007), (0.023, 0.023, 0.023)), point=(0.015,) * 3,
                             angular_velocity=(0.0, 2 * np.pi * 10, 0.0))
    start = drum.corners().copy()
    p, c = scene([(0.012, 0.012, 0.012), (0.017, 0.015, 0.016), (0.015, 0.018, 0.013)], [drum], (0, 0, 0),
                 velocity=(0.5, 0.3, 0.2))
    for _ in range(500):
        p.advance(1e-3, c)
    assert np.abs(drum.corners() - start).max() < 1e-10
    inside = (p.position - 0.015) @ drum.turned
    assert (np.abs(inside) < 0.008 - 0.45 * D).all() and p.comm.allreduce(np.abs(p.velocity).sum()) > 0.1


def test_walls_move_by_a_function_of_time():
    """A shaken plane and a shaken surface are alike, and where the integral of the velocity says."""
    ends = []
    for wall in (fe_el.PlaneWall((0, 0, 0.005), (0, 0, 1)),
                 fe_el.SurfaceWall(box_surface((-1, -1, -1), (1, 1, 0.005)), point=(0, 0, 0.005))):
        wall.drive = lambda t: ((0, 0, 0.1 * np.sin(200 * t)), (0, 0, 0))
        p, c = scene([(0.012, 0.014, 0.0062)], [wall])
        for _ in range(200):
            p.advance(2e-4, c)
        assert c.time == pytest.approx(0.04) and wall.velocity[2] == pytest.approx(0.1 * np.sin(200 * 0.0399))
        ends.append((*p.position[0], wall.point[2]))
    assert ends[0][3] == pytest.approx(0.005 + 0.1 / 200 * (1 - np.cos(8.0)), abs=1e-6)
    assert ends[0] == pytest.approx(ends[1], abs=1e-9)
    wall.drive = lambda t: 3.0
    with pytest.raises(ValueError, match="two vectors"):
        p.advance(1e-4, c)


def test_surfaces_move_while_there_are_no_beads():
    plate = fe_el.SurfaceWall(box_surface((0, 0, 0), (0.01,) * 3), velocity=(0.1, 0, 0), angular_velocity=(0, 0, np.pi))
    mesh, _ = fe_el.box((0.03, 0.03, 0.03), (3, 3, 3))
    p = fe_el.Particles(mesh, RHO)
    c = fe_el.Contacts(p, LAW, [plate])
    for _ in range(10):
        p.advance(0.1, c)
    assert plate.point == pytest.approx([0.1, 0, 0]) and plate.turned == pytest.approx(np.diag([-1.0, -1, 1]), abs=1e-12)


@pytest.mark.ranks
def test_a_restarted_run_knows_where_its_surface_is(folder):
    def run():
        blade = fe_el.SurfaceWall(box_surface((0.01, 0.002, 0.002), (0.02, 0.028, 0.006)), point=(0.015, 0.015, 0.004),
                                  angular_velocity=(0, 20.0, 0))
        at = [(x, y, 0.012) for x in (0.006, 0.012, 0.018, 0.024) for y in (0.006, 0.014, 0.022)]
        return scene(at, lambda tags: [fe_el.FacetWalls(tags, (1, 2, 3, 4, 5, 6)), blade])
    whole, again = run(), run()
    for _ in range(100):
        whole[0].advance(1e-3, whole[1])
    fe_el.save_checkpoint(folder + "/a.h5", *whole)
    fe_el.load_checkpoint(folder + "/a.h5", *again)
    for p, c in (whole, again):
        for _ in range(30):
            p.advance(1e-3, c)
    assert np.array_equal(whole[0].position, again[0].position) and whole[1].time == again[1].time
    assert np.array_equal(whole[1].walls[1].turned, again[1].walls[1].turned)


def test_surfaces_are_checked(tmp_path):
    points, triangles = box_surface((0, 0, 0), (0.01,) * 3)
    with pytest.raises(ValueError, match="4 open edges.*may_be_open"):
        fe_el.SurfaceWall((points, np.delete(triangles, (0, 1), 0)))
    flat = np.vstack([triangles, [(0, 1, 1)], triangles[:1]])
    wall = fe_el.SurfaceWall((points, flat))
    assert len(wall.vertex) == 12 and wall.open_edges == 0
    (tmp_path / "bad.stl").write_text("no surface")
    for surface, said in ((str(tmp_path / "bad.stl"), "cannot be read|points of shape"), (3.0, "surface is"),
                          ((points, triangles + 1), "points of shape"), ((points[:, :2], triangles), "points of shape"),
                          ((points * np.nan, triangles), "points of shape"), ((points, [(0, 1, 1)]), "no triangle")):
        with pytest.raises(ValueError, match=said):
            fe_el.SurfaceWall(surface)
    with pytest.raises(FileNotFoundError, match="no surface"):
        fe_el.SurfaceWall(str(tmp_path / "none.stl"))
    mesh, _ = fe_el.box((0.01, 0.01), (2, 2))
    with pytest.raises(ValueError, match="two dimensions"):
        fe_el.Contacts(fe_el.Particles(mesh, RHO), LAW, [wall])
