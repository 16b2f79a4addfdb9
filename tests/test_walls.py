"""Walls: facets, seams, edges, corners, planes and cylinders; energy at every angle; moving walls."""
import numpy as np
import pytest
from dolfinx import mesh as dmesh
from mpi4py import MPI

import fe_el
from fe_el.dolfinx_api import create_mesh, geometry_nodes

LAW = fe_el.LinearSpringDashpot(1000.0, 1.0, 0.3)
D, RHO, STEPS = 2e-3, 2500.0, 100
NO_GAIN = 1 + (np.pi / STEPS) ** 2 / 8  # what a step that splits the first touch can add to an elastic impact, at most


def l_shaped(n=4, size=0.04):
    """A cube without one of its quarters along y: a convex edge at (size/2, y, size/2). All boundary facets have tag 1."""
    box = dmesh.create_box(MPI.COMM_SELF, [np.zeros(3), np.full(3, size)], [n] * 3, dmesh.CellType.tetrahedron)
    cells = geometry_nodes(box)
    centre = box.geometry.x[cells].mean(1)
    keep = ~((centre[:, 0] > size / 2) & (centre[:, 2] < size / 2))
    used, renamed = np.unique(cells[keep], return_inverse=True)
    root = MPI.COMM_WORLD.rank == 0
    empty = np.zeros((0, 4), np.int64), np.zeros((0, 3))
    mesh = create_mesh(MPI.COMM_WORLD, *((renamed.reshape(-1, 4), box.geometry.x[used]) if root else empty))
    mesh.topology.create_connectivity(2, 3)
    facets = np.sort(dmesh.exterior_facet_indices(mesh.topology)).astype(np.int32)
    return mesh, dmesh.meshtags(mesh, 2, facets, np.ones(len(facets), np.int32))


def shoot(mesh, walls, target, direction, speed=0.5, start=3e-3, law=LAW, time=0.02):
    """Shoot a sphere at a point of a wall; returns velocity and rotation after it has left, and the energy ratio."""
    p = fe_el.Particles(mesh, RHO)
    direction = np.array(direction, float) / np.linalg.norm(direction)
    p.insert_at([np.array(target) - start * direction], D, velocity=speed * direction)
    c = fe_el.Contacts(p, law, walls, steps_per_contact=STEPS)
    before = p.kinetic_energy()
    for _ in range(20):
        p.advance(time / 20, c)
    return p.comm.allreduce(p.velocity.sum(0)), p.comm.allreduce(p.angular_velocity.sum(0)), p.kinetic_energy() / before


@pytest.mark.ranks
@pytest.mark.parametrize("angle", [0, 15, 45, 70, 85, 89.5])
@pytest.mark.parametrize("spin", [0.0, 37.0])
def test_a_face_gives_no_energy_and_is_a_mirror_without_friction(angle, spin):
    """Facets of the mesh and a plane give the same rebound, whether a seam is hit or not."""
    mesh, tags = fe_el.box((0.05, 0.05, 0.05), (3, 3, 3))
    t, s = np.radians(angle), np.radians(spin)
    direction = (np.sin(t) * np.cos(s), np.sin(t) * np.sin(s), -np.cos(t))
    target = np.array([0.025, 0.025, D / 2])
    plane = shoot(mesh, fe_el.PlaneWall((0, 0, 0), (0, 0, 1)), target, direction, start=1e-4)
    facets = shoot(mesh, (tags, 5), target, direction, start=1e-4)
    assert plane[2] <= NO_GAIN and facets[2] <= NO_GAIN
    assert np.allclose(plane[0], facets[0], atol=1e-9) and np.allclose(plane[1], facets[1], atol=1e-6)
    smooth = shoot(mesh, (tags, 5), target, direction, start=1e-4, law=fe_el.LinearSpringDashpot(1000.0, 1.0, 0.0))
    assert np.allclose(smooth[0], 0.5 * np.array(direction) * (1, 1, -1), atol=2e-4)


