"""Sub-steps that follow each other through the beads of each rank, away from the other ranks."""
import numpy as np
import pytest

import fe_el
from fe_el.particles.contacts import waves
from fe_el.particles.contacts.contact_lists import ContactLists


def gas_of_beads(period, monkeypatch, waves_on):
    """Numbers of 4000 beads that fly about in a box; their positions, velocities, spins and forces after some hundred
    sub-steps; and their contacts."""
    rebuild = ContactLists.rebuild

    def without_waves(lists, *args):
        rebuild(lists, *args)
        lists.tiles = waves.NONE

    with monkeypatch.context() as patch:
        patch.setattr(waves, "FROM", 20)
        patch.setattr(waves, "SLAB", 10)
        if not waves_on:
            patch.setattr(ContactLists, "rebuild", without_waves)
        mesh, tags = fe_el.periodic_box((0.06, 0.012, 0.012), (15, 3, 3), period, slices_along=0)
        beads = fe_el.Particles(mesh, 2500.0)
        grid = 0.0012 * (np.stack(np.meshgrid(range(50), range(10), range(10), indexing="ij"), -1).reshape(-1, 3) + 0.5)
        grid = grid[np.random.default_rng(3).permutation(len(grid))[:4000]]
        beads.insert_at(grid, 1e-3, velocity=0.4 * np.random.default_rng(2).normal(size=grid.shape))
        walls = [group for k in range(3) if not period[k] for group in (2 * k + 1, 2 * k + 2)]
        contacts = fe_el.Contacts(beads, fe_el.LinearSpringDashpot(1e3, 0.9, 0.3), (tags, walls) if walls else None,
                                  steps_per_contact=12)
        for _ in range(4):
            beads.advance(2e-4, contacts)
    order = np.argsort(beads.id)
    state = np.hstack([beads.position, beads.velocity, beads.angular_velocity, beads.contact_force])[order]
    return beads.id[order], state, contacts


@pytest.mark.ranks
@pytest.mark.parametrize("period", [(False, False, False), (True, True, False), (False, True, True)])
def test_waves_away_from_other_ranks_give_the_same_to_the_last_digit(period, monkeypatch):
    """Against one sub-step after the other on the same lists; the beads change ranks and come through seams."""
    number, together, contacts = gas_of_beads(period, monkeypatch, True)
    tiles, comm = contacts.lists.tiles, contacts.particles.comm
    assert tiles.at_once > 1 and len(tiles.starts) > 4 and comm.allreduce(contacts.touching) > 100
    assert len(tiles.ghost_x0) == (contacts.lists.ghosts.number if comm.size > 1 else 0)
    alone = gas_of_beads(period, monkeypatch, False)
    assert (number == alone[0]).all() and (together == alone[1]).all()


def test_layers_begin_at_other_ranks():
    """Layers by the distance from a box are half a reach thick, or hold enough particles; where there is no box, from an
    end. Those near other ranks become the first tile."""
    line = np.zeros((4000, 3))
    line[:, 0] = np.linspace(0.0, 20.0, 4000)
    box = np.array([[[19.0, -1.0, -1.0], [30.0, 1.0, 1.0]]])
    tile = waves.layers(line, box, 1.0)
    assert (tile[line[:, 0] >= 19.0] == 0).all() and tile[0] == tile.max() == 4000 // waves.SLAB
    assert (np.diff(tile) <= 0).all() and (np.diff(waves.layers(line, box[:0], 1.0)) >= 0).all()
    starts, tile = waves.first_tile(np.array([0, 2, 5, 7]), np.array([0, 0, 1, 1, 1, 2, 2, 2]), np.array([0, 3]))
    assert starts.tolist() == [0, 5, 7] and tile.tolist() == [0, 0, 0, 0, 0, 1, 1, 1]


def test_ghosts_that_move_far_widen_the_lists():
    """The largest displacement over its room, squared; what is not a number counts."""
    rows = type("Rows", (), {"x": np.array([[9.0, 0, 0], [1.0, 0, 0], [0, 2.0, 0]])})
    x0 = np.array([[0.5, 0, 0, 4.0], [0, 1.5, 0, 2.0]])
    assert waves.ghosts_moved.py_func(rows, 1, x0) == 1.0
    x0[1, 0] = np.nan
    assert np.isnan(waves.ghosts_moved.py_func(rows, 1, x0))
