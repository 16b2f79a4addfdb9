"""Overlap volumes: exact shares, continuous, without axes, alike on all ranks."""
import numpy as np
import pytest
from mpi4py import MPI
from numba import njit

import fe_el
from fe_el.coupling import overlap
from fe_el.coupling.over_filled import Spill
from fe_el.coupling.overlap import OverlapVolume
from fe_el.mesh.cell_mesh import by_place
from fe_el.particles.location import walk


@njit
def shares_of_points(barycentric, neighbour, shift, cell, position, radius, points, cells):
    """(particles, cells) parts of the points of each sphere inside the mesh."""
    out, place = np.zeros((len(cell), cells)), np.empty(3)
    for i in range(len(cell)):
        for s in range(len(points)):
            place[:] = position[i] + radius[i] * points[s]
            c = walk(barycentric, neighbour, shift, cell[i], place, 1000)
            if c >= 0:
                out[i, c] += 1
        out[i] /= out[i].sum()
    return out


def points_in_ball(number, seed=0):
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(number, 3))
    return x / np.linalg.norm(x, axis=1)[:, None] * rng.random((number, 1)) ** (1 / 3)


def shares(particles):
    """(particles, cells) shares of every particle."""
    mapping, out = OverlapVolume(), np.zeros((len(particles), len(particles.cells.volume)))
    mapping.prepare(particles.cells, particles.cell, particles.position, particles.diameter / 2)
    rows = np.repeat(np.arange(len(particles)), np.diff(mapping.start))
    np.add.at(out, (rows, mapping.cell), mapping.weight)
    return out


def spheres(mesh, position, diameter, **kwargs):
    p = fe_el.Particles(mesh, 1000.0, **kwargs)
    p.insert_at(position, diameter)
    return p


@pytest.mark.parametrize("ratio", [12, 6, 3, 1, 0.3])
@pytest.mark.parametrize("dimension", [2, 3])
def test_shares_are_those_of_random_points(ratio, dimension):
    """Edge of squares or cubes over diameter from 12 to 0.3: the error is that of 4,000 points."""
    n = 8
    mesh, _ = fe_el.periodic_box((1.0,) * dimension, (n,) * dimension)
    p = spheres(mesh, np.random.default_rng(1).random((100, dimension)), 1 / n / ratio)
    points = points_in_ball(4000)
    true = shares_of_points(p.cells.barycentric, p.cells.neighbour, p.cells.shift, p.cell, p.position, p.diameter / 2,
                            points,
                            len(p.cells.volume))
    noise = np.sqrt((true * (1 - true)).sum(1).mean() / len(points))
    error = np.sqrt(((shares(p) - true) ** 2).sum(1).mean())
    assert error < 1.25 * noise < 0.025


def test_cells_inside_a_sphere_have_shares_of_their_volume():
    """A sphere of 10 cells, its centre on a vertex: cells wholly inside are exact, its volume is that of all shares."""
    n = 14
    mesh, _ = fe_el.box((1.0, 1.0, 1.0), (n, n, n))
    p = spheres(mesh, [[0.5, 0.5, 0.5], [0.512, 0.49, 0.5037]], 10 / n)
    for x, share in zip(p.position, shares(p)):
        inside = (np.linalg.norm(p.cells.corner - x, axis=2) < 5 / n).all(1)
        assert inside.sum() > 2000 and share.sum() == pytest.approx(1, abs=1e-14)
        assert np.allclose(share[inside] * p.volume[0], p.cells.volume[inside], rtol=2e-5)


@pytest.mark.parametrize("where", [(0.5, 0.5, 0.5), (0.5, 0.5, 0.37), (0.4, 0.5, 0.3), (0.0, 0.2, 0.3), (0.0, 0.0, 0.0)])
@pytest.mark.parametrize("diameter", [0.01, 0.1, 0.4, 1.3])
def test_shares_move_no_more_than_the_sphere(where, diameter):
    """Across a vertex, an edge, a facet, at a wall and in a corner: a small move changes the shares by as little."""
    mesh, _ = fe_el.box((1.0, 1.0, 1.0), (4, 4, 4))
    step = 1e-6 * diameter * np.array([1.0, 0.37, 0.61])
    p = spheres(mesh, np.clip(where + np.arange(-5, 6)[:, None] * step, 0, 1), diameter)
    order = np.argsort(p.id)
    assert np.abs(np.diff(shares(p)[order], axis=0)).sum(1).max() < 1e-5


def test_shares_do_not_jump_with_the_diameter():
    mesh, _ = fe_el.box((1.0, 1.0, 1.0), (4, 4, 4))
    diameter = np.concatenate([d * (1 + 1e-6 * np.arange(3)) for d in np.geomspace(0.01, 3.0, 60)])
    p = spheres(mesh, np.tile([[0.33, 0.41, 0.56]], (len(diameter), 1)), diameter)
    change = np.abs(np.diff(shares(p)[np.argsort(p.id)], axis=0)).sum(1)
    assert change[np.arange(len(change)) % 3 < 2].max() < 1e-5


def test_shares_do_not_know_the_axes():
    """Mesh and spheres turned together: the same shares."""
    plain, _ = fe_el.box((1.0, 1.0, 1.0), (3, 3, 3), comm=MPI.COMM_SELF)
    turned, _ = fe_el.box((1.0, 1.0, 1.0), (3, 3, 3), comm=MPI.COMM_SELF)
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    turned.geometry.x[:] = turned.geometry.x @ turn.T
    x, d = np.random.default_rng(3).random((200, 3)), np.linspace(0.01, 1.0, 200)
    one, other = spheres(plain, x, d), spheres(turned, x @ turn.T, d)
    assert np.abs(shares(one) - shares(other)).max() < 1e-10


