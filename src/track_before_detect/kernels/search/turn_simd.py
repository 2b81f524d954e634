"""The best turn by at most one step, for several neighbouring velocities at once.

Neighbours along v_y share most of what they are the maximum of. Computed together, five velocities
take 21 reads of rows of paths instead of 45, and each is written once, with the first weights it
meets already added: two thirds of the time of one pass for each maximum. As a loop over x none of
it would be vectorised, for the compiler does not prove so many rows apart. So it is written in
vectors, which the compiler turns into those of the machine, whatever their width.

Where targets may enter and leave, all frames of a segment are met in one pass, for what was
reached and the best end so far then stay in registers.
"""

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from track_before_detect.kernels.rows import ABSENT

# Velocities computed together at most, and frames whose weights are added at once.
MOST_ROWS = 5
AT_ONCE = (1, 2, 4)
# Numbers that say where the rows of a run lie, besides one for each velocity and frame.
RUN_SIZE = 3 * (MOST_ROWS + 2) + MOST_ROWS

LANES = 16
_VECTOR = ir.VectorType(ir.FloatType(), LANES)
_LANE = ir.IntType(32)


class _Rows:
    """What is computed with vectors of the rows of a run."""

    def __init__(self, context, builder, kinds, arrays, cost):
        self._builder = builder
        *self.data, self._run = (
            context.make_array(kind)(context, builder, array).data
            for kind, array in zip(kinds, arrays, strict=True))
        self._costs = self.spread(cost)

    def spread(self, number):
        """Return a vector of one number."""
        nothing = ir.Constant(_VECTOR, ir.Undefined)
        return self._builder.shuffle_vector(
            self._builder.insert_element(nothing, number, ir.Constant(_LANE, 0)), nothing,
            ir.Constant(ir.VectorType(_LANE, LANES), [0] * LANES))

    def at(self, array, number, x):
        """Return where position x of a row lies, the row being the entry ``number`` of a run."""
        builder = self._builder
        if isinstance(number, int):
            number = ir.Constant(x.type, number)
        first = builder.load(builder.gep(self._run, [number]))
        return builder.bitcast(builder.gep(array, [builder.add(first, x)]), _VECTOR.as_pointer())

    def load(self, array, number, x):
        """Return the numbers of a row from position x on."""
        return self._builder.load(self.at(array, number, x), align=4)

    def larger(self, one, other):
        """Return the larger of two, number by number."""
        return self._builder.select(self._builder.fcmp_ordered('>', one, other), one, other)

    def turned(self, here, one, other):
        """Return the best of three, two of them less the cost of a step."""
        return self.larger(here, self._builder.fsub(self.larger(one, other), self._costs))

    def best_turns(self, before, rows, x):
        """Return the best turn into each of the rows of a run."""
        along_x = [self.turned(*(self.load(before, 3 * k + side, x) for side in range(3)))
                   for k in range(rows + 2)]
        return [self.turned(along_x[k + 1], along_x[k], along_x[k + 2]) for k in range(rows)]


def _for_each(builder, start, stop, conditions, body):
    """Call body(x) for all vectors from start to stop where numbers are what they should be."""
    chosen = ir.Constant(ir.IntType(1), 1)
    for number, wanted in conditions:
        chosen = builder.and_(chosen, builder.icmp_signed(
            '==', number, ir.Constant(number.type, wanted)))
    with builder.if_then(chosen), cgutils.for_range_slice(
            builder, start, stop, ir.Constant(start.type, LANES), inc=True) as (x, _):
        body(x)