@pytest.mark.parametrize("cells", [(1, 400, 1), (2, 1, 2)])
@pytest.mark.parametrize("angle", [0, 45, 85])
def test_slivers_give_the_rebound_of_a_plane(cells, angle):
    """Facets forty times thinner than the sphere, 400:1 stretched, or far larger than it, bent ones too: one contact, no
    ghosts."""
    mesh, tags = fe_el.box((0.02, 0.02, 0.02), cells)
    t, s = np.radians(angle), np.radians(20)
    direction = (np.sin(t) * np.cos(s), np.sin(t) * np.sin(s), -np.cos(t))
    target = np.array([0.0101, 0.0103, D / 2])
    plane = shoot(mesh, fe_el.PlaneWall((0, 0, 0), (0, 0, 1)), target, direction, start=1e-4, time=0.008)
    facets = shoot(mesh, (tags, 5), target, direction, start=1e-4, time=0.008)
    assert np.allclose(plane[0], facets[0], atol=1e-9) and np.allclose(plane[1], facets[1], atol=1e-6)
    assert facets[2] <= NO_GAIN


def test_a_sphere_rolls_straight_over_needles():
    """Needle facets at a slant, with angles down to 0.1 degree: a sphere that rolls over a hundred seams keeps its speed."""
    n = 100
    along = np.linspace(0, 0.04, n + 1)
    low, high = np.column_stack([along, 0 * along, 0 * along]), np.column_stack([along + 0.013, 0.03 + 0 * along, 0 * along])
    top = np.array([[0.02, 0.015, 0.03]])
    x = np.concatenate([low, high, top])
    cells = np.array([c for k in range(n)
                      for c in ((k, k + 1, n + 1 + k, 2 * n + 2), (k + 1, n + 1 + k, n + 2 + k, 2 * n + 2))])
    mesh = create_mesh(MPI.COMM_SELF, cells, x)
    mesh.topology.create_connectivity(2, 3)
    floor = np.sort(dmesh.locate_entities_boundary(mesh, 2, lambda y: np.abs(y[2]) < 1e-12)).astype(np.int32)
    tags = dmesh.meshtags(mesh, 2, floor, np.ones(len(floor), np.int32))
    p = fe_el.Particles(mesh, RHO, (0, 0, -9.81))
    sink = p.gravity[2] * RHO * np.pi / 6 * D ** 3 / 1000.0  # rests on its spring
    p.insert_at([(0.014, 0.015, D / 2 + sink)], D, velocity=(0.5, 0, 0))
    p.angular_velocity[:] = (0, 0.5 / (D / 2 + sink), 0)
    c = fe_el.Contacts(p, fe_el.LinearSpringDashpot(1000.0, 0.5, 0.3), (tags, 1), steps_per_contact=STEPS)
    for _ in range(20):
        p.advance(1e-3, c)
    assert p.position[0, 0] == pytest.approx(0.024, abs=1e-7) and abs(p.position[0, 1] - 0.015) < 1e-10
    assert np.allclose(p.velocity, (0.5, 0, 0), atol=1e-6) and abs(p.position[0, 2] - D / 2 - sink) < 1e-10


def test_what_an_elastic_impact_gains_falls_with_the_square_of_the_step():
    mesh, _ = fe_el.box((0.05, 0.05, 0.05), (1, 1, 1))
    worst = []
    for steps in (50, 100):
        gains = []
        for start in np.linspace(1e-4, 1.1e-4, 7):
            p = fe_el.Particles(mesh, RHO)
            p.insert_at([[0.025, 0.025, D / 2 + start]], D, velocity=(0, 0, -0.5))
            c = fe_el.Contacts(p, LAW, fe_el.PlaneWall((0, 0, 0), (0, 0, 1)), steps_per_contact=steps)
            before = p.kinetic_energy()
            for _ in range(4):
                p.advance(5e-4, c)
            gains.append(abs(p.kinetic_energy() / before - 1))
        worst.append(max(gains))
        assert worst[-1] <= (np.pi / steps) ** 2 / 8
    assert worst[1] < worst[0] / 3


@pytest.mark.ranks
@pytest.mark.parametrize("offset", [-0.9e-3, -0.3e-3, 0.0, 0.4e-3])
@pytest.mark.parametrize("angle", [10, 45, 80])
def test_a_convex_edge_gives_no_energy_and_turns_like_a_cylinder(offset, angle):
    """Around an edge the wall is a point in the plane across it: angular momentum about the edge is kept without
    friction."""
    mesh, tags = l_shaped()
    edge = np.array([0.02, 0.0193, 0.02])
    t = np.radians(angle)
    direction = np.array([-np.sin(t), 0.05, np.cos(t)])
    across = np.cross(direction, (0, 1, 0))
    target = edge + offset * across / np.linalg.norm(across) - (0, 0, 0)
    direction[1] = 0.0
    result = shoot(mesh, (tags, 1), target, -np.array([-np.sin(t), 0, -np.cos(t)]) * (1, 1, -1), start=4e-3,
                   law=fe_el.LinearSpringDashpot(1000.0, 1.0, 0.0))
    assert result[2] == pytest.approx(1.0, abs=2e-3)
    rough = shoot(mesh, (tags, 1), target, -np.array([-np.sin(t), 0, -np.cos(t)]) * (1, 1, -1), start=4e-3)
    assert rough[2] <= NO_GAIN


