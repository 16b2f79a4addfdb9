"""Contacts from one and two particles up."""
import numpy as np
import pytest

import fe_el
from fe_el.particles.contacts import waves
from fe_el.particles.contacts.contact_lists import ContactLists


def two_spheres(restitution, friction=0.0, velocity=0.5, offset=0.0, steps=50):
    mesh, _ = fe_el.box((0.02, 0.02, 0.02), (2, 2, 2))
    p = fe_el.Particles(mesh, density=2500.0)
    p.insert_at([[0.008, 0.01, 0.01], [0.0101, 0.01 + offset, 0.01]], diameter=[1e-3, 2e-3],
                velocity=[[velocity, 0, 0], [-velocity, 0, 0]])
    return p, fe_el.Contacts(p, fe_el.LinearSpringDashpot(1000.0, restitution, friction), steps_per_contact=steps)


@pytest.mark.ranks
@pytest.mark.parametrize("steps", [50, 400])
@pytest.mark.parametrize("restitution", [0.1, 0.5, 0.9, 1.0])
def test_restitution(restitution, steps):
    """The relative velocity after a head-on collision is the restitution times the one before, and converges to it.

    The dashpot force jumps at first touch, so the error is of first order: below 0.6 / steps per contact.
    """
    p, contacts = two_spheres(restitution, steps=steps)
    before = p.momentum()
    for _ in range(40):
        p.advance(1e-4, contacts)
    v = np.zeros(2)
    v[p.id] = p.velocity[:, 0]
    v = p.comm.allreduce(v)
    assert v[1] - v[0] == pytest.approx(restitution, abs=0.6 / steps)
    assert np.allclose(p.momentum(), before, rtol=0, atol=1e-13 * p.comm.allreduce(p.mass.sum()))


@pytest.mark.ranks
@pytest.mark.parametrize("offset", [0.2e-3, 0.8e-3, 1.3e-3])
def test_oblique_collision_conserves_momentum_and_gains_no_energy(offset):
    p, contacts = two_spheres(1.0, friction=0.3, offset=offset)
    momentum, energy, angular = p.momentum(), p.kinetic_energy(), angular_momentum(p)
    for _ in range(40):
        p.advance(1e-4, contacts)
    assert p.comm.allreduce(np.abs(p.angular_velocity).sum()) > 1.0  # they did touch
    assert np.allclose(p.momentum(), momentum, rtol=0, atol=1e-18)
    assert p.kinetic_energy() <= energy * (1 + 1e-4)
    assert np.allclose(angular_momentum(p), angular, rtol=0, atol=1e-12 * np.abs(angular).max())


def angular_momentum(p):
    inertia = 0.1 * p.mass * p.diameter ** 2
    return p.comm.allreduce((p.mass[:, None] * np.cross(p.position, p.velocity)
                             + inertia[:, None] * p.angular_velocity).sum(0))


LAWS = {"linear": lambda e: fe_el.LinearSpringDashpot(1000.0, e, 0.0),
        "hertz": lambda e: fe_el.HertzMindlin(1e7, 0.3, e, 0.0)}


def mean_restitution(law, steps):
    """Mean over 144 pairs that touch at any moment of a sub-step, with ``steps`` of these in a contact."""
    mesh, _ = fe_el.box((0.12, 0.06, 0.06), (4, 2, 2))
    grid = 0.004 + 0.0045 * np.stack(np.meshgrid(*(np.arange(12),) * 2), -1).reshape(-1, 2)
    gap = 1e-5 + 1e-4 * np.linspace(0, 1, len(grid))
    first, second = (np.column_stack([x, grid]) for x in (np.full(len(grid), 0.02), 0.022 + gap))
    p = fe_el.Particles(mesh, density=2500.0)
    p.insert_at(np.concatenate([first, second]), 2e-3, velocity=np.outer(np.repeat([0.25, -0.25], len(grid)), [1, 0, 0]))
    contacts = fe_el.Contacts(p, law, steps_per_contact=steps)
    for _ in range(30):
        p.advance(1e-4, contacts)
    v = p.velocity[np.argsort(p.id), 0].reshape(2, -1)
    return np.mean(v[1] - v[0]) / 0.5


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("restitution", [0.1, 0.3, 0.5, 0.7, 0.9])
def test_mean_restitution_in_few_sub_steps(law, restitution):
    """Within 0.005 of the law's at 12 sub-steps in a contact, 0.002 at 20."""
    for steps, bound in ((12, 0.005), (20, 0.002)):
        assert mean_restitution(LAWS[law](restitution), steps) == pytest.approx(restitution, abs=bound)


