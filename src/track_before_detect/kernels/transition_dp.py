"""First-order dynamic programming over any transition set, and target cancellation.

Layout of every array
---------------------
merit, scores : float32 (T, Y, X)
    Merit function I and what each pixel adds to it.
rows : int32 (R, 3)
    Transition sets, one row of pixels each: dy, first dx, last dx, where (dx, dy) leads from a
    pixel to its predecessor in the frame before. Rows with the same dx stand together.
row_first : int32 (S + 1,)
    First row of each set.
sets : int32 (T,)
    Number of the set that leads to frame t from the one before; the first is not used.
psi : float32 (C, T, Y, X)
    Data seen through the PSF; C is 2 for the real and imaginary parts of complex frames, else 1.
phi : float32 (T, Y, X)
    Squared norm that is left of the PSF; zero where nothing can be seen.
weights : float32 (T, H, W), (1, H, W) or (0, 0, 0)
    Scale of each pixel, zero where masked; of no frames where it is one.
stamp : float32 (K, K)
    The PSF, K odd.
exclusion : float32 (2 K - 1, 2 K - 1)
    Largest statistic of a target in the middle that leaves each pixel in use.

The loops over x are small functions of their own, see the module ``rows``.
"""

import numba
import numpy as np

from track_before_detect.kernels.compile_flags import FUSED_UNCHECKED, Offset
from track_before_detect.kernels.psf.psf_stamps import LEAST_SHARE
from track_before_detect.kernels.rows import (
    ABSENT,
    add_row,
    copy_row,
    fill_row,
    larger_of_two,
    largest_of_three,
    raise_row,
)
from track_before_detect.kernels.scores.score_rows import root, square, square_positive

# Part of the PSF that border and mask have to leave for a pixel to be searched.
LEAST_PHI = np.float32(LEAST_SHARE)

_U = Offset


@numba.njit(**FUSED_UNCHECKED)
def _largest_in_rows(column, o, merit, base, y, rows, first, last, n_y, n_x, x_first, n):
    """Write the largest over rows y + dy to column[o + x]; return whether there are such."""
    n_valid = 0
    a, b, c = _U(0), _U(0), _U(0)
    for r in range(first, last):
        row = y + rows[r, 0]
        if row < 0 or row >= n_y:
            continue
        start = _U(base + row * n_x + x_first)
        n_valid += 1
        if n_valid == 1:
            a = start
        elif n_valid == 2:
            b = start
        elif n_valid == 3:
            c = start
            largest_of_three(column, o, merit, a, b, c, n)
        else:
            raise_row(column, o, merit, start, n, np.float32(0))
    if n_valid == 1:
        copy_row(column, o, merit, a, n)
    elif n_valid == 2:
        larger_of_two(column, o, merit, a, b, n)
    return n_valid > 0


@numba.njit(**FUSED_UNCHECKED)
def _extend(merit, scores, t, n_y, n_x, rows, first_row, last_row, y_first, y_last, x_first,
            x_last, column):
    before = (t - 1) * n_y * n_x
    n = x_last - x_first
    for y in range(y_first, y_last):
        out = _U((t * n_y + y) * n_x + x_first)
        started = False
        r = first_row
        while r < last_row:
            low, high = rows[r, 1], rows[r, 2]
            end = r + 1
            while end < last_row and rows[end, 1] == low and rows[end, 2] == high:
                end += 1
            # Entry i of the column maximum belongs to x_first + low + i.
            first = min(x_last + high, max(0, x_first + low))
            last = max(first, min(n_x, x_last + high))
            left = first - x_first - low
            reachable = _largest_in_rows(column, _U(left), merit, before, y, rows, r, end, n_y,
                                         n_x, first, last - first)
            r = end
            if not reachable:
                continue
            fill_row(column, _U(0), left, ABSENT)
            right = left + last - first
            fill_row(column, _U(right), n + high - low - right, ABSENT)
            done = 0
            if not started:
                if high - low == 0:
                    copy_row(merit, out, column, _U(0), n)
                    done = 1
                elif high - low == 1:
                    larger_of_two(merit, out, column, _U(0), _U(1), n)
                    done = 2
                else:
                    largest_of_three(merit, out, column, _U(0), _U(1), _U(2), n)
                    done = 3
                started = True
            for shift in range(done, high - low + 1):
                raise_row(merit, out, column, _U(shift), n, np.float32(0))
        if not started:
            fill_row(merit, out, n, ABSENT)
        add_row(merit, out, scores, out, n)