@pytest.mark.ranks
def test_a_concave_corner_sends_a_sphere_back():
    """Three walls at once, and a hit exactly in the corner of the box."""
    mesh, tags = fe_el.box((0.05, 0.05, 0.05), (3, 3, 3))
    law = fe_el.LinearSpringDashpot(1000.0, 1.0, 0.0)
    v, _, energy = shoot(mesh, (tags, (1, 3, 5)), np.full(3, D / 2), (-1, -1, -1), start=1e-3, law=law)
    assert np.allclose(v, 0.5 / np.sqrt(3), atol=1e-3) and energy == pytest.approx(1.0, abs=1e-3)
    rough = shoot(mesh, (tags, (1, 3, 5)), np.full(3, D / 2), (-1, -0.7, -0.4), start=1e-3)
    assert rough[2] <= NO_GAIN


@pytest.mark.parametrize("outside", [False, True])
def test_cylinder(outside):
    """Head-on rebound from the inside and the outside of a cylinder."""
    mesh, _ = fe_el.box((0.1, 0.1, 0.1), (2, 2, 2))
    wall = fe_el.CylinderWall((0.05, 0.0, 0.05), (0, 1, 0), 0.02, outside=outside)
    x = 0.05 + (0.02 + D if outside else 0.02 - D)
    v, _, energy = shoot(mesh, wall, (x, 0.05, 0.05), (-1.0 if outside else 1.0, 0, 0), start=1e-3)
    assert v[0] == pytest.approx(0.5 if outside else -0.5, rel=1e-3) and energy == pytest.approx(1.0, abs=1e-3)


def test_two_dimensional_facets():
    """Segments of a triangle mesh: a mirror, seams and corners included."""
    mesh, tags = fe_el.box((0.05, 0.05), (5, 5))
    p = fe_el.Particles(mesh, RHO)
    p.insert_at([[0.02, 0.0213]], D, velocity=(0.31, -0.47))
    c = fe_el.Contacts(p, fe_el.LinearSpringDashpot(1000.0, 1.0, 0.0), (tags, (1, 2, 3, 4)), steps_per_contact=STEPS)
    energy = p.kinetic_energy()
    for _ in range(300):
        p.advance(2e-3, c)
        assert p.kinetic_energy() <= energy * NO_GAIN ** 12  # at most a dozen bounces
    assert np.allclose(np.abs(p.velocity[0, :2]), (0.31, 0.47), atol=2e-3) or c.touching


def test_a_moving_plane_pushes_and_carries():
    """An elastic plane that comes with V sends a resting sphere off with 2 V, and feels the reaction."""
    mesh, _ = fe_el.box((0.1, 0.1, 0.1), (2, 2, 2))
    wall = fe_el.PlaneWall((0, 0, 0.02), (0, 0, 1), velocity=(0, 0, 0.2))
    p = fe_el.Particles(mesh, RHO)
    p.insert_at([[0.05, 0.05, 0.03]], D)
    c = fe_el.Contacts(p, LAW, wall, steps_per_contact=STEPS)
    impulse = 0.0
    for _ in range(60):
        p.advance(1e-3, c)
        impulse += wall.force[2] * 1e-3
    assert p.velocity[0, 2] == pytest.approx(0.4, rel=1e-3)
    assert impulse == pytest.approx(-p.mass[0] * 0.4, rel=5e-3)