@pytest.mark.ranks
@pytest.mark.parametrize("restitution", [0.6, 1.0])
def test_rebound_from_a_wall_of_mesh_facets(restitution):
    """A sphere dropped on the seam between facets rebounds straight with its restitution."""
    mesh, tags = fe_el.box((0.02, 0.02, 0.02), (2, 2, 2))
    p = fe_el.Particles(mesh, density=2500.0)
    p.insert_at([[0.01, 0.01, 0.002]], diameter=2e-3, velocity=(0, 0, -0.5))
    contacts = fe_el.Contacts(p, fe_el.LinearSpringDashpot(1000.0, restitution, 0.3), walls=(tags, 5))
    for _ in range(60):
        p.advance(1e-4, contacts)
    v = p.comm.allreduce(p.velocity.sum(0))
    assert v[2] == pytest.approx(0.5 * restitution, abs=0.5 * 0.6 / 50)
    assert np.abs(v[:2]).max() < 1e-12


@pytest.mark.ranks
def test_sliding_over_seams_is_straight():
    """A frictionless sphere pressed on a wall slides over the seams between facets without feeling them."""
    mesh, tags = fe_el.box((0.05, 0.02, 0.01), (7, 3, 2))
    p = fe_el.Particles(mesh, density=2500.0, gravity=(0, 0, -9.81))
    rest = 2500.0 * np.pi / 6 * 8e-9 * 9.81 / 1000.0
    p.insert_at([[0.005, 0.0071, 1e-3 - rest]], diameter=2e-3, velocity=(0.4, 0.05, 0))
    contacts = fe_el.Contacts(p, fe_el.LinearSpringDashpot(1000.0, 1.0, 0.0), walls=(tags, 5))
    for _ in range(80):
        p.advance(1e-3, contacts)
        v = p.comm.allreduce(p.velocity.sum(0))
        assert np.allclose(v, (0.4, 0.05, 0), rtol=0, atol=1e-9)


def test_contact_law_rejects_impossible_numbers():
    for kwargs in ({"restitution": 0.0}, {"restitution": 1.1}, {"friction": -1.0}, {"stiffness": -5.0}):
        with pytest.raises(ValueError):
            fe_el.LinearSpringDashpot(**{"stiffness": 100.0, "restitution": 0.9, "friction": 0.1, **kwargs})