def solid_fraction(comm, diameter, largest, dimension=3):
    """Solid fraction by place of the cell, on every rank, of spheres over the whole box, after the spill; and the spill."""
    mesh, _ = fe_el.box((1.0,) * dimension, (6,) * dimension, comm=comm)
    p = spheres(mesh, np.random.default_rng(4).uniform(0.1, 0.9, (20, dimension)), diameter)
    mapping, content = OverlapVolume(), np.zeros((len(p.cells.volume), 1))
    mapping.prepare(p.cells, p.cell, p.position, p.diameter / 2)
    mapping.deposit(p.volume[:, None], content)
    content = p.halo.forward(p.halo.reverse_add(content))
    spill, n = Spill(p.cells, p.halo, content[:, 0], largest), p.cells.owned
    solid = spill(content)[:n, 0] / p.cells.volume[:n]
    parts = comm.allgather((p.cells.corner[:n].mean(1), solid))
    x, solid = np.concatenate([a for a, _ in parts]), np.concatenate([b for _, b in parts])
    return solid[by_place(x)], spill


@pytest.mark.ranks
@pytest.mark.parametrize("diameter, largest", [(0.05, 0.03), (0.3, 0.5)])
@pytest.mark.parametrize("dimension", [2, 3])
def test_solid_fraction_does_not_depend_on_ranks(diameter, largest, dimension):
    """Smaller than the cells and larger, with cells that spill."""
    many, spill = solid_fraction(MPI.COMM_WORLD, diameter, largest, dimension)
    one, _ = solid_fraction(MPI.COMM_SELF, diameter, largest, dimension)
    assert MPI.COMM_WORLD.allreduce(spill.over_filled) > 0 or dimension == 2
    assert np.abs(many - one).max() < 1e-11


def one_large_sphere(size=10, n=12):
    """Content of the cells in and around a sphere of ``size`` cells' diameters."""
    mesh, _ = fe_el.box((1.0, 1.0, 1.0), (n, n, n))
    p = spheres(mesh, [[0.5, 0.49, 0.513]], size / n)
    mapping, content = OverlapVolume(), np.zeros((len(p.cells.volume), 1))
    mapping.prepare(p.cells, p.cell, p.position, p.diameter / 2)
    mapping.deposit(p.volume[:, None], content)
    return p, p.halo.forward(p.halo.reverse_add(content))


@pytest.mark.ranks
@pytest.mark.parametrize("size", [2, 5, 10])
def test_excess_of_a_large_sphere_finds_room(size):
    """No cell above the limit, nothing lost, nothing negative, and the way back is the transpose."""
    p, content = one_large_sphere(size=size)
    spill, n = Spill(p.cells, p.halo, content[:, 0], 0.74), p.cells.owned
    total = lambda a: p.comm.allreduce(a[:n].sum())
    after = spill(content)
    assert p.comm.allreduce(spill.over_filled) > 0
    assert (after[:n, 0] <= 0.74 * p.cells.volume[:n] * (1 + 1e-11)).all() and (after >= 0).all()
    assert total(after) == pytest.approx(total(content), rel=1e-13)
    rng = np.random.default_rng(p.comm.rank)
    a, b = (p.halo.forward(rng.random((len(content), 2))) for _ in range(2))
    assert total(spill(a) * b) == pytest.approx(total(a * spill.transpose(b)), rel=1e-12)


def test_spilled_contents_move_no_more_than_the_contents():
    p, content = one_large_sphere(size=4)
    change = 1e-6 * content * np.random.default_rng(1).random(content.shape)
    after = [Spill(p.cells, p.halo, c[:, 0], 0.74)(c) for c in (content, content + change)]
    assert np.abs(after[1] - after[0]).sum() < 1.01 * change.sum()


@pytest.mark.ranks
def test_solid_that_does_not_fit_is_refused_on_all_ranks():
    p, content = one_large_sphere()
    with pytest.raises(RuntimeError, match="do not fit.*solid fraction"):
        Spill(p.cells, p.halo, content[:, 0], 0.3)


def test_many_particles_in_any_order_have_the_same_shares(monkeypatch):
    """Cell by cell or as they lie in memory: deposits and gathers agree to round-off; ordered particles stay as they are."""
    mesh, _ = fe_el.periodic_box((1.0, 1.0, 1.0), (12, 12, 12))
    beads = fe_el.Particles(mesh, 1000.0)
    beads.insert_in_box((0, 0, 0), (1, 1, 1), 60_000, diameter=np.linspace(0.005, 0.03, 60_000), seed=3)
    cells, quantity, found = beads.cells, np.random.default_rng(1).normal(size=(60_000, 5)), []
    field = np.random.default_rng(2).normal(size=(len(cells.volume), 6))
    for many in (50_000, 10 ** 9):
        monkeypatch.setattr(overlap, "MANY", many)
        shares, sums, means = overlap.OverlapVolume(), np.zeros((len(cells.volume), 5)), np.empty((60_000, 6))
        shares.prepare(cells, beads.cell, beads.position, 0.5 * beads.diameter)
        shares.deposit(quantity, sums)
        shares.gather(field, means)
        found.append((sums, means))
        assert len(shares.order) == (60_000 if many == 50_000 else 0)
    for a, b in zip(*found):
        assert np.allclose(a, b, rtol=1e-12, atol=1e-12)
    order = np.argsort(beads.cell, kind="stable")
    monkeypatch.setattr(overlap, "MANY", 50_000)
    shares.prepare(cells, beads.cell[order], beads.position[order], 0.5 * beads.diameter[order])
    assert not len(shares.order)
