"""Exchange of array entries between ranks: each entry has one owner, other ranks hold ghosts of it."""
import math

import numpy as np
from mpi4py import MPI

from fe_el.compiled.cache import njit
from fe_el.parallel.messages import exchange, messages_of


def largest_of(comm, *numbers):
    """Largest of each number over all ranks, as an array. Collective."""
    return _over_ranks(comm, numbers, MPI.MAX)


def sums_of(comm, *numbers):
    """Sum of each number over all ranks, as an array. Collective."""
    return _over_ranks(comm, numbers, MPI.SUM)


def _over_ranks(comm, numbers, operation):
    own = np.array(numbers, float)
    if comm.size == 1:
        return own
    out = np.empty_like(own)
    comm.Allreduce(own, out, op=operation)
    return out


def total_of(comm, value):
    """Sum of a number or an array over all ranks; of one rank the value itself. Collective."""
    return comm.allreduce(value) if comm.size > 1 else value


def raise_everywhere(comm, error, message):
    """Raise ``error(message)`` on every rank if any rank has a message. Collective."""
    if largest_of(comm, float(bool(message)))[0]:  # a number costs less than texts, the more the more ranks there are
        raise error(next(m for m in comm.allgather(message) if m))


class Halo:
    """Copies of owned entries on other ranks, with the two directions of exchange.

    Args:
        comm: MPI communicator.
        send: for each rank, the local indices of the owned entries it holds ghosts of.
        receive: for each rank, the local indices of our ghosts of its entries, in the same order.
    """

    def __init__(self, comm, send, receive):
        self.comm, self._plans, self._sharing = comm, {}, None
        self.send = [(rank, np.asarray(i, np.int64)) for rank, i in enumerate(send) if len(i)]
        self.receive = [(rank, np.asarray(i, np.int64)) for rank, i in enumerate(receive) if len(i)]

    @classmethod
    def of_requests(cls, comm, ghosts, owners, remote):
        """Build from the ghosts' side: entry ``ghosts[k]`` here is entry ``remote[k]`` of rank ``owners[k]``."""
        wanted = [np.flatnonzero(owners == rank) for rank in range(comm.size)]
        send = comm.alltoall([np.asarray(remote)[k] for k in wanted]) if comm.size > 1 else [[]]
        return cls(comm, send, [np.asarray(ghosts)[k] for k in wanted])

    @classmethod
    def of_index_map(cls, comm, index_map, used=None):
        """Build for the ghosts of a dolfinx index map (owned entries first); with ``used``, a mask, for those it marks."""
        if comm.size == 1:
            return cls(comm, [[]], [[]])
        starts = np.array(comm.allgather(index_map.local_range[0]))
        ghosts = np.asarray(index_map.ghosts)
        owners = np.searchsorted(starts, ghosts, side="right") - 1
        local = index_map.size_local + np.arange(len(ghosts))
        wanted = slice(None) if used is None else used[index_map.size_local:]
        return cls.of_requests(comm, local[wanted], owners[wanted], (ghosts - starts[owners])[wanted])

    def _swap(self, how, out, into, arrays):
        """Send rows of all arrays (each (entries, numbers)) as one message to each rank; ``out`` and ``into`` say which.

        Returns rows and their values (rows, numbers of all arrays), by rank; the messages are made once.
        """
        key = how, tuple(a.shape[1] for a in arrays), arrays[0].dtype
        if key not in self._plans:
            rows = [np.concatenate([i for _, i in side] or [np.zeros(0, np.int64)]) for side in (out, into)]
            buffers = [np.empty((len(r), sum(key[1])), key[2]) for r in rows]
            messages = []
            for side, buffer, make in ((into, buffers[1], self.comm.Recv_init), (out, buffers[0], self.comm.Send_init)):
                ends = np.cumsum([0] + [len(i) for _, i in side])
                messages += [make(buffer[a:b], rank) for (rank, _), a, b in zip(side, ends, ends[1:])]
            self._plans[key] = (rows[0], buffers[0], messages_of(messages)), rows[1], buffers[1], messages
        plan, rows, values, _ = self._plans[key]
        send_rows(arrays, *plan)
        return rows, values

    def __del__(self):
        if MPI is not None and not MPI.Is_finalized():  # None where Python is about to end
            for *_, messages in self._plans.values():
                for message in messages:
                    message.Free()

    def forward(self, *arrays):
        """Set the ghosts in arrays of one type to their owners' values; returns the first array.

        Raises:
            ValueError: for arrays of different types, or that are not contiguous.
        """
        if self.send or self.receive:
            flat = _flat(arrays)
            take_rows(flat, False, *self._swap("forward", self.send, self.receive, flat))
        return arrays[0]

    def reverse_add(self, *arrays):
        """Add the ghosts' values to their owners' entries (the ghosts keep theirs); returns the first array."""
        if self.send or self.receive:
            flat = _flat(arrays)
            take_rows(flat, True, *self._swap("reverse", self.receive, self.send, flat))
        return arrays[0]

    def complete(self, *arrays):
        """Make sums over the entries of this rank complete on all: every rank adds up all parts, in the order of the ranks.

        Note:
            Collective.
        """
        if self.comm.size == 1:
            return
        if self._sharing is None:
            self._sharing = self._find_sharing()
        sides, places = self._sharing
        if sides:
            flat = _flat(arrays)
            add_up(flat, self._swap("complete", sides, sides, flat)[1], *places)

    def _find_sharing(self):
        """For each rank the entries we have in common with it, owned or not, and what to add up where. Collective."""
        size, me = self.comm.size, self.comm.rank
        # here, owner, there, shared with
        rows = [(i, np.full(len(i), me), i, np.full(len(i), rank)) for rank, i in self.send]
        told = [[]] * size
        for rank, i in self.send:
            told[rank] = [i] + [(other, np.intersect1d(i, j)) for other, j in self.send if other != rank]
        heard = self.comm.alltoall(told)
        for owner, here in self.receive:
            there, others = heard[owner][0], heard[owner][1:]
            order = np.argsort(there)
            rows.append((here, np.full(len(here), owner), there, np.full(len(here), owner)))
            for rank, common in others:
                mine = here[order[np.searchsorted(there, common, sorter=order)]]
                rows.append((mine, np.full(len(mine), owner), common, np.full(len(mine), rank)))
        here, owner, there, rank = (np.concatenate([r[k] for r in rows] or [np.zeros(0)]).astype(np.int64) for k in range(4))
        order = np.lexsort((there, owner, rank))  # by rank, and then alike on both sides
        here, rank = here[order], rank[order]
        sides = [(int(r), here[rank == r]) for r in np.unique(rank)]
        entries = np.unique(here)
        parts = [np.concatenate(p) for p in ((here, entries), (rank, np.full(len(entries), me)),
                                             (np.arange(len(here)), np.full(len(entries), -1)))]  # -1: our own part
        order = np.lexsort((parts[1], parts[0]))
        starts = np.searchsorted(parts[0][order], entries)
        return sides, (entries, np.append(starts, len(order)), parts[2][order])