@pytest.mark.ranks
@pytest.mark.parametrize("skin", [None, 3e-4])
def test_no_contact_is_missed_among_slow_and_fast_beads_of_many_sizes(skin):
    """Beads in a periodic box over a floor, some fast, under a plane that comes down: all overlaps are among what may
    touch."""
    period = np.array([0.03, 0.03, np.inf])
    mesh, tags = fe_el.periodic_box((0.03, 0.03, 0.04), (3, 3, 4), (True, True, False))
    rng = np.random.default_rng(3)
    x = np.stack(np.meshgrid(*[np.arange(6) * 0.005 + 0.0025] * 3, indexing="ij"), -1).reshape(-1, 3)
    velocity = rng.normal(size=x.shape) * np.where(rng.random(len(x)) < 0.1, 4.0, 0.2)[:, None]
    beads = fe_el.Particles(mesh, 2500.0)
    beads.insert_at(x, 8e-4 * 6 ** rng.random(len(x)), velocity=velocity)
    plane = fe_el.PlaneWall((0, 0, 0.031), (0, 0, -1), velocity=(0, 0, -1.0))
    contacts = fe_el.Contacts(beads, fe_el.LinearSpringDashpot(2e3, 0.9, 0.1), [fe_el.FacetWalls(tags, 5), plane],
                              steps_per_contact=20, skin=skin)
    overlapping, h, gather = 0, 0.999 * contacts.step_limit(), beads.comm.allgather
    for n in range(120):
        beads.advance(7 * h, contacts)
        lists = contacts.lists
        pairs, candidates = lists.pairs, lists.candidates
        near, floor = candidates.listed[:lists.near.pairs], candidates.wall_listed[:lists.near.facets]
        mine = [lists.ids[a] for a in (pairs.first[near], pairs.second[near], lists.near_facets.particle[floor],
                                       lists.shapes.particle)]
        first, second, floor, top = (np.concatenate(a) for a in zip(*gather(mine)))
        ids, x, r = (np.concatenate(a) for a in zip(*gather((beads.id, beads.position, beads.diameter / 2))))
        apart = x[:, None] - x
        apart -= np.where(np.isfinite(period), period, 1.0) * np.round(apart / period)
        a, b = np.nonzero(np.triu(np.linalg.norm(apart, axis=2) < r[:, None] + r, 1))
        overlapping += len(a)
        assert {frozenset(k) for k in zip(ids[a], ids[b])} <= {frozenset(k) for k in zip(first, second)}
        assert set(ids[x[:, 2] < r]) <= set(floor) and set(ids[lists.motion[1, 2] - x[:, 2] < r]) <= set(top)
    assert overlapping > 200 and contacts.rebuilds < 840 / 4


@pytest.mark.parametrize("sub_steps", [1, 2, 50])
def test_lists_are_renewed_however_few_sub_steps_a_call_makes(sub_steps):
    """Two beads that start far apart collide and part at the restitution."""
    mesh, _ = fe_el.box((0.02,) * 3, (2, 2, 2))
    p = fe_el.Particles(mesh, 2500.0)
    p.insert_at([(0.005, 0.01, 0.01), (0.015, 0.01, 0.01)], 5e-4, velocity=[(0.3, 0, 0), (-0.3, 0, 0)])
    c = fe_el.Contacts(p, fe_el.LinearSpringDashpot(200.0, 0.9, 0.1), steps_per_contact=22)
    h = 0.999 * c.step_limit()
    for _ in range(round(0.025 / h / sub_steps)):
        p.advance(sub_steps * h, c)
    assert np.abs(np.abs(p.velocity[:, 0]) - 0.27).max() < 0.002 and (p.velocity[np.argsort(p.id), 0] * (1, -1) < 0).all()


def test_the_step_is_that_of_the_pairs_there_are():
    """Soft small beads beside stiff large ones: the stiffest table entry does not meet the lightest bead."""
    mesh, _ = fe_el.box((0.1,) * 3, (2, 2, 2))
    p = fe_el.Particles(mesh, 2500.0)
    p.insert_at([(0.02, 0.02, 0.02)], 5e-4, material=0)
    p.insert_at([(0.06, 0.06, 0.06)], 5e-3, material=1)
    law = fe_el.LinearSpringDashpot([[100.0, 200.0], [200.0, 1000.0]], 0.9, 0.1)
    c = fe_el.Contacts(p, law, steps_per_contact=50)
    mass = 2500.0 * np.pi / 6 * np.array([5e-4, 5e-3]) ** 3
    pairs = [(mass[0] / 2, 100.0), (1 / (1 / mass).sum(), 200.0), (mass[1] / 2, 1000.0)]
    assert c.step_limit() == pytest.approx(min(np.pi * np.sqrt(m / k) for m, k in pairs) / 50, rel=2e-3)