@numba.njit(**FUSED_UNCHECKED)
def accumulate(merit, scores, rows, row_first, sets, boxes):
    """Write merit[t, p] = scores[t, p] + max over the set of merit[t - 1, p + (dx, dy)].

    In frame t that is done for the pixels of boxes[t] = first y, last y, first x, last x, the
    last ones not included. Returns the number of candidates that were looked at.
    """
    n_frames, n_y, n_x = merit.shape
    flat = merit.reshape(merit.size)
    flat_scores = scores.reshape(scores.size)
    widest = 0
    for r in range(rows.shape[0]):
        widest = max(widest, rows[r, 2] - rows[r, 1])
    column = np.empty(n_x + widest, np.float32)
    n_candidates = 0
    for t in range(n_frames):
        y_first, y_last, x_first, x_last = boxes[t, 0], boxes[t, 1], boxes[t, 2], boxes[t, 3]
        if y_last <= y_first or x_last <= x_first:
            continue
        if t == 0:
            for y in range(y_first, y_last):
                o = _U(y * n_x + x_first)
                copy_row(flat, o, flat_scores, o, x_last - x_first)
            continue
        first, last = row_first[sets[t]], row_first[sets[t] + 1]
        _extend(flat, flat_scores, t, n_y, n_x, rows, first, last, y_first, y_last, x_first,
                x_last, column)
        n_pixels = (y_last - y_first) * (x_last - x_first)
        for r in range(first, last):
            n_candidates += n_pixels * (rows[r, 2] - rows[r, 1] + 1)
    return n_candidates


@numba.njit(**FUSED_UNCHECKED)
def _spread_boxes(boxes, rows, row_first, sets, n_y, n_x):
    """Grow the boxes of later frames by what depends on the boxes of those before."""
    for t in range(1, boxes.shape[0]):
        if boxes[t - 1, 1] <= boxes[t - 1, 0]:
            continue
        for r in range(row_first[sets[t]], row_first[sets[t] + 1]):
            boxes[t, 0] = max(0, min(boxes[t, 0], boxes[t - 1, 0] - rows[r, 0]))
            boxes[t, 1] = min(n_y, max(boxes[t, 1], boxes[t - 1, 1] - rows[r, 0]))
            boxes[t, 2] = max(0, min(boxes[t, 2], boxes[t - 1, 2] - rows[r, 2]))
            boxes[t, 3] = min(n_x, max(boxes[t, 3], boxes[t - 1, 3] - rows[r, 1]))


@numba.njit(**FUSED_UNCHECKED)
def _trace(merit, rows, row_first, sets, y, x, path):
    """Follow the best path back from pixel (x, y) of the last frame."""
    n_frames, n_y, n_x = merit.shape
    path[n_frames - 1, 0], path[n_frames - 1, 1] = x, y
    for t in range(n_frames - 1, 0, -1):
        best = np.float32(-np.inf)
        from_x, from_y = x, y
        for r in range(row_first[sets[t]], row_first[sets[t] + 1]):
            row = y + rows[r, 0]
            if row < 0 or row >= n_y:
                continue
            for column in range(max(0, x + rows[r, 1]), min(n_x, x + rows[r, 2] + 1)):
                if merit[t - 1, row, column] > best:
                    best = merit[t - 1, row, column]
                    from_x, from_y = column, row
        x, y = from_x, from_y
        path[t - 1, 0], path[t - 1, 1] = x, y


@numba.njit(**FUSED_UNCHECKED)
def _power(out, o, real, imaginary, phi, i, n):
    for x in range(_U(n)):
        share = phi[i + x]
        power = real[i + x] * real[i + x] + imaginary[i + x] * imaginary[i + x]
        out[o + x] = power / share if share > LEAST_PHI else np.float32(0)


