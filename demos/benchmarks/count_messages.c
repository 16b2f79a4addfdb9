/* Counts what MPI is asked for, by stage: a library to be preloaded (LD_PRELOAD), for demos/benchmarks/communication.py. */
#include <mpi.h>
#include <stdint.h>
#include <time.h>

enum { HALO, SINGLE, OBJECTS, REDUCTIONS, GATHERS, ALL_TO_ALL, OTHERS, KINDS };
enum { CALLS, MESSAGES, BYTES, NUMBERS, STAGES = 32, TABLE = 1 << 16 };
double counted[STAGES][KINDS][NUMBERS], seconds_inside[STAGES];
int stage = 0;

static struct { uintptr_t request; int64_t bytes; } started[TABLE]; /* bytes of persistent messages; -1: they are received */

static int64_t *bytes_of(MPI_Request request)
{
    uintptr_t key = (uintptr_t)request, at = (key >> 4) * 2654435761u % TABLE;
    while (started[at].request && started[at].request != key)
        at = (at + 1) % TABLE;
    started[at].request = key;
    return &started[at].bytes;
}

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}

static int ranks_of(MPI_Comm comm)
{
    int size = 1;
    PMPI_Comm_size(comm, &size);
    return size;
}

static double size_of(double count, MPI_Datatype type)
{
    int size = 0;
    PMPI_Type_size(type, &size);
    return count * size;
}

static double sum_of(const int *counts, int n)
{
    double sum = 0;
    for (int k = 0; k < n; k++)
        sum += counts[k];
    return sum;
}

/* Count calls, messages to single ranks, and bytes: sent, or of a collective what this rank hands in or is given. */
static void count(int kind, double calls, double messages, double bytes)
{
    counted[stage][kind][CALLS] += calls;
    counted[stage][kind][MESSAGES] += messages;
    counted[stage][kind][BYTES] += bytes;
}

#define TIMED(call) double tick = now(); int code = call; seconds_inside[stage] += now() - tick; return code
#define WRAP(name, arguments, call, what) int name arguments { what; TIMED(P##name call); }
#define NOTHING (void)0
#define ONE(kind) if (ranks_of(comm) > 1) count(kind, 1, 1, size_of(n, type))
#define ALL(kind, bytes) if (ranks_of(comm) > 1) count(kind, 1, 0, bytes)

static void start(int kind, int n, MPI_Request *requests)
{
    for (int k = 0; k < n; k++)
        if (*bytes_of(requests[k]) >= 0)
            count(kind, 0, 1, *bytes_of(requests[k]));
    counted[stage][kind][CALLS]++;
}

/* What compiled loops of fe_el call in place of MPI_Startall. */
int halo_startall(int n, MPI_Request *requests) { start(HALO, n, requests); TIMED(PMPI_Startall(n, requests)); }
WRAP(MPI_Startall, (int n, MPI_Request *r), (n, r), start(SINGLE, n, r))
WRAP(MPI_Start, (MPI_Request *r), (r), start(SINGLE, 1, r))

int MPI_Send_init(const void *a, int n, MPI_Datatype type, int to, int tag, MPI_Comm comm, MPI_Request *r)
{
    int code = PMPI_Send_init(a, n, type, to, tag, comm, r);
    *bytes_of(*r) = size_of(n, type);
    return code;
}
int MPI_Recv_init(void *a, int n, MPI_Datatype type, int from, int tag, MPI_Comm comm, MPI_Request *r)
{
    int code = PMPI_Recv_init(a, n, type, from, tag, comm, r);
    *bytes_of(*r) = -1;
    return code;
}
WRAP(MPI_Isend, (const void *a, int n, MPI_Datatype type, int to, int tag, MPI_Comm comm, MPI_Request *r),
     (a, n, type, to, tag, comm, r), ONE(SINGLE))
WRAP(MPI_Issend, (const void *a, int n, MPI_Datatype type, int to, int tag, MPI_Comm comm, MPI_Request *r),
     (a, n, type, to, tag, comm, r), ONE(SINGLE))
WRAP(MPI_Irsend, (const void *a, int n, MPI_Datatype type, int to, int tag, MPI_Comm comm, MPI_Request *r),
     (a, n, type, to, tag, comm, r), ONE(SINGLE))
WRAP(MPI_Send, (const void *a, int n, MPI_Datatype type, int to, int tag, MPI_Comm comm), (a, n, type, to, tag, comm),
     ONE(OBJECTS))