@pytest.mark.parametrize("number", range(2, 8))
def test_many_sub_steps_in_one_call_are_the_same_as_one_by_one(number):
    """Contacts of 1 to 6 touching pairs, a facet and a moving plane: blocks that no multiple of four fills."""
    states = []
    for one_by_one in (False, True):
        mesh, tags = fe_el.box((0.05, 0.02, 0.02), (5, 2, 2))
        beads = fe_el.Particles(mesh, 2500.0, (0, 0, -9.81))
        x = np.column_stack([0.005 + 0.00195 * np.arange(number), np.full(number, 0.01), np.full(number, 0.00098)])
        beads.insert_at(x, 0.002, velocity=0.1 * np.random.default_rng(1).normal(size=x.shape))
        law = fe_el.LinearSpringDashpot(1e3, 0.8, 0.3)
        plane = fe_el.PlaneWall((0.0041, 0, 0), (1, 0, 0), velocity=(0.05, 0, 0))
        contacts = fe_el.Contacts(beads, law, [fe_el.FacetWalls(tags, 5), plane])
        if one_by_one:
            contacts._compiled_steps = contacts._steps
        for _ in range(10):
            beads.advance(2e-4, contacts)
        states.append(np.hstack([beads.position, beads.velocity, beads.angular_velocity, beads.contact_force]))
    scale = np.abs(states[0]).max(0)
    assert (np.abs(states[0] - states[1]) <= 1e-11 * scale).all()
    assert np.abs(states[0][:, 3:6]).max() > 1e-3


def test_pairs_left_out_as_too_far_never_touch():
    """Lists of any reach give one motion, though each leaves out other pairs from one sub-step to the next."""
    runs = []
    for skin in (2e-4, 1e-3):
        mesh, tags = fe_el.box((0.02, 0.02, 0.02), (2, 2, 2))
        beads = fe_el.Particles(mesh, 2500.0)
        grid = 0.0022 * np.stack(np.meshgrid(*[np.arange(5)] * 3), -1).reshape(-1, 3) + 0.005
        beads.insert_at(grid, 0.002, velocity=0.5 * np.random.default_rng(2).normal(size=grid.shape))
        contacts = fe_el.Contacts(beads, fe_el.LinearSpringDashpot(1e3, 0.9, 0.1), (tags, (1, 2, 3, 4, 5, 6)), skin=skin)
        for _ in range(4):
            beads.advance(5e-4, contacts)
        order = np.argsort(beads.id)
        runs.append(np.hstack([beads.position[order], beads.velocity[order]]))
    assert np.abs(runs[0] - runs[1]).max() < 1e-10 * np.abs(runs[0]).max()


def bed_in_waves(period, monkeypatch, waves_on, times, rate=0.0):
    """State of a bed of 900 beads on a floor, with sub-steps that follow each other or not, and its lists."""
    rebuild = ContactLists.rebuild

    def without_waves(lists, *args):
        rebuild(lists, *args)
        lists.tiles = waves.NONE

    with monkeypatch.context() as patch:
        patch.setattr(waves, "FROM", 100)
        patch.setattr(waves, "SLAB", 20)
        if not waves_on:
            patch.setattr(ContactLists, "rebuild", without_waves)
        mesh, tags = fe_el.periodic_box((0.06, 0.01, 0.02), (12, 3, 3), period)
        beads = fe_el.Particles(mesh, 2500.0, (0, 0, -9.81))
        beads.insert_on_lattice((0, 0, 0), (0.06, 0.01, 0.02), np.full(900, 1e-3), seed=1)
        contacts = fe_el.Contacts(beads, fe_el.LinearSpringDashpot(1e3, 0.9, 0.1), (tags, 5 if period[0] else (1, 2, 5)))
        for _ in range(times):
            beads.relaxation_rate[:], beads.force[:] = rate, -0.3 * rate * beads.mass[:, None] * beads.velocity
            beads.advance(5e-4, contacts)
    assert (len(contacts.lists.tiles.starts) > 10) == waves_on
    order = np.argsort(beads.id)
    return np.hstack([beads.position, beads.velocity, beads.angular_velocity, beads.contact_force])[order], contacts


