"""Exchange of entries between ranks: sums and copies, on the nodes of a mesh and on random sharings."""
import numpy as np
import pytest
from mpi4py import MPI

import fe_el
from fe_el.dolfinx_api import scalar_space
from fe_el.parallel.exchange import Halo

COMM = MPI.COMM_WORLD


def nodes():
    """Halo of the nodes of a box, and the global number of each."""
    mesh, _ = fe_el.box((1.0, 1.0, 1.0), (4, 4, 4))
    index_map = scalar_space(mesh, "P", 1).dofmap.index_map
    here = np.arange(index_map.size_local + index_map.num_ghosts, dtype=np.int32)
    return Halo.of_index_map(COMM, index_map), index_map.local_to_global(here)


@pytest.mark.ranks
def test_complete_sums_are_the_same_to_the_last_digit_on_all_ranks():
    """Parts that differ in size by 1e12, so that the order of a sum shows: every rank must have added in the same order."""
    halo, number = nodes()
    rng = np.random.default_rng(COMM.rank)
    one, three = (rng.normal(size=(len(number), *shape)) * 10.0 ** rng.uniform(-6, 6, (len(number), *shape))
                  for shape in ((), (3,)))
    parts = COMM.allgather((number, one.copy(), three.copy()))
    halo.complete(one, three)
    total = np.zeros((125, 4))
    for where, a, b in parts:  # in the order of the ranks
        total[where] += np.column_stack([a, b])
    assert (total[number] == np.column_stack([one, three])).all()


@pytest.mark.ranks
def test_what_is_added_to_owners_comes_back_to_the_ghosts():
    """reverse_add and forward, of whole numbers: the same as complete."""
    halo, number = nodes()
    one = number * (COMM.rank + 1)
    two = one.copy()
    halo.complete(one)
    assert halo.forward(halo.reverse_add(two)) is two
    assert (one == two).all() and one.dtype == number.dtype


@pytest.mark.ranks
@pytest.mark.parametrize("seed", range(3))
def test_entries_shared_by_any_ranks(seed):
    """Every rank has a random part of 40 entries; the owner of each is its first holder, and some ranks may have none."""
    has = np.random.default_rng(seed).random((COMM.size, 40)) < 0.5
    has[0] |= ~has.any(0)
    if seed == 2 and COMM.size > 1:
        has[0, :20], has[1] = True, np.arange(40) >= 20  # nothing in common
        has[0, 20:] = False
    owner = has.argmax(0)
    mine = np.flatnonzero(has[COMM.rank])
    owned = owner[mine] == COMM.rank
    place = np.array([np.flatnonzero(has[owner[e]]).searchsorted(e) for e in mine], int)
    halo = Halo.of_requests(COMM, np.flatnonzero(~owned), owner[mine[~owned]], place[~owned])
    value = np.ones((len(mine), 2)) * (COMM.rank + 1)
    halo.complete(value)
    assert (value == ((np.arange(COMM.size) + 1)[:, None] * has).sum(0)[mine][:, None]).all()


@pytest.mark.ranks
def test_arrays_that_cannot_be_sent_together_are_refused():
    """Two types, or memory with holes: an error on every rank, not garbage."""
    halo, number = nodes()
    if COMM.size > 1:
        with pytest.raises(ValueError, match="one type"):
            halo.forward(number, np.zeros(len(number)))
        with pytest.raises(ValueError, match="contiguous"):
            halo.complete(np.zeros((len(number), 2))[:, 0])
    else:
        assert halo.forward(number) is number
