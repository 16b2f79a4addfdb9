"""Contact laws: rolling friction, cohesion, materials, a user's law; neighbours of any size ratio; long runs; extremes."""
import numpy as np
import pytest

import fe_el
from fe_el.particles.contacts.neighbours import neighbour_pairs

RHO, D = 2500.0, 2e-3


def on_a_plane(law, velocity=(0, 0, 0), spin=(0, 0, 0), slope=0.0, count=1, g=9.81, wall_law=None, material=0,
               wall_material=0):
    mesh, _ = fe_el.box((0.5, 0.1, 0.1), (5, 1, 1))
    p = fe_el.Particles(mesh, RHO, (g * np.sin(slope), 0, -g * np.cos(slope)))
    sink = RHO * np.pi / 6 * D ** 3 * g * np.cos(slope) / law.stiffness if law.kind == 0 else 0.0
    p.insert_at([[0.1, 0.05, D / 2 - sink]], D, velocity=velocity, material=material)
    p.angular_velocity[:] = spin
    return p, fe_el.Contacts(p, law, fe_el.PlaneWall((0, 0, 0), (0, 0, 1), material=wall_material), wall_law)


def test_constant_rolling_torque_slows_a_rolling_sphere():
    """A sphere that rolls slows by (5/7) mu_r g, and then stays at rest."""
    law = fe_el.LinearSpringDashpot(1000.0, 0.5, 0.8, rolling=fe_el.RollingFriction(0.05))
    p, c = on_a_plane(law, (0.1, 0, 0), (0, 0.1 / (D / 2), 0))
    p.advance(0.05, c)
    v = p.velocity[0, 0]
    p.advance(0.1, c)
    assert (v - p.velocity[0, 0]) / 0.1 == pytest.approx(5 / 7 * 0.05 * 9.81, rel=0.01)
    p.advance(0.4, c)
    assert np.abs(p.velocity).max() < 1e-6 and np.abs(p.angular_velocity).max() < 1e-3


@pytest.mark.parametrize("slope, rests", [(0.05, True), (0.2, False)])
def test_elastic_plastic_rolling_friction_holds_a_slope(slope, rests):
    """Up to tan(slope) = mu_r a sphere stays on the slope, beyond it rolls off with 5/7 g (sin - mu_r cos)."""
    law = fe_el.LinearSpringDashpot(1000.0, 0.5, 0.8, rolling=fe_el.RollingFriction(0.1, elastic_plastic=True))
    p, c = on_a_plane(law, slope=slope)
    p.advance(0.1, c)
    v = p.velocity[0, 0]
    p.advance(0.1, c)
    expected = 0.0 if rests else 5 / 7 * 9.81 * (np.sin(slope) - 0.1 * np.cos(slope))
    assert (p.velocity[0, 0] - v) / 0.1 == pytest.approx(expected, abs=0.01)


def test_hertz_with_rolling_friction_and_tables():
    """The same slow-down with the Hertz law and tables of one material."""
    law = fe_el.HertzMindlin([1e7], [0.3], [[0.5]], [[0.8]], rolling=fe_el.RollingFriction([[0.05]]))
    p, c = on_a_plane(law, (0.1, 0, 0), (0, 0.1 / (D / 2), 0))
    p.advance(0.05, c)
    v = p.velocity[0, 0]
    p.advance(0.1, c)
    assert (v - p.velocity[0, 0]) / 0.1 == pytest.approx(5 / 7 * 0.05 * 9.81, rel=0.05)


@pytest.mark.parametrize("factor", [0.0, 0.5, 0.9, 1.1, 3.0])
def test_surface_energy_holds_a_bead_below_a_ceiling(factor):
    """It hangs if 2 pi R* W is more than its weight, where the spring takes the difference, and falls if not."""
    mesh, _ = fe_el.box((0.1, 0.1, 0.1), (1, 1, 1))
    k = 1000.0
    p = fe_el.Particles(mesh, RHO, (0, 0, -9.81))
    p.insert_at([[0.05, 0.05, 0.05]], D)
    weight, pull = p.mass[0] * 9.81, factor * p.mass[0] * 9.81
    law = fe_el.LinearSpringDashpot(k, 0.1, 0.3, surface_energy=pull / (np.pi * D))
    p.advance(0.05, fe_el.Contacts(p, law, fe_el.PlaneWall((0, 0, 0.05 + D / 2 - 1e-7), (0, 0, -1))))
    if factor > 1:
        assert (p.position[0, 2] - 0.05 + 1e-7) * k == pytest.approx(pull - weight, rel=1e-6)
    else:
        assert p.position[0, 2] < 0.045


