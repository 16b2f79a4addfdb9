"""Four facets, or the eight cells of a sphere's room, in one go: LLVM's vectors written out, as the compiler finds none.

On a processor with shorter vectors LLVM splits them. Sets of facets or cells are bits of a number, the first the lowest.
"""
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

NUMBER, BITS = ir.DoubleType(), ir.IntType(64)
FOUR, EIGHT = ir.VectorType(NUMBER, 4), ir.VectorType(ir.IntType(32), 8)
POINT = types.UniTuple(types.float64, 3)
FAST = ("contract", "reassoc", "nsz", "arcp")


def _vector(context, builder, kind, array, at, vector):
    """Place of a vector in an array's flat memory."""
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [at]), vector.as_pointer())


def _spread(builder, number, vector):
    """A vector of a number alone."""
    none, first = ir.Constant(vector, ir.Undefined), ir.Constant(ir.IntType(32), 0)
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), vector.count), [0] * vector.count)
    return builder.shuffle_vector(builder.insert_element(none, number, first), none, zeros)


def _bits(builder, found):
    return builder.zext(builder.bitcast(found, ir.IntType(found.type.count)), BITS)


def _load(context, builder, signature, values, k, offset=0):
    """Four numbers of argument k, an array, from argument k + 1 and the offset on."""
    at = builder.add(values[k + 1], ir.Constant(BITS, offset))
    return builder.load(_vector(context, builder, signature.args[k], values[k], at, FOUR), align=8)


def _of_normals(context, builder, signature, values, k, vector):
    """Products of a vector with the four normals that argument k, an array, holds from argument k + 1 on."""
    total = None
    for n, number in enumerate(cgutils.unpack_tuple(builder, vector)):
        part = builder.fmul(_load(context, builder, signature, values, k, 4 * n), _spread(builder, number, FOUR), flags=FAST)
        total = part if total is None else builder.fadd(total, part, flags=FAST)
    return total


@intrinsic
def inside_facets(typing, inside, at, record, base, point, first, fourth, scale):
    """Set ``inside[at:at+4]`` to ``scale`` times how far a point is inside four planes: products with the normals from
    ``record[base]`` on, first all x, then y and z; the first and the fourth plane are farther by so much. Returns which are
    between -1 and 1."""
    def code(context, builder, signature, values):
        total, zero = _of_normals(context, builder, signature, values, 2, values[4]), ir.Constant(FOUR, [0.0] * 4)
        for lane, number in ((0, values[5]), (3, values[6])):
            zero = builder.insert_element(zero, number, ir.Constant(ir.IntType(32), lane))
        total = builder.fmul(builder.fadd(total, zero, flags=FAST), _spread(builder, values[7], FOUR), flags=FAST)
        builder.store(total, _vector(context, builder, signature.args[0], values[0], values[1], FOUR), align=8)
        square, one = builder.fmul(total, total, flags=FAST), _spread(builder, ir.Constant(NUMBER, 1.0), FOUR)
        return _bits(builder, builder.fcmp_ordered("<", square, one))
    number = types.float64
    return types.uint64(inside, types.uint64, record, types.uint64, POINT, number, number, number), code


@intrinsic
def beside_facet(typing, inside, at, record, base, normal, h):
    """Of a plane at distance h with a normal: which of the edges with the four facets of the cell, whose normals are in
    ``record`` from ``base`` on, the sphere reaches there; and, times 16, which of them the foot of the centre is beyond."""
    def code(context, builder, signature, values):
        cosine, h = _of_normals(context, builder, signature, values, 2, values[4]), _spread(builder, values[5], FOUR)
        here, one = _load(context, builder, signature, values, 0), _spread(builder, ir.Constant(NUMBER, 1.0), FOUR)
        foot = builder.fsub(here, builder.fmul(h, cosine, flags=FAST), flags=FAST)
        disc, sine = (builder.fsub(one, builder.fmul(v, v, flags=FAST), flags=FAST) for v in (h, cosine))
        reached = builder.fcmp_ordered("<", builder.fmul(foot, foot, flags=FAST), builder.fmul(disc, sine, flags=FAST))
        beyond = builder.fcmp_ordered("<", foot, ir.Constant(FOUR, [0.0] * 4))
        return builder.or_(_bits(builder, reached), builder.shl(_bits(builder, beyond), ir.Constant(BITS, 4)))
    return types.uint64(inside, types.uint64, record, types.uint64, POINT, types.float64), code


@intrinsic
def where_equal(typing, cells, at, wanted):
    """Which of ``cells[at:at+8]`` are the wanted one."""
    def code(context, builder, signature, values):
        eight = builder.load(_vector(context, builder, signature.args[0], values[0], values[1], EIGHT), align=4)
        return _bits(builder, builder.icmp_signed("==", eight, _spread(builder, values[2], EIGHT)))
    return types.uint64(cells, types.uint64, types.int32), code


@intrinsic
def lowest(typing, bits):
    """Number of the lowest of some bits; 64 if there is none."""
    def code(context, builder, signature, values):
        return builder.cttz(values[0], ir.Constant(ir.IntType(1), 0))
    return types.uint64(types.uint64), code
