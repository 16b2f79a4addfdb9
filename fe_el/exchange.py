"""Exchange of array entries between ranks: each entry has one owner, other ranks hold ghosts of it."""
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
        self.comm = comm
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

    def _swap(self, array, outgoing, incoming):
        buffers = [np.empty((len(i),) + array.shape[1:], array.dtype) for _, i in incoming]
        requests = [self.comm.Irecv(b, source=rank) for (rank, _), b in zip(incoming, buffers)]
        packed = [np.ascontiguousarray(array[i]) for _, i in outgoing]
        requests += [self.comm.Isend(b, dest=rank) for (rank, _), b in zip(outgoing, packed)]
        for request in requests:
            request.Wait()
        return buffers

    def forward(self, array):
        """Set the ghosts in ``array`` to their owners' values."""
        for (_, i), values in zip(self.receive, self._swap(array, self.send, self.receive)):
            array[i] = values
        return array

    def reverse_add(self, array):
        """Add the ghosts' values to their owners' entries (the ghosts keep theirs)."""
        for (_, i), values in zip(self.send, self._swap(array, self.receive, self.send)):
            np.add.at(array, i, values)
        return array


def move(comm, destination, arrays):
    """Send row k of every array to rank ``destination[k]``; return what arrived, one array each, by sending rank."""
    rows = [np.flatnonzero(destination == rank) for rank in range(comm.size)]
    parts = comm.alltoall([[a[k] for a in arrays] for k in rows])
    return [np.concatenate([p[i] for p in parts]) for i in range(len(arrays))]
