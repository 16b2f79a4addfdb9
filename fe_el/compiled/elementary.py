"""Exponential and logarithm without a branch, which become vectors in loops; numba's own are calls, one number at a time.

Not for loops that may be reassociated: both round by adding a large number and taking it off again.
"""
import math

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from fe_el.compiled.parts import part

ROUND = 1.5 * 2.0 ** 52  # added to a number, its last bits are the nearest whole number
ROUND_BITS, HALF_ROOT_BITS = (int(np.float64(v).view(np.int64)) for v in (ROUND, math.sqrt(0.5)))
FRACTION_BITS = 2 ** 52 - 1
LOG_2_HIGH = float(np.int64(np.float64(math.log(2)).view(np.int64) & ~(2 ** 21 - 1)).view(np.float64))  # times 2^10 is exact
LOG_2_LOW = 1.9082149292705877e-10  # the rest
E2, E3, E4, E5, E6, E7, E8, E9, E10, E11, E12, E13 = (1 / math.factorial(k) for k in range(2, 14))


@intrinsic
def _bits_of(typing, number):
    """The bits of a number, as a whole one."""
    def code(context, builder, signature, values):
        return builder.bitcast(values[0], ir.IntType(64))
    return types.int64(types.float64), code


@intrinsic
def _of_bits(typing, bits):
    """The number with these bits."""
    def code(context, builder, signature, values):
        return builder.bitcast(values[0], ir.DoubleType())
    return types.float64(types.int64), code


@part(fastmath={"contract"}, error_model="numpy")
def exponential(x):
    """exp(x) to round-off, for x cut to -700 to 700."""
    x = 700.0 if x > 700.0 else x
    x = -700.0 if x < -700.0 else x
    shifted = x * (1 / math.log(2)) + ROUND
    whole = shifted - ROUND
    r = (x - whole * LOG_2_HIGH) - whole * LOG_2_LOW
    r2 = r * r
    r4 = r2 * r2
    low, high = (E2 + E3 * r) + r2 * (E4 + E5 * r), (E10 + E11 * r) + r2 * (E12 + E13 * r)
    middle = (E6 + E7 * r) + r2 * (E8 + E9 * r)
    return (1 + (r + r2 * (low + r4 * (middle + r4 * high)))) * _of_bits((_bits_of(shifted) + 1023) << 52)


@part(fastmath={"contract"}, error_model="numpy")
def logarithm(x):
    """Natural logarithm to round-off, of normal numbers above zero."""
    bits = _bits_of(x) - HALF_ROOT_BITS
    power = _of_bits((bits >> 52) + ROUND_BITS) - ROUND
    f = _of_bits((bits & FRACTION_BITS) + HALF_ROOT_BITS) - 1
    s = f / (2 + f)
    z = s * s
    z2 = z * z
    z4 = z2 * z2
    low, middle = (1 / 3 + z / 5) + z2 * (1 / 7 + z / 9), (1 / 11 + z / 13) + z2 * (1 / 15 + z / 17)
    series = low + z4 * (middle + z4 * (1 / 19 + z / 21))
    return power * LOG_2_HIGH + (2 * s + (2 * s * z * series + power * LOG_2_LOW))