def test_cohesion_by_area_is_refused_where_it_cannot_hold():
    with pytest.raises(ValueError, match="surface_energy"):
        fe_el.LinearSpringDashpot(1000.0, 0.3, 0.5, cohesion=1e5)
    fe_el.HertzMindlin(1e7, 0.3, 0.3, 0.5, cohesion=1e5)


def test_materials_rebound_by_their_own_pair():
    """Soft on soft, soft on hard, hard on hard: each pair of the table has its restitution, in one run."""
    mesh, _ = fe_el.box((0.1, 0.1, 0.1), (1, 1, 1))
    e = np.array([[0.9, 0.5], [0.5, 0.2]])
    law = fe_el.LinearSpringDashpot([[500.0, 800.0], [800.0, 2000.0]], e, 0.0)
    p = fe_el.Particles(mesh, RHO)
    pairs = [(0, 0), (0, 1), (1, 1)]
    for n, (a, b) in enumerate(pairs):
        y = 0.02 + 0.02 * n
        p.insert_at([[0.045, y, 0.05], [0.0475, y, 0.05]], D, velocity=[[0.2, 0, 0], [-0.2, 0, 0]], material=[a, b])
    walls = [fe_el.PlaneWall((0, 0, 0.0), (0, 0, 1), material=0), fe_el.PlaneWall((0, 0, 0.1), (0, 0, -1), material=1)]
    c = fe_el.Contacts(p, law, walls, steps_per_contact=400)
    for _ in range(10):
        p.advance(1e-3, c)
    v = np.zeros(6)
    v[p.id] = p.velocity[:, 0]
    for n, (a, b) in enumerate(pairs):
        assert (v[2 * n + 1] - v[2 * n]) / 0.4 == pytest.approx(e[a, b], abs=2e-3)
    for speed, wall in ((-0.2, 0), (0.2, 1)):
        q = fe_el.Particles(mesh, RHO)
        q.insert_at([[0.05, 0.05, 0.0015 if wall == 0 else 0.0985]], D, velocity=(0, 0, speed), material=1)
        cq = fe_el.Contacts(q, law, walls, steps_per_contact=400)
        q.advance(8e-3, cq)
        assert -q.velocity[0, 2] / speed == pytest.approx(e[1, wall], abs=2e-3)


def linear_by_hand(stiffness, restitution, friction):
    """The linear law as a user would write it."""
    log = abs(np.log(restitution))
    damping = 2 * log / np.hypot(np.pi, log)

    def law(overlap, vn, vt, spring, mass, radius, dt):
        eta = damping * np.sqrt(stiffness * mass) * (1 - 0.48 * dt ** 2 * stiffness / mass)
        fn = stiffness * overlap - eta * vn
        spring = spring + dt * vt
        ft = -2 / 7 * stiffness * spring - 0.5 * eta[:, None] * vt
        size, cap = np.linalg.norm(ft, axis=1) + 1e-300, friction * np.abs(fn)
        stretch = 2 / 7 * stiffness * np.linalg.norm(spring, axis=1) + 1e-300
        slides = size > cap
        spring = np.where((slides & (stretch > cap))[:, None], spring * (cap / stretch)[:, None], spring)
        return fn, np.where(slides[:, None], ft * (cap / size)[:, None], ft), spring
    return law