@pytest.mark.parametrize("kind", ["facets", "drum"])
def test_a_moving_surface_drags_a_sphere_along(kind):
    """On a belt a sphere ends with the rotation and speed that roll without slip; in the air it would stay."""
    mesh, tags = fe_el.box((0.4, 0.1, 0.1), (4, 2, 2))
    if kind == "facets":
        wall = fe_el.FacetWalls(tags, 5, velocity=(0.1, 0, 0))
        start = [0.1, 0.05, D / 2]
    else:
        wall = fe_el.CylinderWall((0.2, 0, 0.05), (0, 1, 0), 0.05, angular_velocity=(0, -2.0, 0), )
        start = [0.2, 0.05, D / 2]
    p = fe_el.Particles(mesh, RHO, (0, 0, -9.81))
    p.insert_at([start], D)
    c = fe_el.Contacts(p, fe_el.LinearSpringDashpot(1000.0, 0.5, 0.3), [wall])
    for _ in range(50):
        p.advance(1e-3, c)
    surface = 0.1 if kind == "facets" else -2.0 * 0.05 * -1
    slip = p.velocity[0, 0] - p.angular_velocity[0, 1] * D / 2 - surface
    assert abs(slip) < 0.02 * 0.1 and p.velocity[0, 0] > 0.02
    assert wall.force[2] == pytest.approx(-p.mass[0] * 9.81, rel=0.1)


def test_a_turning_plane_keeps_its_point_and_turns_its_normal():
    mesh, _ = fe_el.box((0.1, 0.1, 0.1), (2, 2, 2))
    wall = fe_el.PlaneWall((0.05, 0.05, 0.02), (0, 0, 1), angular_velocity=(0, 0.5, 0))
    p = fe_el.Particles(mesh, RHO)
    p.insert_at([[0.05, 0.05, 0.08]], D)
    c = fe_el.Contacts(p, LAW, wall)
    for _ in range(100):
        p.advance(1e-3, c)
    assert c.lists.shape[0, :3] == pytest.approx([np.sin(0.05), 0, np.cos(0.05)], abs=1e-6)


def test_bad_walls_are_refused():
    mesh, tags = fe_el.box((1.0, 1.0, 1.0), (2, 2, 2))
    p = fe_el.Particles(mesh, RHO)
    for words, make in (("group 9", lambda: fe_el.Contacts(p, LAW, (tags, 9))),
                        ("no wall", lambda: fe_el.Contacts(p, LAW, "wall")),
                        ("normal", lambda: fe_el.PlaneWall((0, 0, 0), (0, 0, 0))),
                        ("radius", lambda: fe_el.CylinderWall((0, 0, 0), (0, 0, 1), -1.0)),
                        ("axis", lambda: fe_el.CylinderWall((0, 0, 0), (0, 0, 0), 1.0)),
                        ("material", lambda: fe_el.PlaneWall((0, 0, 0), (0, 0, 1), material=-1)),
                        ("point", lambda: fe_el.PlaneWall((0, np.nan, 0), (0, 0, 1)))):
        with pytest.raises(ValueError, match=words):
            make()


def test_a_sphere_over_hundreds_of_facets():
    """Its one contact is found among more than five hundred facets below it."""
    mesh, tags = fe_el.box((0.004, 0.004, 0.02), (32, 32, 1))
    target, direction = np.array([0.00202, 0.00199, D / 2]), (0.1, 0.05, -1.0)
    runs = []
    for wall in (fe_el.PlaneWall((0, 0, 0), (0, 0, 1)), (tags, 5)):
        p = fe_el.Particles(mesh, RHO)
        p.insert_at([target + (0, 0, 1e-5)], D, velocity=0.5 * np.array(direction))
        c = fe_el.Contacts(p, fe_el.LinearSpringDashpot(20.0, 0.9, 0.3), wall, steps_per_contact=STEPS)
        p.advance(1e-3, c)
        runs.append((p.position[0], p.velocity[0], p.angular_velocity[0], c.largest_overlap))
    assert len(c.lists.near_facets.facet) > 500
    assert runs[0][3] > 0.1 and all(np.allclose(a, b, rtol=1e-6, atol=1e-9) for a, b in zip(*runs))


@pytest.mark.parametrize("position", [(0.01, 0.01, 0.0), (1e-4, 0.01, 0.0)])
def test_a_centre_on_a_facet_is_an_error_from_the_first_force_on(position):
    """Also where other facets are nearby: the message names the particle and the remedy."""
    mesh, tags = fe_el.box((0.02, 0.02, 0.02), (2, 2, 2))
    p = fe_el.Particles(mesh, RHO)
    p.insert_at([(0.01, 0.005, 0.01), position], D, velocity=(0, 0, 0.1))
    with pytest.raises(fe_el.LostParticle, match="particle 1 .*stiffer"):
        p.advance(1e-5, fe_el.Contacts(p, LAW, (tags, (1, 5))))
