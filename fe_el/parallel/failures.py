"""Errors under mpirun: whatever ends one rank ends all of them, with one message where all ranks say the same."""
import os
import sys
import time
import traceback

PATIENCE = 2.0  # [s] for the other ranks to come with the same error

_installed: list[bool] = []


def end_all_ranks_on_errors(comm):
    """From now on an uncaught exception on any rank ends the run on all ranks; once for a process, and only on several
    ranks.

    petsc4py's exit handler waits for all ranks, so an error on one would leave the others waiting for ever.

    Note:
        Collective.
    """
    if comm.size == 1 or _installed:
        return
    _installed.append((comm.Dup(), sys.excepthook))
    sys.excepthook = _end


def wait_for_all(comm, patience):
    """Whether every rank of ``comm`` has come here within ``patience`` [s]; unlike a barrier it never waits for a lost rank.

    Note:
        Collective, if it can be.
    """
    request, until = comm.Ibarrier(), time.monotonic() + patience
    everywhere = request.Test()
    while not everywhere and time.monotonic() < until:
        time.sleep(0.001)
        everywhere = request.Test()
    return everywhere


def _end(kind, error, trace):
    """Print the error, once if every rank has come to it within the patience, and abort."""
    comm, plain = _installed[0]
    if issubclass(kind, KeyboardInterrupt):
        plain(kind, error, trace)
    else:
        everywhere = wait_for_all(comm, PATIENCE)
        if everywhere and comm.rank:
            time.sleep(PATIENCE)  # rank 0 speaks for all
        else:
            where = "all ranks" if everywhere else f"rank {comm.rank}"
            sys.stderr.write("".join(traceback.format_exception(kind, error,
                                                                trace)) + f"The run ends: this error came on {where}.\n")
    sys.stderr.flush()
    comm.Abort(1)


def environment_outside_mpirun():
    """This environment without what mpirun (OpenMPI's, MPICH's) gives its ranks, for programs that a rank starts."""
    given = ("OMPI_", "PMIX_", "PRTE_", "PMI_", "HYDI_", "MPI_LOCAL")
    return {name: value for name, value in os.environ.items() if not name.startswith(given)}