def _flat(arrays):
    """Views (entries, numbers) of arrays of one type."""
    if len({a.dtype for a in arrays}) > 1 or not all(a.flags.c_contiguous for a in arrays):
        raise ValueError(f"Arrays of types {[str(a.dtype) for a in arrays]} cannot be exchanged at once, or one of them is "
                         f"not "
                         "contiguous; give whole arrays of one type.")
    return tuple(a.reshape(len(a), math.prod(a.shape[1:])) for a in arrays)


@njit
def send_rows(arrays, rows, out, messages):
    """Put rows of the arrays beside each other into the buffer, and exchange it."""
    at = 0
    for a in arrays:
        for n in range(len(rows)):
            for k in range(a.shape[1]):
                out[n, at + k] = a[rows[n], k]
        at += a.shape[1]
    exchange(messages)


@njit
def take_rows(arrays, add, rows, values):
    """Set rows of the arrays to what was received, or add it, one rank after the other."""
    at = 0
    for a in arrays:
        for n in range(len(rows)):
            for k in range(a.shape[1]):
                a[rows[n], k] = a[rows[n], k] + values[n, at + k] if add else values[n, at + k]
        at += a.shape[1]


@njit
def add_up(arrays, values, entries, starts, parts):
    """Sums of the parts of shared entries: rows of what was received, or -1 for what is here."""
    at = 0
    for a in arrays:
        width = a.shape[1]
        total = np.empty(width, a.dtype)
        for n in range(len(entries)):
            i = np.uint64(entries[n])
            total[:] = 0
            for part in range(starts[n], starts[n + 1]):
                p = np.uint64(parts[part])
                for k in range(width):
                    total[k] += a[i, k] if parts[part] < 0 else values[p, at + k]
            for k in range(width):
                a[i, k] = total[k]
        at += width


def move(comm, destination, arrays):
    """Send row k of every array to rank ``destination[k]``; return what arrived, one array each, by sending rank."""
    rows = [np.flatnonzero(destination == rank) for rank in range(comm.size)]
    parts = comm.alltoall([[a[k] for a in arrays] for k in rows])
    return [np.concatenate([p[i] for p in parts]) for i in range(len(arrays))]
