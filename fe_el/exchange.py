"""Exchange of array entries between ranks: each entry has one owner, other ranks hold ghosts of it."""
import math

import numpy as np
from mpi4py import MPI


def largest_of(comm, *numbers):
    """Largest of each number over all ranks, as an array. Collective."""
    out = np.empty(len(numbers))
    comm.Allreduce(np.array(numbers, float), out, op=MPI.MAX)
    return out


def raise_everywhere(comm, error, message):
    """Raise ``error(message)`` on every rank if any rank has a message. Collective."""
    messages = [m for m in comm.allgather(message) if m] if comm.size > 1 else [message] * bool(message)
    if messages:
        raise error(messages[0])


class Halo:
    """Copies of owned entries on other ranks, with the two directions of exchange.

    Args:
        comm: MPI communicator.
        send: for each rank, the local indices of the owned entries it holds ghosts of.
        receive: for each rank, the local indices of our ghosts of its entries, in the same order.
    """

    def __init__(self, comm, send, receive):
        self.comm, self._plans = comm, {}
        self.send = [(rank, np.asarray(i, np.int64)) for rank, i in enumerate(send) if len(i)]
        self.receive = [(rank, np.asarray(i, np.int64)) for rank, i in enumerate(receive) if len(i)]

    @classmethod
    def of_requests(cls, comm, ghosts, owners, remote):
        """Build from the ghosts' side: entry ``ghosts[k]`` here is entry ``remote[k]`` of rank ``owners[k]``."""
        wanted = [np.flatnonzero(owners == rank) for rank in range(comm.size)]
        send = comm.alltoall([np.asarray(remote)[k] for k in wanted]) if comm.size > 1 else [[]]
        return cls(comm, send, [np.asarray(ghosts)[k] for k in wanted])

    @classmethod
    def of_index_map(cls, comm, index_map):
        """Build for the ghosts of a dolfinx index map (owned entries first)."""
        if comm.size == 1:
            return cls(comm, [[]], [[]])
        starts = np.array(comm.allgather(index_map.local_range[0]))
        ghosts = np.asarray(index_map.ghosts)
        owners = np.searchsorted(starts, ghosts, side="right") - 1
        local = index_map.size_local + np.arange(len(ghosts))
        return cls.of_requests(comm, local, owners, ghosts - starts[owners])

    def _plan(self, forward, shapes, kind):
        """Rows with the parts of the buffers that hold them, going out and coming in, and the messages; made once."""
        key = forward, shapes, kind
        if key not in self._plans:
            def parts(sides):
                rows, buffers = [], []
                for rank, i in sides:
                    ends = np.cumsum([0] + [len(i) * math.prod(shape) for shape in shapes])
                    buffers.append((rank, np.empty(ends[-1], kind)))
                    rows.append((i, [buffers[-1][1][k:end].reshape(len(i), *shape) for k, end, shape in zip(ends, ends[1:], shapes)]))
                return rows, buffers
            (out, to), (into, of) = (parts(side) for side in (self.send, self.receive)[::1 if forward else -1])
            messages = [self.comm.Recv_init(b, source=rank) for rank, b in of] + [self.comm.Send_init(b, dest=rank) for rank, b in to]
            self._plans[key] = out, into, messages
        return self._plans[key]

    def __del__(self):
        if MPI is not None and not MPI.Is_finalized():  # None where Python is about to end
            for *_, messages in self._plans.values():
                for message in messages:
                    message.Free()

    def _swap(self, arrays, forward):
        """Send rows of all arrays as one message to each rank; returns rows and their values, by rank."""
        out, into, messages = self._plan(forward, tuple(a.shape[1:] for a in arrays), arrays[0].dtype)
        for i, parts in out:
            for a, part in zip(arrays, parts):
                np.take(a, i, 0, part, "clip")
        MPI.Prequest.Startall(messages)
        MPI.Request.Waitall(messages)
        return into

    def forward(self, *arrays):
        """Set the ghosts in arrays of one type to their owners' values; returns the first array."""
        if self.send or self.receive:
            for i, parts in self._swap(arrays, True):
                for a, part in zip(arrays, parts):
                    a[i] = part
        return arrays[0]

    def reverse_add(self, *arrays):
        """Add the ghosts' values to their owners' entries (the ghosts keep theirs); returns the first array."""
        if self.send or self.receive:
            for i, parts in self._swap(arrays, False):
                for a, part in zip(arrays, parts):
                    a[i] += part  # no entry is there twice
        return arrays[0]

    def complete(self, *arrays):
        """Make sums over the entries of this rank complete on all."""
        self.reverse_add(*arrays)
        self.forward(*arrays)


def move(comm, destination, arrays):
    """Send row k of every array to rank ``destination[k]``; return what arrived, one array each, by sending rank."""
    rows = [np.flatnonzero(destination == rank) for rank in range(comm.size)]
    parts = comm.alltoall([[a[k] for a in arrays] for k in rows])
    return [np.concatenate([p[i] for p in parts]) for i in range(len(arrays))]
