"""Slow, readable twins of the compiled kernels."""

import itertools
import math

import numpy as np
from scipy import ndimage

from track_before_detect.preprocess.robust import robust_deviation
from track_before_detect.simulation.sensor import add_target


def every_path(graph, grid_shape):
    """Yield (positions (T, 2) in grid steps, cost of the turns) of every path of a state graph."""
    grid = graph.grid
    n_y, n_x = grid_shape
    for velocities in itertools.product(range(graph.n_velocities), repeat=graph.n_segments):
        turns = np.abs(np.diff(grid[list(velocities)], axis=0))
        if turns.size and turns.max() > graph.reach:
            continue
        for y, x in itertools.product(range(n_y), range(n_x)):
            start = np.array([x, y])
            positions = []
            for j, velocity in enumerate(velocities):
                for t in range(graph.knots[j], graph.knots[j + 1]):
                    positions.append(start + graph.moves[t, velocity])
                start = start + graph.end_moves[j, velocity]
            positions = np.array(positions)
            if (positions >= 0).all() and (positions < (n_x, n_y)).all():
                yield positions, graph.turn_cost * turns.sum()


def best_path_value(graph, scores):
    """Return the largest sum of scores less turn cost over every path, and its positions."""
    best = (-np.inf, None)
    for positions, cost in every_path(graph, scores.shape[1:]):
        value = sum(scores[t, y, x] for t, (x, y) in enumerate(positions)) - cost
        best = max(best, (value, positions.tolist()))
    return best


def gaussian_stamp(shape, position, sigma, half, valid=None):
    """Return a frame with the unit-norm Gaussian at position (x, y), cut to its stamp.

    All zero where no more than 1e-3 of its energy is left.
    """
    image = np.zeros(shape)
    whole = 0.0
    centre = np.ceil(np.asarray(position) - 0.5).astype(int)
    for y in range(centre[1] - half, centre[1] + half + 1):
        for x in range(centre[0] - half, centre[0] + half + 1):
            squared = (x - position[0])**2 + (y - position[1])**2
            value = np.exp(-squared / (2 * sigma**2))
            whole += value**2
            if 0 <= y < shape[0] and 0 <= x < shape[1] and (valid is None or valid[y, x]):
                image[y, x] = value
    left = np.sum(image**2)
    return image / np.sqrt(left) if left > 1e-3 * whole else 0 * image


MARGIN = 25


