"""Rows that come and go in arrays with room to grow."""
import numpy as np
import pytest

import fe_el
from fe_el.particles import rows


def test_appended_rows_lie_in_the_same_memory_while_there_is_room():
    a, room = rows.appended(np.arange(16.0), np.array([16.0]), None)
    b, again = rows.appended(a, np.array([17.0]), room)
    assert np.array_equal(b, np.arange(18.0)) and again is room and b.base is room and len(room) == 19
    c, other = rows.appended(b, np.zeros(9), room)
    assert other is not room and np.array_equal(c[:18], b) and len(c) == 27
    part, other = rows.appended(b[2:], np.array([5.0]), room)  # a view that does not begin where the memory does
    assert other is not room and np.array_equal(part, [*range(2, 18), 5.0])


@pytest.mark.parametrize("gone, come", [(3, 0), (0, 3), (5, 2), (2, 5), (20, 0), (0, 0)])
def test_replaced_rows(gone, come):
    """What stays and what comes is there, whatever the order; other rows do not move more than they must."""
    rng, a = np.random.default_rng(gone + 10 * come), np.arange(20.0)
    holes = np.sort(rng.permutation(20)[:gone])
    b, _ = rows.replaced(a.copy(), holes, 100.0 + np.arange(come), None)
    assert np.array_equal(np.sort(b), np.sort([*np.delete(a, holes), *(100.0 + np.arange(come))]))
    assert np.count_nonzero(b[:20] != a[:len(b)]) <= gone


def test_what_is_known_of_a_particle_stays_together():
    """Points come in and leave through all sides; positions, users' properties and numbers remain those of their ids."""
    mesh, tags = fe_el.box((1.0, 1.0), (4, 4))
    p, rng = fe_el.Particles(mesh, 1000.0), np.random.default_rng(3)
    p.remove_at(tags, (1, 2, 3, 4))
    start, velocity, came = np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0)
    for step in range(40):
        count = int(rng.integers(1, 30))
        start = np.vstack([start, rng.random((count, 2))])
        velocity = np.vstack([velocity, rng.normal(size=(count, 2))])
        came = np.append(came, np.full(count, step))
        p.insert_at(start[-count:], 1e-3, velocity=velocity[-count:], number=1.0 + np.arange(p.next_id, p.next_id + count))
        p.properties.setdefault("mark", np.zeros(len(p)))[p.id >= p.next_id - count] = step
        p.advance(0.05)
        assert p.position[:, :2] == pytest.approx(start[p.id] + 0.05 * (step + 1 - came[p.id])[:, None] * velocity[p.id])
        assert np.array_equal(p.properties["mark"], came[p.id]) and np.array_equal(p.number, 1.0 + p.id)
        assert (p.cells.barycentric[p.cell] @ np.column_stack([p.position, np.ones(len(p))])[..., None]).min() > -1e-9
    assert p.left > 300 and len(p) + p.left == p.next_id
