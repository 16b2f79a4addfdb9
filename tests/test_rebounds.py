"""Rebounds from boundary groups without contacts."""
import numpy as np
import pytest

import fe_el


@pytest.mark.ranks
@pytest.mark.parametrize("dimension", [2, 3])
def test_a_billiard_keeps_its_energy(dimension, by_id):
    """Points in a closed box go where mirror images would, several rebounds in a step included."""
    mesh, tags = fe_el.box((1.0,) * dimension, (4,) * dimension)
    p, rng = fe_el.Particles(mesh, 1000.0), np.random.default_rng(1)
    x, v = rng.uniform(0.1, 0.9, (200, dimension)), rng.uniform(-3, 3, (200, dimension))
    p.insert_at(x, 1e-3, velocity=v)
    p.rebound_at(tags, tuple(range(1, 2 * dimension + 1)))
    for _ in range(10):
        p.advance(0.1)
    to = x + v
    fold = np.abs((to + 1) % 2 - 1)
    assert by_id(p, p.position)[:, :dimension] == pytest.approx(fold, abs=1e-9)
    assert by_id(p, p.velocity)[:, :dimension] == pytest.approx(v * (-1.0) ** np.floor(to), abs=1e-9)


@pytest.mark.ranks
def test_rebounds_lose_normal_velocity_and_leave_open_boundaries_open():
    mesh, tags = fe_el.box((1.0, 1.0), (4, 4))
    p = fe_el.Particles(mesh, 1000.0)
    p.insert_at([(0.5, 0.1), (0.9, 0.5)], 1e-3, velocity=[(0.2, -2.0), (2.0, 0.0)])
    p.remove_at(tags, 2)
    p.rebound_at(tags, 3, restitution=0.5)
    p.advance(0.1)
    assert p.left == 1 and p.total_number == 1
    assert p.comm.allreduce(p.velocity.sum(0)) == pytest.approx([0.2, 1.0, 0])
    assert p.comm.allreduce(p.position.sum(0)) == pytest.approx([0.52, 0.05, 0])
    with pytest.raises(fe_el.LostParticle):
        for _ in range(20):
            p.advance(0.1)
    with pytest.raises(ValueError, match="restitution of a rebound is 2"):
        p.rebound_at(tags, 3, 2)
