"""Ghost particles: copies of particles of other ranks, and periodic images, that contacts need."""
import itertools
from typing import NamedTuple

import numpy as np
from mpi4py import MPI

from fe_el.compiled.cache import njit
from fe_el.compiled.direct_calls import Direct
from fe_el.compiled.parts import part
from fe_el.parallel.messages import exchange, messages_of, ranks_of
from fe_el.particles.contacts.neighbours import bounds


class GhostRows(NamedTuple):
    """What :func:`forward_state` needs: rows of particles that are ghosts elsewhere, and what is sent and received."""

    abroad: np.ndarray  #: rows of the particles that other ranks have ghosts of
    outgoing: np.ndarray  #: (abroad, 9) position, velocity, angular velocity
    incoming: np.ndarray  #: (ghosts, 9)
    images: np.ndarray  #: rows of the particles that have periodic images on this rank
    image_rows: np.ndarray  #: (images, 9) their part of ``incoming``
    shift: np.ndarray  #: (ghosts, 3) what is added to their positions [m]
    messages: tuple  #: see :func:`fe_el.parallel.messages.messages_of`
    ranks: tuple  #: see :func:`fe_el.parallel.messages.ranks_of`


@njit
def _inside(position, lower, upper):
    """Rows of the positions in a box."""
    rows, number = np.empty(len(position), np.int64), 0
    for i in range(len(position)):
        here = True
        for k in range(3):
            here &= lower[k] <= position[i, k] <= upper[k]
        if here:
            rows[number] = i
            number += 1
    return rows[:number].copy()


@njit
def pack(rows, x, state, out):
    """Position, velocity and angular velocity of the particles in ``rows``, one after the other."""
    for n in range(len(rows)):
        i = rows[n]
        for k in range(3):
            out[n, k], out[n, 3 + k], out[n, 6 + k] = x[i, k], state[i, 1 + k], state[i, 4 + k]


@part
def unpack(packed, shift, first, owned, x, state):
    """Set ghosts from ``first`` on to what was packed, shifted for periodic images."""
    for n in range(len(packed)):
        i = first + n
        for k in range(3):
            x[i, k] = packed[n, k] + shift[i - owned, k]
            state[i, 1 + k], state[i, 4 + k] = packed[n, 3 + k], packed[n, 6 + k]


@njit
def forward_state(ghosts, owned, x, state):
    """Set the ghosts' positions (shifted for periodic images), velocities and angular velocities, in place. Collective."""
    pack(ghosts.abroad, x, state, ghosts.outgoing)
    pack(ghosts.images, x, state, ghosts.image_rows)
    exchange(ghosts.messages)
    unpack(ghosts.incoming, ghosts.shift, owned, owned, x, state)


_forward_state = Direct(forward_state)


def boxes_of(comm, low, high):
    """Boxes (ranks, 2, 3) with those two corners on each rank. Collective."""
    boxes = np.empty((comm.size, 2, 3))
    comm.Allgather(np.array([low, high]), boxes)
    return boxes


def offsets_of(period):
    """Of a periodic box's images, itself included, each (3,) [m]."""
    steps = [(-1, 0, 1) if period is not None and period[k] > 0 else (0,) for k in range(3)]
    return [np.array(o, float) * (0 if period is None else period) for o in itertools.product(*steps)]


def boxes_around(comm, position, reach, period):
    """Boxes (boxes, 2, 3) of the particles of other ranks, and of their images, which are within ``reach`` [m] of the box of
    these. Collective."""
    low, high, _ = bounds(position)
    boxes = np.delete(boxes_of(comm, low, high), comm.rank, 0)
    images = (boxes[:, None] + np.array(offsets_of(period))[None, :, None]).reshape(-1, 2, 3)
    return images[((images[:, 0] - reach <= high) & (images[:, 1] + reach >= low)).all(1)]