WRAP(MPI_Sendrecv, (const void *a, int n, MPI_Datatype type, int to, int t, void *b, int m, MPI_Datatype type2, int from,
     int t2, MPI_Comm comm, MPI_Status *s), (a, n, type, to, t, b, m, type2, from, t2, comm, s), ONE(OBJECTS))
WRAP(MPI_Allreduce, (const void *a, void *b, int n, MPI_Datatype type, MPI_Op op, MPI_Comm comm), (a, b, n, type, op, comm),
     ALL(REDUCTIONS, size_of(n, type)))
WRAP(MPI_Iallreduce, (const void *a, void *b, int n, MPI_Datatype type, MPI_Op op, MPI_Comm comm, MPI_Request *r),
     (a, b, n, type, op, comm, r), ALL(REDUCTIONS, size_of(n, type)))
WRAP(MPI_Allgather, (const void *a, int n, MPI_Datatype type, void *b, int m, MPI_Datatype type2, MPI_Comm comm),
     (a, n, type, b, m, type2, comm), ALL(GATHERS, size_of(m, type2) * ranks_of(comm)))
WRAP(MPI_Allgatherv, (const void *a, int n, MPI_Datatype type, void *b, const int *m, const int *at, MPI_Datatype type2,
     MPI_Comm comm), (a, n, type, b, m, at, type2, comm), ALL(GATHERS, size_of(sum_of(m, ranks_of(comm)), type2)))
WRAP(MPI_Alltoall, (const void *a, int n, MPI_Datatype type, void *b, int m, MPI_Datatype type2, MPI_Comm comm),
     (a, n, type, b, m, type2, comm), ALL(ALL_TO_ALL, size_of(m, type2) * ranks_of(comm)))
WRAP(MPI_Alltoallv, (const void *a, const int *n, const int *at, MPI_Datatype type, void *b, const int *m, const int *at2,
     MPI_Datatype type2, MPI_Comm comm), (a, n, at, type, b, m, at2, type2, comm),
     ALL(ALL_TO_ALL, size_of(sum_of(n, ranks_of(comm)), type)))
WRAP(MPI_Bcast, (void *a, int n, MPI_Datatype type, int root, MPI_Comm comm), (a, n, type, root, comm),
     ALL(OTHERS, size_of(n, type)))
WRAP(MPI_Reduce, (const void *a, void *b, int n, MPI_Datatype type, MPI_Op op, int root, MPI_Comm comm),
     (a, b, n, type, op, root, comm), ALL(OTHERS, size_of(n, type)))
WRAP(MPI_Scan, (const void *a, void *b, int n, MPI_Datatype type, MPI_Op op, MPI_Comm comm), (a, b, n, type, op, comm),
     ALL(OTHERS, size_of(n, type)))
WRAP(MPI_Barrier, (MPI_Comm comm), (comm), ALL(OTHERS, 0))
WRAP(MPI_Ibarrier, (MPI_Comm comm, MPI_Request *r), (comm, r), ALL(OTHERS, 0))

/* Where ranks wait for each other. */
WRAP(MPI_Recv, (void *a, int n, MPI_Datatype type, int from, int tag, MPI_Comm comm, MPI_Status *s),
     (a, n, type, from, tag, comm, s), NOTHING)
WRAP(MPI_Mrecv, (void *a, int n, MPI_Datatype type, MPI_Message *m, MPI_Status *s), (a, n, type, m, s), NOTHING)
WRAP(MPI_Probe, (int from, int tag, MPI_Comm comm, MPI_Status *s), (from, tag, comm, s), NOTHING)
WRAP(MPI_Mprobe, (int from, int tag, MPI_Comm comm, MPI_Message *m, MPI_Status *s), (from, tag, comm, m, s), NOTHING)
WRAP(MPI_Wait, (MPI_Request *r, MPI_Status *s), (r, s), NOTHING)
WRAP(MPI_Waitall, (int n, MPI_Request *r, MPI_Status *s), (n, r, s), NOTHING)
WRAP(MPI_Waitany, (int n, MPI_Request *r, int *at, MPI_Status *s), (n, r, at, s), NOTHING)
WRAP(MPI_Waitsome, (int n, MPI_Request *r, int *m, int *at, MPI_Status *s), (n, r, m, at, s), NOTHING)
WRAP(MPI_Test, (MPI_Request *r, int *flag, MPI_Status *s), (r, flag, s), NOTHING)
WRAP(MPI_Testall, (int n, MPI_Request *r, int *flag, MPI_Status *s), (n, r, flag, s), NOTHING)
