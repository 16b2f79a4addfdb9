"""Rows of particles or pairs to and from the block of a contact law, four contacts at a time, as vector instructions.

Four rows of four numbers are read and transposed, so that each number goes to (or comes from) a row of the block as one
vector. The compiler does not find this on its own: here LLVM's vectors are written out. On a processor with shorter vectors
LLVM splits them.
"""
import inspect

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from fe_el.particles.contacts.blocks import BLOCK

NUMBER, INDEX = ir.DoubleType(), ir.IntType(64)
VECTOR, ORDER = ir.VectorType(NUMBER, 4), ir.VectorType(ir.IntType(32), 4)
FLAGS = ("contract",)  # a product and a sum may become one instruction
WIDTH = 8  # numbers in a row of a particle


class _Code:
    """Instructions of one call: arrays are used as flat memory, indices are those of their rows."""

    def __init__(self, context, builder, signature, values):
        self.context, self.builder, self.types, self.values = context, builder, signature.args, values

    def array(self, k):
        return self.context.make_array(self.types[k])(self.context, self.builder, self.values[k]).data

    def index(self, k):
        return self.context.cast(self.builder, self.values[k], self.types[k], types.intp)

    def four(self, k):
        """The four items of a tuple; whole numbers as indices."""
        items, kind = cgutils.unpack_tuple(self.builder, self.values[k]), self.types[k].dtype
        return [self.context.cast(self.builder, v, kind, types.intp)
                for v in items] if isinstance(kind, types.Integer) else items

    def entry(self, row, width, column=0):
        """Place of a row's number; ``width`` may be a value or a constant."""
        width = ir.Constant(INDEX, width) if isinstance(width, int) else width
        return self.builder.add(self.builder.mul(row, width), ir.Constant(INDEX, column))

    def _pointer(self, array, at):
        return self.builder.bitcast(self.builder.gep(array, [at]), VECTOR.as_pointer())

    def load(self, array, at):
        return self.builder.load(self._pointer(array, at), align=8)

    def store(self, vector, array, at):
        self.builder.store(vector, self._pointer(array, at), align=8)

    def _shuffle(self, a, b, *order):
        return self.builder.shuffle_vector(a, b, ir.Constant(ORDER, order))

    def spread(self, number):
        """A vector of four times a number."""
        none = ir.Constant(VECTOR, ir.Undefined)
        return self._shuffle(self.builder.insert_element(none, number, ir.Constant(ir.IntType(32), 0)), none, 0, 0, 0, 0)

    def radius(self, array, row):
        return self.spread(self.builder.load(self.builder.gep(array, [self.entry(row, WIDTH)])))

    def times(self, a, b):
        return self.builder.fmul(a, b, flags=FLAGS)

    def plus(self, a, b):
        return self.builder.fadd(a, b, flags=FLAGS)

    def _transposed(self, a, b, c, d):
        low, high = self._shuffle(a, b, 0, 4, 2, 6), self._shuffle(a, b, 1, 5, 3, 7)
        low_2, high_2 = self._shuffle(c, d, 0, 4, 2, 6), self._shuffle(c, d, 1, 5, 3, 7)
        return (self._shuffle(low, low_2, 0, 1, 4, 5), self._shuffle(high, high_2, 0, 1, 4, 5),
                self._shuffle(low, low_2, 2, 3, 6, 7), self._shuffle(high, high_2, 2, 3, 6, 7))

    def _rows(self, at):
        return [self.builder.add(at, ir.Constant(INDEX, k * BLOCK)) for k in range(4)]

    def to_block(self, vectors):
        """Number k of contact n goes to entry ``at + k BLOCK + n`` of the block; arguments 0 and 1 are the block and
        ``at``."""
        for vector, row in zip(self._transposed(*vectors), self._rows(self.index(1))):
            self.store(vector, self.array(0), row)

    def from_block(self):
        """The vector of each of the four contacts."""
        return self._transposed(*(self.load(self.array(0), row) for row in self._rows(self.index(1))))


