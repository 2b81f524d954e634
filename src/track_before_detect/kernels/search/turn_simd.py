"""The best turn by at most one step, for several neighbouring velocities at once.

Neighbours along v_y share most of what they are the maximum of. Computed together, five velocities
take 21 reads of rows of paths instead of 45, and each is written once, with the first weights it
meets already added: two thirds of the time of one pass for each maximum. As a loop over x none of
it would be vectorised, for the compiler does not prove so many rows apart. So it is written in
vectors, which the compiler turns into those of the machine, whatever their width.
"""

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

# Velocities computed together at most, and frames whose weights are added at once.
MOST_ROWS = 5
AT_ONCE = (1, 2, 4)
RUN_SIZE = 3 * (MOST_ROWS + 2) + MOST_ROWS * (1 + max(AT_ONCE))

LANES = 16
_VECTOR = ir.VectorType(ir.FloatType(), LANES)
_LANE = ir.IntType(32)


@intrinsic
def turn_and_add(typing_context, out, before, scores, run, n_rows, n_frames, cost, start, stop):
    """Write the best turn into each state of a run, and the weights met in its first frames.

    Parameters
    ----------
    out, before, scores : float32, flat
    run : int64
        Where x = 0 lies. In ``before``, 3 (n_rows + 2) numbers: for the velocity below the run
        along v_y, those of the run, and the one above, each itself and its two neighbours along
        v_x. Then in ``out``, n_rows numbers. Then in ``scores``, for each velocity of the run
        n_frames numbers.
    n_rows, n_frames : int
        At most ``MOST_ROWS``, and one of ``AT_ONCE``.
    cost : float32
        Of a step along either axis.
    start, stop : int
        First x, and the one past the last: a whole number of vectors.
    """
    signature = types.void(out, before, scores, run, n_rows, n_frames, cost, start, stop)

    def generate(context, builder, signature, arguments):
        out, before, scores, run = (
            context.make_array(kind)(context, builder, array).data
            for kind, array in zip(signature.args[:4], arguments[:4], strict=True))
        n_rows, n_frames, cost, start, stop = arguments[4:]
        nothing = ir.Constant(_VECTOR, ir.Undefined)
        costs = builder.shuffle_vector(
            builder.insert_element(nothing, cost, ir.Constant(_LANE, 0)), nothing,
            ir.Constant(ir.VectorType(_LANE, LANES), [0] * LANES))

        def vector(array, number, x):
            first = builder.load(builder.gep(run, [ir.Constant(x.type, number)]))
            return builder.bitcast(builder.gep(array, [builder.add(first, x)]),
                                   _VECTOR.as_pointer())

        def load(array, number, x):
            return builder.load(vector(array, number, x), align=4)

        def turned(here, one, other):
            return largest(here, builder.fsub(largest(one, other), costs))

        def largest(one, other):
            return builder.select(builder.fcmp_ordered('>', one, other), one, other)

        def total(values):
            if len(values) == 1:
                return values[0]
            half = len(values) // 2
            return builder.fadd(total(values[:half]), total(values[half:]))

        def body(rows, frames, x):
            along_x = [turned(*(load(before, 3 * k + side, x) for side in range(3)))
                       for k in range(rows + 2)]
            for k in range(rows):
                best = turned(along_x[k + 1], along_x[k], along_x[k + 2])
                met = 4 * rows + 6 + k * frames
                weights = total([load(scores, met + t, x) for t in range(frames)])
                builder.store(builder.fadd(best, weights), vector(out, 3 * rows + 6 + k, x),
                              align=4)

        for rows in range(1, MOST_ROWS + 1):
            for frames in AT_ONCE:
                chosen = builder.and_(
                    builder.icmp_signed('==', n_rows, ir.Constant(n_rows.type, rows)),
                    builder.icmp_signed('==', n_frames, ir.Constant(n_frames.type, frames)))
                with builder.if_then(chosen), cgutils.for_range_slice(
                        builder, start, stop, ir.Constant(start.type, LANES),
                        inc=True) as (x, _):
                    body(rows, frames, x)
        return context.get_dummy_value()

    return signature, generate