@intrinsic
def turn_and_add(typing_context, out, before, scores, run, n_rows, n_frames, cost, start, stop):
    """Write the best turn into each state of a run, and the weights met in its first frames.

    Parameters
    ----------
    out, before, scores : float32, flat
    run : int64
        Where x = 0 lies. In ``before``, 3 (n_rows + 2) numbers: for the velocity below the run
        along v_y, those of the run, and the one above, each itself and its two neighbours along
        v_x. Then in ``out``, n_rows numbers. Then in ``scores``, for each of the frames n_rows
        numbers.
    n_rows, n_frames : int
        At most ``MOST_ROWS``, and one of ``AT_ONCE``.
    cost : float32
        Of a step along either axis.
    start, stop : int
        First x, and the one past the last: a whole number of vectors.
    """
    signature = types.void(out, before, scores, run, n_rows, n_frames, cost, start, stop)

    def generate(context, builder, signature, arguments):
        n_rows, n_frames, cost, start, stop = arguments[4:]
        make = _Rows(context, builder, signature.args[:4], arguments[:4], cost)
        out, before, scores = make.data

        def total(values):
            if len(values) == 1:
                return values[0]
            half = len(values) // 2
            return builder.fadd(total(values[:half]), total(values[half:]))

        def body(rows, frames, x):
            for k, best in enumerate(make.best_turns(before, rows, x)):
                met = 4 * rows + 6 + k
                weights = total([make.load(scores, met + t * rows, x) for t in range(frames)])
                builder.store(builder.fadd(best, weights), make.at(out, 3 * rows + 6 + k, x),
                              align=4)

        for rows in range(1, MOST_ROWS + 1):
            for frames in AT_ONCE:
                _for_each(builder, start, stop, [(n_rows, rows), (n_frames, frames)],
                          lambda x, rows=rows, frames=frames: body(rows, frames, x))
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def turn_and_live(typing_context, out, before, scores, ends, run, n_rows, n_frames, near, cost,
                  entry, leaving, leaving_last, start, stop):
    """Write the best turn into each state of a run, and what is reached after its frames.

    With s_t the weight met in frame t, reached_t = max(reached_(t-1), -entry) + s_t. ``ends[x]``
    is raised to the best reached_t - leaving, in the last frame reached_t - leaving_last.

    Parameters
    ----------
    out, before, scores, run, n_rows, n_frames, cost, start, stop
        As for ``turn_and_add``, but of any number of frames.
    ends : float32, flat
    near : bool
        Whether there is a turn to take; otherwise what was reached before is read from ``out``.
    entry, leaving, leaving_last : float32
    """
    signature = types.void(out, before, scores, ends, run, n_rows, n_frames, near, cost, entry,
                           leaving, leaving_last, start, stop)

    def generate(context, builder, signature, arguments):
        n_rows, n_frames, near, cost, entry, leaving, leaving_last, start, stop = arguments[5:]
        make = _Rows(context, builder, signature.args[:5], arguments[:5], cost)
        out, before, scores, ends = make.data
        outside = make.spread(builder.fneg(entry))
        leaving, leaving_last = make.spread(leaving), make.spread(leaving_last)
        kept = [cgutils.alloca_once(builder, _VECTOR) for _ in range(MOST_ROWS)]
        kept_end = cgutils.alloca_once(builder, _VECTOR)
        last = builder.sub(n_frames, ir.Constant(n_frames.type, 1))

        def live(k, rows, t, x):
            met = builder.add(builder.mul(t, ir.Constant(t.type, rows)),
                              ir.Constant(t.type, 4 * rows + 6 + k))
            return builder.fadd(make.larger(builder.load(kept[k]), outside),
                                make.load(scores, met, x))

        def body(rows, turning, x):
            for k, start_value in enumerate(
                    make.best_turns(before, rows, x) if turning
                    else [make.load(out, 3 * rows + 6 + k, x) for k in range(rows)]):
                builder.store(start_value, kept[k])
            builder.store(ir.Constant(_VECTOR, [float(ABSENT)] * LANES), kept_end)
            with cgutils.for_range(builder, last) as loop:
                end = builder.load(kept_end)
                for k in range(rows):
                    reached = live(k, rows, loop.index, x)
                    builder.store(reached, kept[k])
                    end = make.larger(end, reached)
                builder.store(end, kept_end)
            end = builder.fsub(builder.load(kept_end), leaving)
            for k in range(rows):
                reached = live(k, rows, last, x)
                builder.store(reached, make.at(out, 3 * rows + 6 + k, x), align=4)
                end = make.larger(end, builder.fsub(reached, leaving_last))
            place = builder.bitcast(builder.gep(ends, [x]), _VECTOR.as_pointer())
            builder.store(make.larger(builder.load(place, align=4), end), place, align=4)

        for rows in range(1, MOST_ROWS + 1):
            for turning in (0, 1):
                _for_each(builder, start, stop, [(n_rows, rows), (near, turning)],
                          lambda x, rows=rows, turning=turning: body(rows, turning, x))
        return context.get_dummy_value()

    return signature, generate