PERIODS = pytest.mark.parametrize("period", [(False, True, False), (True, True, False)])


@PERIODS
@pytest.mark.parametrize("rate", [0.0, 500.0])
def test_waves_through_a_large_bed_give_the_same_to_the_last_digit(period, rate, monkeypatch):
    """Sub-steps that follow each other through slabs of a bed on a floor, against one after the other on the same lists."""
    together, contacts = bed_in_waves(period, monkeypatch, True, 60, rate)
    assert contacts.lists.tiles.strips == 1 and contacts.touching > 100
    assert (together == bed_in_waves(period, monkeypatch, False, 60, rate)[0]).all()


@PERIODS
def test_waves_in_blocks_of_strips_give_the_same(period, monkeypatch):
    """Blocks change the order of a few sums: the same up to round-off, after 40 steps of falling and touching the floor."""
    monkeypatch.setattr(waves, "IN_CACHE", 50)
    together, contacts = bed_in_waves(period, monkeypatch, True, 40)
    tiles = contacts.lists.tiles
    assert tiles.strips > tiles.width > 1 and tiles.at_once >= 2 and contacts.touching > 20
    monkeypatch.setattr(waves, "IN_CACHE", 10**6)
    alone, _ = bed_in_waves(period, monkeypatch, False, 40)
    scale = np.abs(alone).max(0)
    assert (np.abs(together - alone) < 1e-8 * scale.reshape(4, 3).max(1).repeat(3)).all()


def test_a_wave_is_as_long_as_displacements_allow():
    """Twice the speed, and twice what it gains, over all of its sub-steps; never beyond what is left to do."""
    assert waves.wave_length(3, 1.0, 0.1, 0.0, 0.0)[0] == 3
    assert waves.wave_length(100, 1.0, 0.1, 1.2, 0.0) == (4, pytest.approx(0.96))
    assert waves.wave_length(100, 1.0, 0.1, 0.0, 0.4) == (3, pytest.approx(0.72))
    assert waves.wave_length(100, 1.0, 0.1, np.inf, 0.0) == (1, 0.0)


def test_waves_follow_each_other_within_the_caches():
    """Particles between the first and the last sub-step: as many as the caches hold, in blocks where slabs hold too many."""
    slabs, slab = 1000, waves.IN_CACHE // 100
    assert waves.at_once(slabs * slab, slabs, 4, 1, 0) == (waves.AT_ONCE, 1 + 7)  # 100 slabs are in the caches: 5 for each
    number, block = waves.at_once(slabs * slab * 5, slabs, 4, 100, 2)  # four sub-steps, or eight in blocks of half of it
    assert (number, block) == (waves.AT_ONCE, 50)
    number, block = waves.at_once(slabs * slab * 5, slabs, 4, 1, 0)
    assert number == 4 and block >= 1
    assert waves.at_once(10**6, 10, 5, 1, 0)[0] == 2  # never fewer


@pytest.mark.filterwarnings("error")
def test_tiles_of_a_line_and_of_a_sheet():
    """Particles within reach are few slabs and strips apart; a line has no strips to cut."""
    line = np.zeros((20000, 3))
    line[:, 0] = np.linspace(0.0, 20.0, 20000)
    tile, strips = waves.tiles(line, None, 5.0)
    assert strips == 1 and (np.diff(tile) >= 0).all() and tile[-1] == 7  # two slabs in the reach
    sheet = np.random.default_rng(0).uniform(size=(20000, 3)) * [2.0, 1.0, 0.0]
    tile, strips = waves.tiles(sheet, (2.0, 0.0, 0.0), 0.2)
    near = (np.abs(sheet[:, None, :2] - sheet[None, :50, :2]) < 0.2).all(2)
    assert strips > 1
    for kind, most in ((tile // strips, waves.FINE + 1), (tile % strips, waves.STRIPS + 1)):
        assert np.abs(kind[:, None] - kind[None, :50])[near].max() <= most