def psf_picture(psf, position):
    """Return a PSF at position (x, y) on pixels from -MARGIN on, drawn from its definition.

    Twice ``MARGIN`` and the largest frame of a test fit in; see ``cut``.
    """
    size = 2 * MARGIN + 40
    pixel = np.arange(size) - MARGIN
    if hasattr(psf, 'sigma_px'):
        profiles = []
        for centre in position:
            offset = pixel - centre
            if psf.integrated:
                edges = np.array([[math.erf((d + side) / (psf.sigma_px * math.sqrt(2)))
                                   for d in offset] for side in (-0.5, 0.5)])
                profile = edges[1] - edges[0]
            else:
                profile = np.exp(-offset**2 / (2 * psf.sigma_px**2))
            near = np.abs(pixel - math.ceil(centre - 0.5)) <= psf.half_width
            profiles.append(np.where(near, profile, 0))
        return np.outer(profiles[1], profiles[0])
    # Shifted on a wide canvas by the spline through its samples.
    array = psf.array
    canvas = np.zeros((size, size))
    whole = np.floor(np.asarray(position) + 0.5).astype(int)
    y, x = (MARGIN + whole[axis] - array.shape[1 - axis] // 2 for axis in (1, 0))
    canvas[y:y + array.shape[0], x:x + array.shape[1]] = array
    shifted = ndimage.shift(canvas, (position[1] - whole[1], position[0] - whole[0]), order=3)
    reach = psf.half_width
    kept = np.zeros_like(shifted)
    y, x = MARGIN + whole[1], MARGIN + whole[0]
    part = (slice(y - reach, y + reach + 1), slice(x - reach, x + reach + 1))
    kept[part] = shifted[part]
    return kept


def cut(picture, shape):
    """Return the part of a picture of ``psf_picture`` inside a frame."""
    return picture[MARGIN:MARGIN + shape[0], MARGIN:MARGIN + shape[1]]


def matched_filter(frame, psf, weights=None):
    """Return statistic and norm on the fine grid, one stamp at a time.

    ``frame`` is in units of the noise of each pixel, ``weights`` one over it.
    """
    height, width = frame.shape
    n_sub = psf.oversampling
    shape = (height - 1) * n_sub + 1, (width - 1) * n_sub + 1
    statistic, norms = np.empty(shape, frame.dtype), np.empty(shape)
    for y, x in np.ndindex(shape):
        # The grid belongs to the pixel at or before it; the stamp is centred there.
        position = np.array([x, y]) / n_sub
        moved = psf_picture(psf, position)
        whole = np.linalg.norm(moved)
        stamp = cut(moved, frame.shape)
        if weights is not None:
            stamp = stamp * weights
        norm = np.linalg.norm(stamp)
        norms[y, x] = norm / whole
        hidden = norms[y, x]**2 <= 1e-3
        statistic[y, x] = 0 if hidden else np.sum(stamp * frame) / norm
    return statistic, norms


def shrink(row, weight):
    """Minimise 1/2 |x - row|^2 + weight |x| over x >= 0 (closed form)."""
    positive = np.maximum(row, 0)
    norm = np.linalg.norm(positive)
    return positive * max(0.0, 1 - weight / norm) if norm > 0 else positive


def clipped(rows, envelopes, weights):
    """Minimise 1/2 |x - row|^2 + weight max |x_k| / course_k for each row, (P, T).

    What is cut off above a level is the largest sum of course (|row| - level course) over any set
    of frames, so the level is the largest at which one of these sums is the weight.
    """
    sizes = np.abs(rows)
    order = np.argsort(-sizes / np.maximum(envelopes, 1e-300), axis=1)
    sorted_sizes, sorted_courses = (np.take_along_axis(values, order, axis=1)
                                    for values in (sizes, envelopes))
    reached = ((np.cumsum(sorted_courses * sorted_sizes, axis=1) - weights[:, None])
               / np.maximum(np.cumsum(sorted_courses**2, axis=1), 1e-300))
    level = np.maximum(reached.max(axis=1, keepdims=True), 0)
    return rows * np.minimum(1, level * envelopes / np.maximum(sizes, 1e-300))


def convex_objective(amplitudes, matched, gram, weights, t):
    """Return 1/2 x'Gx - h'x + t sum_p w_p |x_p|."""
    n_paths, n_frames = amplitudes.shape
    value = 0.0
    for k in range(n_frames):
        x = amplitudes[:, k]
        value += 0.5 * x @ gram[:, :, k] @ x - matched[:, k] @ x
    return value + t * sum(w * np.linalg.norm(row)
                           for w, row in zip(weights, amplitudes, strict=True))


def first_order_merit(frames, v_max):
    """Return the merit function of Eq. 2 for a first-order method, forward through the frames."""
    merit = [frames[0].astype(np.float32)]
    for frame in frames[1:]:
        merit.append(first_order_step(merit[-1], frame, v_max))
    return np.array(merit)


def first_order_step(before, frame, v_max):
    """Return the merit function of one frame from that of the frame before."""
    height, width = frame.shape
    merit = np.empty((height, width), np.float32)
    for y, x in np.ndindex(height, width):
        reached = before[max(0, y - v_max):y + v_max + 1, max(0, x - v_max):x + v_max + 1]
        merit[y, x] = frame[y, x] + reached.max()
    return merit


def first_order_ring(frames, v_max):
    """Return the merit function of the ring of a first-order method."""
    forward = first_order_merit(frames, v_max)
    backward = np.empty_like(forward)
    backward[-1] = forward[-1]
    for t in range(len(frames) - 2, -1, -1):
        backward[t] = first_order_step(backward[t + 1], frames[t], v_max)
    forward[0] = backward[0]
    return (forward + backward) * np.float32(0.5)


class SecondOrderTwin:
    """Merit functions and velocities of a second-order method, one candidate after the other.

    Velocities are in half pixels per frame of the time in which the frames are passed through;
    None where unknown.
    """

    def __init__(self, frames, order, lines):
        self.frames = frames
        self.order = order
        self.lines = [tuple(map(tuple, line)) for line in lines.tolist()]

    def step(self, t, before, two_before, starting):
        """Return merit and velocities of frame t from those of two frames, each a pair."""
        height, width = self.frames[0].shape
        merit = np.empty((height, width), np.float32)
        velocities = np.empty((height, width), object)
        (t_1, merit_1, velocity_1), (t_2, merit_2, velocity_2) = before, two_before
        first = self.frames[t_1] if starting else merit_1
        second = merit_2 if self.order == 'mff' and not starting else self.frames[t_2]
        for y, x in np.ndindex(height, width):
            best = (-np.inf if starting else np.float32(0), None, np.float32(0))
            for velocity, one_back, two_back in self.lines:
                p_1 = (y - one_back[1], x - one_back[0])
                p_2 = (y - two_back[1], x - two_back[0])
                if not all(0 <= row < height and 0 <= column < width
                           for row, column in (p_1, p_2)):
                    continue
                if not starting and not (matches(velocity, velocity_1[p_1])
                                         and matches(velocity, velocity_2[p_2])):
                    continue
                value = first[p_1] + second[p_2]
                # Of equal candidates of one velocity the larger first merit goes on.
                if value > best[0]:
                    best = (value, velocity, first[p_1])
            value, velocities[y, x], kept = best
            if self.order == 'mff':
                merit[y, x] = self.frames[t][y, x] + np.float32(0.5) * value
            else:
                merit[y, x] = self.frames[t][y, x] + (value if starting else kept)
        return t, merit, velocities

    def forward(self):
        """Return the states of all frames of a plain method."""
        shape = self.frames[0].shape
        states = [(t, self.frames[t].astype(np.float32), np.full(shape, None, object))
                  for t in range(2)]
        for t in range(2, len(self.frames)):
            states.append(self.step(t, states[t - 1], states[t - 2], t < 4))
        return states

    def ring(self):
        """Return the merit functions of the ring, step by step as Algorithm 1 counts them."""
        n_frames = len(self.frames)
        forward = self.forward()
        backward = [None] * n_frames
        for t in (n_frames - 1, n_frames - 2):
            backward[t] = turned(forward[t])
        for t in range(n_frames - 3, -1, -1):
            backward[t] = self.step(t, backward[t + 1], backward[t + 2], False)
        for t in (0, 1):
            forward[t] = turned(backward[t])
        for t in range(2, min(4, n_frames)):
            forward[t] = self.step(t, forward[t - 1], forward[t - 2], False)
        return np.array([(ahead[1] + back[1]) * np.float32(0.5)
                         for ahead, back in zip(forward, backward, strict=True)])


def turned(state):
    """Return a state in reversed time (Eq. 7)."""
    t, merit, velocities = state
    reversed_velocities = np.empty_like(velocities)
    for place in np.ndindex(velocities.shape):
        velocity = velocities[place]
        reversed_velocities[place] = None if velocity is None else (-velocity[0], -velocity[1])
    return t, merit, reversed_velocities


def matches(velocity, other):
    """Return whether two velocities in half pixels per frame match (Eq. 4)."""
    return other is None or max(abs(velocity[0] - other[0]), abs(velocity[1] - other[1])) <= 1


def transition_merit(scores, sets):
    """Return scores[t, p] + max over (dx, dy) of sets[t] of the merit one frame before."""
    merit = np.array(scores, float)
    for t in range(1, len(merit)):
        for y, x in np.ndindex(*merit.shape[1:]):
            before = [merit[t - 1, y + dy, x + dx] for dx, dy in sets[t]
                      if 0 <= y + dy < merit.shape[1] and 0 <= x + dx < merit.shape[2]]
            merit[t, y, x] += max(before)
    return merit


def merit_of_pixel(psi, phi, squared, signed):
    """Return what a pixel adds to the merit function; psi has one part or two."""
    if phi <= 1e-3:
        return 0.0
    h = np.linalg.norm(psi) / np.sqrt(phi) if len(psi) == 2 or signed else psi[0] / np.sqrt(phi)
    return (max(h, 0) if not signed else h)**2 if squared else h


def cancelled_targets(psi, phi, weights, stamp, exclusion, squared, signed, sets, bound):
    """Return (path, statistics, merit) of target after target, all computed again each time."""
    psi, phi = np.array(psi, float), np.array(phi, float)
    n_frames, height, width = phi.shape
    half = len(stamp) // 2
    scale = np.ones(phi.shape) if not len(weights) else np.broadcast_to(weights, phi.shape)
    found = []
    while True:
        scores = np.array([[[merit_of_pixel(psi[:, t, y, x], phi[t, y, x], squared, signed)
                             for x in range(width)] for y in range(height)]
                           for t in range(n_frames)])
        merit = transition_merit(scores, sets)
        y, x = np.unravel_index(np.argmax(merit[-1]), merit[-1].shape)
        value = merit[-1, y, x]
        if not value > bound:
            return found
        path = [(x, y)]
        for t in range(n_frames - 1, 0, -1):
            reachable = [(x + dx, y + dy) for dx, dy in sets[t]
                         if 0 <= y + dy < height and 0 <= x + dx < width]
            x, y = max(reachable, key=lambda p, t=t: merit[t - 1, p[1], p[0]])
            path.insert(0, (x, y))
        seen = np.zeros((len(psi), n_frames))
        for t, (x, y) in enumerate(path):
            if phi[t, y, x] <= 1e-3:
                continue
            seen[:, t] = psi[:, t, y, x] / np.sqrt(phi[t, y, x])
            shown = np.zeros((height + 4 * half, width + 4 * half))
            shown[2 * half:2 * half + height, 2 * half:2 * half + width] = scale[t]**2
            target = np.zeros_like(shown)
            target[y + half:y + 3 * half + 1, x + half:x + 3 * half + 1] = stamp
            target *= shown
            for v in range(max(0, y - 2 * half), min(height, y + 2 * half + 1)):
                for u in range(max(0, x - 2 * half), min(width, x + 2 * half + 1)):
                    there = target[v + half:v + 3 * half + 1, u + half:u + 3 * half + 1]
                    psi[:, t, v, u] -= (seen[:, t] / np.sqrt(phi[t, y, x])
                                        * np.sum(there * stamp))
            share = phi[t].copy()
            for v in range(max(0, y - 2 * half), min(height, y + 2 * half + 1)):
                for u in range(max(0, x - 2 * half), min(width, x + 2 * half + 1)):
                    if np.linalg.norm(seen[:, t]) > exclusion[v - y + 2 * half, u - x + 2 * half]:
                        share[v, u] = 0
            phi[t] = share
        found.append((np.array(path), seen, value))


def stacked_statistics(psi, phi, grid, least, signed):
    """Return sum psi / sqrt(sum phi) of every velocity and position, shape (V, Y, X)."""
    n_frames, height, width = psi.shape
    reach = int(np.abs(grid.moves).max())
    around = np.pad([psi, phi], ((0, 0), (0, 0), (reach, reach), (reach, reach)))
    found = []
    for i, j in velocity_numbers(grid):
        sums = np.zeros((2, height, width))
        for t in range(n_frames):
            y, x = reach + grid.moves[i, t], reach + grid.moves[j, t]
            sums += around[:, t, y:y + height, x:x + width]
        data = np.abs(sums[0]) if signed else sums[0]
        found.append(np.where(sums[1] > least, data / np.sqrt(np.maximum(sums[1], least)), 0))
    return np.array(found)


def velocity_numbers(grid):
    """Yield (number of v_y, number of v_x) of every velocity."""
    for i, (first, last) in enumerate(zip(grid.first_vx, grid.last_vx, strict=True)):
        for j in range(first, last):
            yield i, j


def gaussian_stamp_image(shape, x, y, sigma):
    """Return an image (H, W) of one stamp of unit norm, then cut at the border."""
    image = np.zeros(shape)
    add_target(image, x, y, sigma, 1.0)
    return image


def ring_level(frame, floor, width_px):
    """Return the level around each pixel: of the frame, or of a square ring where that is more."""
    near, far = (round(side * width_px) for side in (3, 7))
    whole = robust_deviation(frame[::2, ::2], floor)
    level = np.full(frame.shape, whole)
    for y, x in np.ndindex(frame.shape):
        ring = [frame[j, i] ** 2
                for j in range(max(y - far, 0), min(y + far + 1, frame.shape[0]))
                for i in range(max(x - far, 0), min(x + far + 1, frame.shape[1]))
                if max(abs(j - y), abs(i - x)) > near and np.isfinite(frame[j, i])]
        if ring:
            level[y, x] = max(whole, math.sqrt(sum(ring) / len(ring)))
    return level