@pytest.mark.ranks
def test_a_users_array_law_matches_the_built_in_one(by_id):
    states = []
    for law in (fe_el.LinearSpringDashpot(800.0, 0.8, 0.3), fe_el.ArrayLaw(linear_by_hand(800.0, 0.8, 0.3), 1.0)):
        mesh, _ = fe_el.box((0.02, 0.02, 0.02), (2, 2, 2))
        p = fe_el.Particles(mesh, RHO)
        p.insert_in_box((0.004,) * 3, (0.016,) * 3, 60, D, seed=3, without_overlap=True)
        p.velocity[:] = np.random.default_rng(4).normal(size=(60, 3))[p.id] * 0.3
        if isinstance(law, fe_el.ArrayLaw):
            law._contact_time = states[0][2]
        walls = fe_el.FacetWalls(_tags(mesh), 1)
        c = fe_el.Contacts(p, law, walls, fe_el.LinearSpringDashpot(800.0, 0.8, 0.3))
        for _ in range(3):
            p.advance(1e-3, c)
        states.append((by_id(p, p.position), by_id(p, p.angular_velocity),
                       fe_el.LinearSpringDashpot(800.0, 0.8, 0.3).contact_time(RHO * np.pi / 6 * D ** 3 / 2)))
    assert np.allclose(states[0][0], states[1][0], atol=1e-12) and np.allclose(states[0][1], states[1][1], atol=1e-7)


def _tags(mesh):
    from dolfinx import mesh as dmesh
    mesh.topology.create_connectivity(2, 3)
    facets = np.sort(dmesh.exterior_facet_indices(mesh.topology)).astype(np.int32)
    return dmesh.meshtags(mesh, 2, facets, np.ones(len(facets), np.int32))


@pytest.mark.parametrize("ratio", [1.0, 3.0, 50.0])
def test_neighbours_are_all_found_once_at_any_size_ratio(ratio):
    rng = np.random.default_rng(7)
    x, r, room = rng.random((600, 3)), 0.004 * ratio ** rng.random(600), 0.003 * rng.random(600)
    first, second = neighbour_pairs(x, r + room, 500)
    found = set(zip(np.minimum(first, second).tolist(), np.maximum(first, second).tolist()))
    assert len(found) == len(first) and (first < 500).all()
    gap = np.linalg.norm(x[:, None] - x, axis=2) - r[:, None] - r - room[:, None] - room
    a, b = np.nonzero(np.triu(gap < 0, 1))
    assert found == {(i, j) for i, j in zip(a.tolist(), b.tolist()) if i < 500}


def test_neighbours_of_few_among_many_others_are_written_as_well_as_counted():
    """Seven owned spheres in one box among a hundred others: there are more pairs than room was made for at first."""
    x = np.zeros((107, 3))
    x[:6, 0], x[7:, 0], x[-1, 0] = 0.05, 2.03, 1.95
    x[7:, 1] = np.linspace(0.0, 0.01, 100)
    first, second = neighbour_pairs(x, np.ones(107), 7)
    near = np.triu(np.linalg.norm(x[:, None] - x, axis=2) < 2.0, 1)[:7]
    assert set(zip(first.tolist(), second.tolist())) == set(zip(*(k.tolist() for k in np.nonzero(near))))
    assert len(first) == near.sum() == 622


@pytest.mark.ranks
def test_collision_across_a_periodic_side(by_id):
    """Two spheres that meet across the wrap rebound as in the middle of the box, with their springs."""
    results = []
    for shift in (0.0, 0.01):
        mesh, _ = fe_el.periodic_box((0.02, 0.02, 0.02), (3, 3, 3))
        p = fe_el.Particles(mesh, RHO)
        x = np.array([[0.0087, 0.0098, 0.01], [0.0113, 0.0102, 0.01]]) + (shift, shift, 0)
        p.insert_at(x % 0.02, D, velocity=[[0.3, 0, 0.05], [-0.3, 0, 0]])
        c = fe_el.Contacts(p, fe_el.LinearSpringDashpot(1000.0, 0.9, 0.3))
        for _ in range(8):
            p.advance(5e-4, c)
        results.append((by_id(p, p.velocity), by_id(p, p.angular_velocity)))
    assert np.allclose(results[0][0], results[1][0], atol=1e-12) and np.allclose(results[0][1], results[1][1], atol=1e-9)
    assert np.abs(results[0][1]).max() > 1.0
    with pytest.raises(ValueError, match="periodic"):
        q = fe_el.Particles(fe_el.periodic_box((0.02, 0.02, 0.02), (3, 3, 3))[0], RHO)
        q.insert_at([[0.01, 0.01, 0.01]], 0.0098)
        q.advance(1e-4, fe_el.Contacts(q, fe_el.LinearSpringDashpot(1000.0, 0.9, 0.3)))