def _instructions(write):
    """A numba function of the arguments of ``write`` behind its first; ``write`` is given their numbers."""
    def typed(typing, *arguments):
        def code(context, builder, signature, values):
            write(_Code(context, builder, signature, values), *range(len(values)))
            return context.get_dummy_value()
        return types.void(*arguments), code
    typed.__name__, typed.__doc__, typed.__signature__ = write.__name__, write.__doc__, inspect.signature(write)
    return intrinsic(typed)


@_instructions
def difference_to_block(c, block, at, state, first, second):
    """Numbers 0 to 3 of the first less those of the second particle of four pairs, to four rows of the block from ``at``
    on."""
    s = c.array(state)
    c.to_block([c.builder.fsub(c.load(s, c.entry(i, WIDTH)), c.load(s, c.entry(j, WIDTH)), flags=FLAGS)
                for i, j in zip(c.four(first), c.four(second))])


@_instructions
def rolled_sum_to_block(c, block, at, state, first, second):
    """Sum of numbers 4 to 7 of both particles, each times its number 0, the radius."""
    s = c.array(state)
    c.to_block([c.plus(*(c.times(c.radius(s, k), c.load(s, c.entry(k, WIDTH, 4))) for k in pair))
                for pair in zip(c.four(first), c.four(second))])


@_instructions
def scaled_to_block(c, block, at, rows, width, which, scale):
    """Numbers 0 to 3 of four rows of ``width`` numbers, each row times its scale."""
    r, w = c.array(rows), c.index(width)
    c.to_block([c.times(c.spread(q), c.load(r, c.entry(k, w))) for k, q in zip(c.four(which), c.four(scale))])


@_instructions
def block_to_rows(c, block, at, rows, width, which):
    """Set numbers 0 to 3 of four rows."""
    r, w = c.array(rows), c.index(width)
    for k, vector in zip(c.four(which), c.from_block()):
        c.store(vector, r, c.entry(k, w))


@_instructions
def add_to_rows(c, block, at, rows, which, scale):
    """Add to numbers 0 to 3 of four rows, each times its scale."""
    r = c.array(rows)
    for k, q, vector in zip(c.four(which), c.four(scale), c.from_block()):
        k = c.entry(k, WIDTH)
        c.store(c.plus(c.load(r, k), c.times(c.spread(q), vector)), r, k)


@_instructions
def force_from_block(c, block, at, force, first, second):
    """Add to numbers 0 to 3 of the first particle of each pair, and subtract from those of the second."""
    f = c.array(force)
    for i, j, vector in zip(c.four(first), c.four(second), c.from_block()):
        i, j = c.entry(i, WIDTH), c.entry(j, WIDTH)
        c.store(c.plus(c.load(f, i), vector), f, i)
        c.store(c.builder.fsub(c.load(f, j), vector, flags=FLAGS), f, j)


@_instructions
def torque_from_block(c, block, at, force, state, first, second):
    """Add to numbers 4 to 7 of both particles of each pair, times the radius."""
    f, s = c.array(force), c.array(state)
    for i, j, vector in zip(c.four(first), c.four(second), c.from_block()):
        for k in (i, j):
            at_k = c.entry(k, WIDTH, 4)
            c.store(c.plus(c.load(f, at_k), c.times(c.radius(s, k), vector)), f, at_k)


@_instructions
def fetch_row(c, rows, width, k):
    """Ask for row k to be brought near the processor, ahead of its use."""
    place = c.builder.gep(c.array(rows), [c.entry(c.index(k), c.index(width))])
    byte = ir.IntType(8).as_pointer()
    word = ir.IntType(32)
    fetch = cgutils.get_or_insert_function(c.builder.module, ir.FunctionType(ir.VoidType(), [byte, word, word, word]),
                                           "llvm.prefetch.p0i8")
    c.builder.call(fetch, [c.builder.bitcast(place, byte), ir.Constant(word, 0), ir.Constant(word, 2), ir.Constant(word, 1)])
