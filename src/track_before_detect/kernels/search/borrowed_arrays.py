"""Arrays that compiled loops use without counting references to them.

A compiled function that branches between calls counts a reference to each array it is given, up
and down again, by atomic operations: some hundred nanoseconds for a row of the path search, of 200
to 1300 positions at less than a nanosecond each, and more when two threads count the same array.
Borrowing is safe for what the caller of the outermost compiled function holds until it returns,
its arguments, and for nothing else.
"""

from numba.core import cgutils
from numba.extending import intrinsic


@intrinsic
def borrowed(typing_context, array):
    """Return the same array without an owner, so that there is nothing to count."""
    def generate(context, builder, signature, arguments):
        view = context.make_array(signature.return_type)(context, builder, arguments[0])
        view.meminfo = cgutils.get_null_value(view.meminfo.type)
        return view._getvalue()

    return array(array), generate