@pytest.mark.ranks
def test_result_does_not_depend_on_the_axes(by_id):
    """The same cloud with x, y, z renamed gives the same cloud with x, y, z renamed."""
    states = []
    for axes in ([0, 1, 2], [1, 2, 0]):
        mesh, tags = fe_el.box((0.02, 0.02, 0.02), (2, 2, 2))
        p = fe_el.Particles(mesh, RHO, np.array([1.0, -2.0, -9.0])[axes])
        q = fe_el.Particles(mesh, RHO)
        q.insert_in_box((0.002,) * 3, (0.018,) * 3, 150, np.linspace(1e-3, 2e-3, 150), seed=5, without_overlap=True)
        x = by_id(q, q.position)
        d = by_id(q, q.diameter)
        p.insert_at(x[:, axes], d)
        c = fe_el.Contacts(p, fe_el.LinearSpringDashpot(500.0, 0.8, 0.3), (tags, (1, 2, 3, 4, 5, 6)))
        for _ in range(20):
            p.advance(1e-3, c)
        states.append(by_id(p, p.position)[:, np.argsort(axes)])
    assert np.abs(states[0] - states[1]).max() < 1e-10


def test_an_elastic_gas_keeps_its_energy():
    """100,000 sub-steps of a homogeneous elastic gas: the energy stays within the step's error, without drift."""
    mesh, _ = fe_el.periodic_box((0.01,) * 3, (3, 3, 3))
    p = fe_el.Particles(mesh, RHO)
    p.insert_in_box((0, 0, 0), (0.01,) * 3, 60, 1e-3, seed=1, without_overlap=True)
    p.velocity[:] = np.random.default_rng(2).normal(size=(60, 3)) * 0.3
    p.velocity -= p.velocity.mean(0)
    c = fe_el.Contacts(p, fe_el.LinearSpringDashpot(1000.0, 1.0, 0.0), steps_per_contact=50)
    start, values, steps = p.kinetic_energy(), [], 0
    while steps < 100_000:
        p.advance(2e-2, c)
        steps += c.steps_last
        potential = 0.5 * 1000.0 * stored_overlap(p)
        values.append((p.kinetic_energy() + potential) / start)
    assert np.abs(np.array(values) - 1).max() < 5e-3
    assert abs(np.mean(values[-10:]) - np.mean(values[:10])) < 5e-3


def stored_overlap(p):
    """Sum of the squared overlaps of all pairs, periodic images included."""
    d = p.position[:, None] - p.position
    d -= np.round(d / 0.01) * 0.01
    gap = np.linalg.norm(d, axis=2) - 0.5 * (p.diameter[:, None] + p.diameter)
    return (np.minimum(gap[np.triu_indices(len(p), 1)], 0) ** 2).sum()


