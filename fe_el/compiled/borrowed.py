"""Arrays without reference counts, for compiled loops that hand many arrays on.

Numba counts references to every array that is passed on or cut, with atomic instructions: a few hundred of them cost
microseconds. What is borrowed for the duration of a call needs no count.
"""
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic


def _without_counts(context, builder, kind, value):
    """The same value, whose arrays no longer know who owns their memory."""
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value)
        array.meminfo = cgutils.get_null_value(array.meminfo.type)
        array.parent = cgutils.get_null_value(array.parent.type)
        return array._getvalue()
    if isinstance(kind, types.BaseTuple):
        for k, item in enumerate(kind.types):
            value = builder.insert_value(value, _without_counts(context, builder, item, builder.extract_value(value, k)), k)
    return value


@intrinsic
def borrowed(typing, thing):
    """An array, a number or a tuple (of tuples) of such, without reference counts: valid as long as the original is."""
    def code(context, builder, signature, arguments):
        return _without_counts(context, builder, thing, arguments[0])
    return thing(thing), code
