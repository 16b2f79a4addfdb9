"""MPI inside compiled loops: the same messages again and again, and the largest of a number over all ranks.

Handles are passed as what they are in memory, so that any MPI that mpi4py was built with will do.
"""
import ctypes
import math

import llvmlite.binding
import numpy as np
from mpi4py import MPI
from numba import types

from fe_el.compiled.cache import njit

_library = ctypes.CDLL(MPI.__file__)
for _name in ("MPI_Startall", "MPI_Waitall", "MPI_Allreduce"):
    llvmlite.binding.add_symbol(_name, ctypes.cast(getattr(_library, _name), ctypes.c_void_p).value)
_start = types.ExternalFunction("MPI_Startall", types.int32(types.int32, types.voidptr))
_wait = types.ExternalFunction("MPI_Waitall", types.int32(types.int32, types.voidptr, types.voidptr))
_reduce = types.ExternalFunction("MPI_Allreduce", types.int32(types.voidptr, types.voidptr, types.int32, types.intp,
                                                              types.intp,
                                                              types.intp))


def _handle(thing):
    """Bytes of the handle of an MPI object."""
    return ctypes.string_at(MPI._addressof(thing), MPI._sizeof(thing))


def messages_of(requests):
    """What :func:`exchange` needs of persistent requests, which the caller must keep: handles, statuses, number."""
    handles = np.frombuffer(bytearray(b"".join(_handle(r) for r in requests)), np.uint8)
    return handles, np.zeros(len(requests) * MPI._sizeof(MPI.Status), np.uint8), len(requests)


def ranks_of(comm):
    """What :func:`largest` and :func:`total` need of a communicator: number of ranks, handles, and room for the number.

    A plain tuple, which numba recognises fast outside of compiled loops, too.
    """
    handles = [int.from_bytes(_handle(thing), "little") for thing in (comm, MPI.DOUBLE, MPI.MAX, MPI.SUM)]
    return comm.size, tuple(handles), np.zeros(2)


@njit
def exchange(messages):
    """Start all messages and wait for them."""
    handles, statuses, number = messages
    if number and (_start(number, handles.ctypes) or _wait(number, handles.ctypes, statuses.ctypes)):
        raise RuntimeError("MPI could not exchange the ghosts.")


@njit
def largest(ranks, number):
    """Largest of a number over all ranks; what is not a number counts as infinite. Collective."""
    size, (comm, kind, operation, _), room = ranks
    number = math.inf if math.isnan(number) else number
    if size == 1:
        return number
    room[0] = number
    if _reduce(room.ctypes, room[1:].ctypes, 1, kind, operation, comm):
        raise RuntimeError("MPI could not find the largest number.")
    return room[1]


@njit
def total(ranks, number):
    """Sum of a number over all ranks. Collective."""
    size, (comm, kind, _, operation), room = ranks
    if size == 1:
        return number
    room[0] = number
    if _reduce(room.ctypes, room[1:].ctypes, 1, kind, operation, comm):
        raise RuntimeError("MPI could not add up a number.")
    return room[1]