def test_a_packed_column_comes_to_rest():
    """Beads stacked in a square tube: kinetic energy decays to round-off of the weight scale, and nothing creeps."""
    mesh, tags = fe_el.box((0.0034, 0.0034, 0.05), (1, 1, 10))
    p, n = fe_el.Particles(mesh, RHO, (0, 0, -9.81)), np.arange(24)
    side = np.array([0.0010001, 0.0023999])
    p.insert_at(np.column_stack([side[n % 2], side[(n // 2) % 2], 1.4e-3 + 2.03e-3 * n]), D)
    c = fe_el.Contacts(p, fe_el.LinearSpringDashpot(1000.0, 0.5, 0.4), (tags, (1, 2, 3, 4, 5)))
    for _ in range(20):
        p.advance(0.02, c)
    before = p.position[np.argsort(p.id)].copy()
    for _ in range(20):
        p.advance(0.02, c)
    assert p.kinetic_energy() < 1e-27 * p.mass.sum() * 9.81 * D
    assert np.abs(p.position[np.argsort(p.id)] - before).max() < 1e-12 * D


def test_a_random_pile_comes_to_rest_and_does_not_creep():
    """Rolling friction with torsion leaves nothing that could move: energy at round-off of the weight scale, positions
    fixed."""
    mesh, tags = fe_el.box((0.02, 0.02, 0.04), (2, 2, 4))
    p = fe_el.Particles(mesh, RHO, (0, 0, -9.81))
    p.insert_on_lattice((0, 0, 0), (0.02, 0.02, 0.04), np.full(300, 2e-3), seed=2)
    p.velocity[:] = np.random.default_rng(1).normal(size=(300, 3)) * 0.3
    friction = fe_el.RollingFriction(0.05, elastic_plastic=True, torsion=True)
    c = fe_el.Contacts(p, fe_el.LinearSpringDashpot(2000.0, 0.7, 0.3, rolling=friction), (tags, (1, 2, 3, 4, 5, 6)))
    for _ in range(600):
        p.advance(2e-3, c)
    before = p.position[np.argsort(p.id)].copy()
    for _ in range(100):
        p.advance(2e-3, c)
    assert p.kinetic_energy() < 1e-24 * p.mass.sum() * 9.81 * 2e-3
    assert np.abs(p.position[np.argsort(p.id)] - before).max() < 1e-12 * 2e-3


@pytest.mark.parametrize("torsion, left", [(False, 1.0), (True, 0.5)])
def test_torsion_stops_a_spinning_bead(torsion, left):
    """On a floor, spin about the normal falls at mu_r r m g / I, or stays without torsion."""
    mesh, tags = fe_el.box((0.02,) * 3, (2, 2, 2))
    p = fe_el.Particles(mesh, RHO, (0, 0, -9.81))
    p.insert_at([(0.01, 0.011, D / 2)], D)
    law = fe_el.LinearSpringDashpot(1e4, 0.3, 0.4, rolling=fe_el.RollingFriction(0.01, torsion=torsion))
    c = fe_el.Contacts(p, law, (tags, 5))
    p.advance(0.02, c)  # comes to rest on its spring
    deceleration = 0.01 * 9.81 / (0.4 * D / 2)
    p.angular_velocity[:] = (0, 0, 2 * deceleration * 0.01)
    p.advance(0.01, c)
    assert p.angular_velocity[0, 2] == pytest.approx(left * 2 * deceleration * 0.01, rel=2e-3)


EXTREMES = [{"stiffness": 1e2}, {"stiffness": 1e8}, {"density": 0.1}, {"density": 2e4}, {"diameter": 1e-6},
            {"diameter": 0.1}, {"restitution": 0.01}, {"restitution": 1.0}, {"friction": 0.0}, {"friction": 10.0}]


@pytest.mark.parametrize("change", EXTREMES)
def test_extreme_numbers(change):
    """A head-on collision and one against a facet give the restitution, over many orders of every parameter."""
    n = {"stiffness": 1e4, "density": 2500.0, "diameter": 1e-3, "restitution": 0.8, "friction": 0.3, **change}
    d = n["diameter"]
    mesh, tags = fe_el.box((20 * d,) * 3, (2, 2, 2))
    p = fe_el.Particles(mesh, n["density"])
    mass = n["density"] * np.pi / 6 * d ** 3
    speed = 0.01 * d * np.sqrt(n["stiffness"] / mass)  # overlaps of about one per cent
    p.insert_at([[10 * d, 10 * d, 0.6 * d], [8 * d, 8 * d, 8 * d], [9.1 * d, 8 * d, 8 * d]], d,
                velocity=[[0, 0, -speed], [speed, 0, 0], [0, 0, 0]])
    law = fe_el.LinearSpringDashpot(n["stiffness"], n["restitution"], n["friction"])
    c = fe_el.Contacts(p, law, (tags, 5), steps_per_contact=200)
    time = 0.3 * d / speed + 1.5 * law.contact_time(mass)
    for _ in range(10):
        p.advance(time / 10, c)
    v = p.velocity[np.argsort(p.id)]
    assert v[0, 2] / speed == pytest.approx(n["restitution"], abs=4e-3)
    assert (v[2, 0] - v[1, 0]) / speed == pytest.approx(n["restitution"], abs=4e-3)


def test_overlap_at_the_start_parts_and_coincident_particles_are_an_error():
    mesh, _ = fe_el.box((0.02,) * 3, (2, 2, 2))
    p = fe_el.Particles(mesh, RHO)
    p.insert_at([[0.01, 0.01, 0.01], [0.01 + 0.9 * D, 0.01, 0.01]], D)
    c = fe_el.Contacts(p, fe_el.LinearSpringDashpot(500.0, 0.5, 0.3))
    for _ in range(10):
        p.advance(1e-3, c)
    assert np.linalg.norm(p.position[0] - p.position[1]) > D
    q = fe_el.Particles(mesh, RHO)
    q.insert_at([[0.01, 0.01, 0.01], [0.01, 0.01, 0.01]], D)
    with pytest.raises(FloatingPointError, match="lie on one point"):
        q.advance(1e-3, fe_el.Contacts(q, fe_el.LinearSpringDashpot(500.0, 0.5, 0.3)))


def test_a_particle_too_fast_for_its_step_is_an_error_with_the_remedy():
    mesh, _ = fe_el.box((1.0,) * 3, (2, 2, 2))
    p = fe_el.Particles(mesh, RHO)
    p.insert_at([[0.5, 0.5, 0.5]], 1e-3, velocity=(1e4, 0, 0))
    with pytest.raises(FloatingPointError, match="stiffer|Use a step below"):
        p.advance(1e-5, fe_el.Contacts(p, fe_el.LinearSpringDashpot(1.0, 0.5, 0.3)))
    with pytest.raises(ValueError, match="skin"):
        p.advance(1e-5, fe_el.Contacts(p, fe_el.LinearSpringDashpot(1e3, 0.5, 0.3), skin=1e-5))


def test_a_sphere_pressed_through_a_wall_is_an_error():
    mesh, tags = fe_el.box((0.02,) * 3, (2, 2, 2))
    p = fe_el.Particles(mesh, RHO)
    p.insert_at([[0.01, 0.01, 0.003]], D, velocity=(0, 0, -5.0))
    with pytest.raises(fe_el.LostParticle, match="wall|outside the mesh"):
        for _ in range(20):
            p.advance(1e-4, fe_el.Contacts(p, fe_el.LinearSpringDashpot(10.0, 0.5, 0.3), (tags, 5)))


@pytest.mark.parametrize("words, make", [
    ("table", lambda: fe_el.LinearSpringDashpot([[1.0, 2.0], [3.0, 4.0]], 0.9, 0.1)),
    ("Poisson", lambda: fe_el.HertzMindlin(1e7, 0.7, 0.9, 0.1)), ("Young", lambda: fe_el.HertzMindlin(-1.0, 0.3, 0.9, 0.1)),
    ("another number of materials", lambda: fe_el.HertzMindlin([1e7, 1e8, 1e9], [0.3, 0.2], 0.9, 0.1)),
    ("rolling", lambda: fe_el.RollingFriction(-0.1)),
    ("cohesion", lambda: fe_el.LinearSpringDashpot(1.0, 0.9, 0.1, cohesion=-1)),
    ("tangential damping", lambda: fe_el.LinearSpringDashpot(1.0, 0.9, 0.1, 0.3, 2.0)),
    ("tangential stiffness", lambda: fe_el.LinearSpringDashpot(1.0, 0.9, 0.1, 3.0)),
    ("contact law", lambda: fe_el.ArrayLaw("law", 1.0)), ("contact time", lambda: fe_el.ArrayLaw(abs, -1.0)),
    ("RollingFriction", lambda: fe_el.HertzMindlin(1e7, 0.3, 0.9, 0.1, rolling=0.1))])
def test_bad_laws_are_refused(words, make):
    with pytest.raises(ValueError, match=words):
        make()


def test_a_material_without_a_row_in_the_table_is_refused():
    mesh, _ = fe_el.box((1.0,) * 3, (1, 1, 1))
    p = fe_el.Particles(mesh, RHO)
    p.insert_at([[0.5, 0.5, 0.5]], D, material=1)
    with pytest.raises(ValueError, match="material"):
        fe_el.Contacts(p, fe_el.LinearSpringDashpot(1.0, 0.9, 0.1))