@numba.njit(**FUSED_UNCHECKED)
def _statistic(out, o, psi, phi, i, n):
    for x in range(_U(n)):
        share = phi[i + x]
        out[o + x] = psi[i + x] / np.sqrt(share) if share > LEAST_PHI else np.float32(0)


@numba.njit(**FUSED_UNCHECKED)
def _absolute(out, o, n):
    for x in range(_U(n)):
        out[o + x] = abs(out[o + x])


@numba.njit(**FUSED_UNCHECKED)
def _score_row(out, o, real, imaginary, phi, i, n, is_complex, squared, signed):
    """Write what pixels add to the merit function, from psi and phi at i, to out[o + x]."""
    row = out[np.int64(o):np.int64(o) + n]
    if is_complex:
        _power(out, o, real, imaginary, phi, i, n)
        if not squared:
            root(row)
        return
    _statistic(out, o, real, phi, i, n)
    if squared and signed:
        square(row)
    elif squared:
        square_positive(row)
    elif signed:
        _absolute(out, o, n)


@numba.njit(**FUSED_UNCHECKED)
def score_pixels(scores, psi, phi, squared, signed):
    """Write what each pixel adds to the merit function.

    With h = psi / sqrt(phi) that is h, |h| where signed or complex, or the square of either;
    max(h, 0)^2 for the square of an h that is not signed.
    """
    n_x = scores.shape[2]
    flat = scores.reshape(scores.size)
    flat_phi = phi.reshape(phi.size)
    real = psi[0].reshape(phi.size)
    imaginary = psi[psi.shape[0] - 1].reshape(phi.size)
    for row in range(scores.size // n_x):
        o = _U(row * n_x)
        _score_row(flat, o, real, imaginary, flat_phi, o, n_x, psi.shape[0] == 2, squared, signed)


@numba.njit(**FUSED_UNCHECKED)
def _score_again(scores, psi, taken, spoilt, phi, t, box, squared, signed):
    """Write what the pixels of a box of frame t add after what was taken from them."""
    n_x = scores.shape[2]
    n = box[3] - box[2]
    flat = scores.reshape(scores.size)
    parts = np.zeros((3, n), np.float32)
    for y in range(box[0], box[1]):
        for x in range(n):
            u = box[2] + x
            parts[2, x] = np.float32(0) if spoilt[t, y, u] else phi[t, y, u]
            for c in range(psi.shape[0]):
                parts[c, x] = psi[c, t, y, u] - taken[c, t, y, u]
        _score_row(flat, _U((t * scores.shape[1] + y) * n_x + box[2]), parts[0], parts[1],
                   parts[2], _U(0), n, psi.shape[0] == 2, squared, signed)


@numba.njit(**FUSED_UNCHECKED)
def _cancel_in_frame(psi, taken, spoilt, phi, weights, stamp, exclusion, t, y, x, seen):
    """Subtract the target at pixel (x, y) of frame t, and end the use of the pixels it spoils.

    What a target adds to psi of other pixels follows from its fit in this pixel. Rounding to whole
    pixels leaves a part of it; pixels where that may pass the noise are not searched again, nor
    those whose stamps are mostly the same. ``seen`` (C,) receives the statistic of the frame.
    """
    n_y, n_x = phi.shape[1:]
    half = stamp.shape[0] // 2
    share = np.float32(0) if spoilt[t, y, x] else phi[t, y, x]
    squared = np.float32(0)
    for c in range(psi.shape[0]):
        seen[c] = np.float32(0)
        if share > LEAST_PHI:
            seen[c] = (psi[c, t, y, x] - taken[c, t, y, x]) / np.sqrt(share)
        squared += seen[c] * seen[c]
    if not share > LEAST_PHI:
        return
    size = np.sqrt(squared)
    weighted = weights.shape[0] > 0
    frame = t if weights.shape[0] > 1 else 0
    for v in range(max(0, y - 2 * half), min(n_y, y + 2 * half + 1)):
        for u in range(max(0, x - 2 * half), min(n_x, x + 2 * half + 1)):
            common = np.float32(0)
            for q in range(max(0, y - half, v - half), min(n_y, y + half + 1, v + half + 1)):
                for p in range(max(0, x - half, u - half), min(n_x, x + half + 1, u + half + 1)):
                    product = (stamp[q - y + half, p - x + half]
                               * stamp[q - v + half, p - u + half])
                    if weighted:
                        product *= weights[frame, q, p] * weights[frame, q, p]
                    common += product
            for c in range(psi.shape[0]):
                taken[c, t, v, u] += seen[c] / np.sqrt(share) * common
            if size > exclusion[v - y + 2 * half, u - x + 2 * half]:
                spoilt[t, v, u] = True


@numba.njit(**FUSED_UNCHECKED)
def _largest_value(values, o, n):
    largest = values[o]
    for x in range(_U(n)):
        largest = values[o + x] if values[o + x] > largest else largest
    return largest


@numba.njit(**FUSED_UNCHECKED)
def _largest_of_rows(merit, largest, first_row, last_row):
    """Write the largest of each row of the last frame to largest[y]."""
    n_frames, n_y, n_x = merit.shape
    flat = merit.reshape(merit.size)
    for y in range(first_row, last_row):
        largest[y] = _largest_value(flat, _U(((n_frames - 1) * n_y + y) * n_x), n_x)


@numba.njit(**FUSED_UNCHECKED)
def find_targets(psi, phi, weights, stamp, exclusion, squared, signed, scores, merit, taken,
                 spoilt, rows, row_first, sets, bound, paths, seen, values):
    """Find target after target: the best path, its cancellation, the merit function again.

    ``scores`` are changed; ``merit`` is room to work in, and so are ``taken`` (as psi), what was
    subtracted from psi, and ``spoilt`` bool (T, Y, X), the pixels that are out of use. These two
    start as zeros and are touched near targets alone. Only what depends on a cancelled pixel is
    computed again, which leaves the same merit function as computing all of it.

    The targets are written to ``paths`` int32 (P, T, 2), their statistics to ``seen`` float32
    (P, C, T) and their merit to ``values`` (P,). Returns how many there are, the largest merit
    that is left, and the candidates that were looked at.
    """
    n_frames, n_y, n_x = merit.shape
    half = stamp.shape[0] // 2
    boxes = np.empty((n_frames, 4), np.int64)
    for t in range(n_frames):
        boxes[t, 0], boxes[t, 1], boxes[t, 2], boxes[t, 3] = 0, n_y, 0, n_x
    n_candidates = accumulate(merit, scores, rows, row_first, sets, boxes)
    largest = np.empty(n_y, np.float32)
    _largest_of_rows(merit, largest, 0, n_y)
    found = 0
    while True:
        y = np.argmax(largest)
        value = largest[y]
        if not value > bound or found == values.size:
            return found, value, n_candidates
        x = np.argmax(merit[n_frames - 1, y])
        _trace(merit, rows, row_first, sets, y, x, paths[found])
        values[found] = value
        for t in range(n_frames):
            x, y = paths[found, t, 0], paths[found, t, 1]
            _cancel_in_frame(psi, taken, spoilt, phi, weights, stamp, exclusion, t, y, x,
                             seen[found, :, t])
            boxes[t, 0], boxes[t, 1] = max(0, y - 2 * half), min(n_y, y + 2 * half + 1)
            boxes[t, 2], boxes[t, 3] = max(0, x - 2 * half), min(n_x, x + 2 * half + 1)
            _score_again(scores, psi, taken, spoilt, phi, t, boxes[t], squared, signed)
        _spread_boxes(boxes, rows, row_first, sets, n_y, n_x)
        n_candidates += accumulate(merit, scores, rows, row_first, sets, boxes)
        _largest_of_rows(merit, largest, boxes[n_frames - 1, 0], boxes[n_frames - 1, 1])
        found += 1
