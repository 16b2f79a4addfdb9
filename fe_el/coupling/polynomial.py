"""A Chebyshev polynomial of a sparse matrix, for four or eight components at a time, which are one vector instruction.

The compiler does not find these instructions by itself for eight; they are written out for LLVM, which splits them on a
processor with shorter vectors.
"""
from typing import NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from fe_el.compiled.cache import njit
from fe_el.compiled.direct_calls import Direct
from fe_el.compiled.for_each_dimension import FAST
from fe_el.parallel.exchange import Halo

NUMBER, INDEX = ir.DoubleType(), ir.IntType(64)
FLAGS = ("contract",)  # a product and a sum may become one instruction
SUMS = 2  # at a time, as one would wait for each product


class MatrixRows(NamedTuple):
    """Owned rows of a matrix H with diagonal D."""

    start: np.ndarray  #: (rows + 1,)
    column: np.ndarray  #: (entries,) local
    value: np.ndarray  #: (entries,)
    inverse_diagonal: np.ndarray  #: (rows,)


class Part(NamedTuple):
    """Some of the owned rows of a matrix, numbered for themselves; after them the ghosts of other ranks that they see."""

    at: np.ndarray  #: (rows,) which of the owned rows
    rows: MatrixRows  #: without the entries of columns that are not in the part
    halo: Halo  #: exchange of arrays (size, k)
    size: int  #: rows and ghosts


class _Rows:
    """Rows of ``width`` numbers, each as one vector."""

    def __init__(self, builder, width):
        self.builder, self.width, self.kind = builder, width, ir.VectorType(NUMBER, width)

    def place(self, array, row):
        at = self.builder.mul(row, ir.Constant(INDEX, self.width))
        return self.builder.bitcast(self.builder.gep(array, [at]), self.kind.as_pointer())

    def read(self, array, row):
        return self.builder.load(self.place(array, row), align=8)

    def times(self, number, vector):
        none, zeros = ir.Constant(self.kind, ir.Undefined), ir.Constant(ir.VectorType(ir.IntType(32), self.width), None)
        first = self.builder.insert_element(none, number, ir.Constant(ir.IntType(32), 0))
        return self.builder.fmul(self.builder.shuffle_vector(first, none, zeros), vector, flags=FLAGS)

    def minus(self, a, b):
        return self.builder.fsub(a, b, flags=FLAGS)

    def plus(self, a, b):
        return self.builder.fadd(a, b, flags=FLAGS)


def _residual(rows, b, x, row, matrix, bounds):
    """b - H x in one row, with the entries between the bounds."""
    builder, (column, value), (start, end) = rows.builder, matrix, bounds
    sums = [cgutils.alloca_once_value(builder, rows.read(b, row))]
    sums += [cgutils.alloca_once_value(builder, ir.Constant(rows.kind, None)) for _ in range(SUMS - 1)]

    def add(entry, total):
        at = builder.zext(builder.load(builder.gep(column, [entry])), INDEX)
        product = rows.times(builder.load(builder.gep(value, [entry])), rows.read(x, at))
        builder.store(rows.minus(builder.load(total), product), total)
    some, one = ir.Constant(INDEX, SUMS), ir.Constant(INDEX, 1)
    last = builder.sub(end, builder.urem(builder.sub(end, start), some))
    with cgutils.for_range_slice(builder, start, last, some, INDEX) as (entry, _):
        for k, total in enumerate(sums):
            add(builder.add(entry, ir.Constant(INDEX, k)), total)
    with cgutils.for_range_slice(builder, last, end, one, INDEX) as (entry, _):
        add(entry, sums[0])
    out = builder.load(sums[0])
    for total in sums[1:]:
        out = rows.plus(out, builder.load(total))
    return out


def _step_of(width):
    @intrinsic
    def step(typing, vectors, i, column, value, start, end, first, second):
        """A step in row i of ``vectors`` (then, now, last, b): then = now + first (now - last) + second (b - H now); start,
        end: its entries."""
        def code(context, builder, signature, arguments):
            def data(kind, array):
                return context.make_array(kind)(context, builder, array).data
            items = zip(signature.args[0].types, cgutils.unpack_tuple(builder, arguments[0]))
            then, now, last, b = (data(*item) for item in items)
            row, *bounds = (context.cast(builder, arguments[k], signature.args[k], types.intp) for k in (1, 4, 5))
            rows, matrix = _Rows(builder, width), [data(signature.args[k], arguments[k]) for k in (2, 3)]
            x, rest = rows.read(now, row), _residual(rows, b, now, row, matrix, bounds)
            change = rows.plus(rows.times(arguments[6], rows.minus(x, rows.read(last, row))), rows.times(arguments[7], rest))
            builder.store(rows.plus(x, change), rows.place(then, row), align=8)
            return context.get_dummy_value()
        return types.void(vectors, i, column, value, start, end, first, second), code
    return step


_four, _eight = _step_of(4), _step_of(8)


@njit
def cut_out(rows, at, number, start, column, value, rim):
    """Entries of the rows ``at`` in columns that have a number in the part, not -1; rows with others are its rim."""
    one, entries = np.uint64(1), 0
    for n in range(len(at)):
        for entry in range(rows.start[at[n]], rows.start[at[n] + one]):
            there = number[rows.column[entry]]
            if there < 0:
                rim[n] = 1.0
            else:
                column[entries], value[entries] = there, rows.value[entry]
                entries += 1
        start[n + 1] = entries


@njit
def begin(at, inverse_diagonal, scale, load, column, b, x_old, x):
    """Fill b (rows, 4 or 8) with the load (owned rows, k) at the rows of a part, from a column on, and x with scale D^-1
    b."""
    for n in range(len(at)):
        f = scale * inverse_diagonal[n]
        for k in range(b.shape[1]):
            x_old[n, k], b[n, k] = 0.0, load[at[n], column + k] if column + k < load.shape[1] else 0.0
            x[n, k] = f * b[n, k]


@Direct
@njit(fastmath=FAST)
def chebyshev(rows, b, x_old, x, new, first, second):
    """new = x + first (x - x_old) + second D^-1 (b - H x) on all rows, once for each ``first``; of arrays (rows, 4) or
    (rows, 8)."""
    start, column, value, inverse_diagonal, one = rows.start, rows.column, rows.value, rows.inverse_diagonal, np.uint64(1)
    last, now, then = x_old, x, new
    for step in range(len(first)):
        f, g = first[step], second[step]
        if b.shape[1] == 4:
            for i in range(np.uint64(len(b))):
                _four((then, now, last, b), i, column, value, start[i], start[i + one], f, g * inverse_diagonal[i])
        else:
            for i in range(np.uint64(len(b))):
                _eight((then, now, last, b), i, column, value, start[i], start[i + one], f, g * inverse_diagonal[i])
        last, now, then = now, then, last