class Ghosts:
    """Which particles are sent where, and by how much their images are shifted.

    Args:
        comm: MPI communicator.
        position: (owned, 3) [m].
        reach (float): how far contacts reach [m].
        period: lengths of the periodic box, zero where it is not periodic; absent: none.

    Attributes:
        number: of ghosts on this rank; they follow the owned particles.
    """

    def __init__(self, comm, position, reach, period=None):
        self.comm, self.requests, n = comm, None, len(position)
        offsets = offsets_of(period)
        low, high, _ = bounds(position)
        boxes = boxes_of(comm, low - reach, high + reach)  # of no particles: from infinity to minus infinity
        near = np.any([((boxes[:, 0] - o <= high) & (boxes[:, 1] - o >= low)).all(1) for o in offsets], axis=0)
        self.send, shifts = [], []
        for rank, (lower, upper) in enumerate(boxes):
            rows, moved = [np.zeros(0, np.int64)], [np.zeros((0, 3))]
            for offset in offsets if near[rank] else ():
                if rank == comm.rank and not offset.any():
                    continue
                inside = _inside(position, lower - offset, upper - offset)
                rows.append(inside)
                moved.append(np.tile(offset, (len(inside), 1)))
            self.send.append(np.concatenate(rows))
            shifts.append(np.concatenate(moved))
        self._arrange(n, comm.alltoall(shifts))

    def _arrange(self, owned, shifts):
        """Counts, places and buffers for ghosts with the given shifts, one array from each rank."""
        self.shift, self.counts = np.concatenate(shifts), [len(a) for a in shifts]
        self.number, self.owned = len(self.shift), owned
        ends = owned + np.cumsum(self.counts)
        self.receive = [slice(e - c, e) for e, c in zip(ends, self.counts)]
        me = self.comm.rank
        self.abroad = np.concatenate([rows for rank, rows in enumerate(self.send) if rank != me] or [np.zeros(0, np.int64)])
        self.outgoing, self.incoming = np.empty((len(self.abroad), 9)), np.empty((self.number, 9))
        self.requests = None

    def rows(self):
        """What :func:`forward_state` needs (GhostRows); messages are made once, until the ghosts change."""
        if self.requests is not None:
            return self._rows
        receives, sends, at, me = [], [], 0, self.comm.rank
        for rank, (rows, where) in enumerate(zip(self.send, self.receive)):
            if rank == self.comm.rank:
                continue
            if where.stop > where.start:
                receives.append(self.comm.Recv_init(self.incoming[where.start - self.owned:where.stop - self.owned],
                                                    source=rank))
            if len(rows):
                sends.append(self.comm.Send_init(self.outgoing[at:at + len(rows)], dest=rank))
                at += len(rows)
        self.requests = receives + sends
        images = self.incoming[self.receive[me].start - self.owned:self.receive[me].stop - self.owned]
        self._rows = GhostRows(self.abroad, self.outgoing, self.incoming, self.send[me], images, self.shift,
                               messages_of(self.requests), ranks_of(self.comm))
        return self._rows

    def free(self):
        """Release the messages, before the ghosts are made anew."""
        for request in self.requests or []:
            request.Free()
        self.requests = None

    def __del__(self):
        if MPI is not None and not MPI.Is_finalized():  # None where Python is about to end
            self.free()

    def keep(self, used):
        """Give up the ghosts that are not ``used`` (ghosts,), here and where they come from. Collective."""
        self.free()
        ends = np.cumsum(self.counts)[:-1]
        wanted = self.comm.alltoall(np.split(used, ends))
        self.send = [rows[kept] for rows, kept in zip(self.send, wanted)]
        self._arrange(self.owned, [shift[kept] for shift, kept in zip(np.split(self.shift, ends), np.split(used, ends))])

    def grow(self, array):
        """A copy of an owned array with the ghosts' values behind it."""
        out = np.empty((self.owned + self.number, *array.shape[1:]), array.dtype)
        out[:self.owned] = array
        return self.forward(out)

    def forward(self, array):
        """Set the ghosts' entries to their owners' values, in place."""
        requests, buffers, me = [], [], self.comm.rank
        for rank in range(self.comm.size):
            if rank != me and self.counts[rank]:
                requests.append(self.comm.Irecv(array[self.receive[rank]], source=rank))
            if rank != me and len(self.send[rank]):
                buffers.append(np.ascontiguousarray(array[self.send[rank]]))
                requests.append(self.comm.Isend(buffers[-1], dest=rank))
        if self.counts[me]:
            array[self.receive[me]] = array[self.send[me]]
        for request in requests:
            request.Wait()
        return array

    def forward_state(self, x, state):
        """Set the ghosts' positions (shifted for periodic images), velocities and angular velocities, in place."""
        _forward_state(self.rows(), self.owned, x, state)
