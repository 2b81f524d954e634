"""Slow, readable twins of the compiled kernels."""

import itertools

import numpy as np


def every_path(graph, grid_shape):
    """Yield (positions (T, 2) in grid steps, cost of the turns) of every path of a state graph."""
    grid = np.rint(graph.velocities / graph.velocity_step).astype(int)
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
    """Return a frame with the unit-norm Gaussian at position (x, y), cut to its stamp."""
    image = np.zeros(shape)
    centre = np.floor(np.asarray(position) + 0.5).astype(int)
    for y in range(max(0, centre[1] - half), min(shape[0], centre[1] + half + 1)):
        for x in range(max(0, centre[0] - half), min(shape[1], centre[0] + half + 1)):
            if valid is None or valid[y, x]:
                squared = (x - position[0])**2 + (y - position[1])**2
                image[y, x] = np.exp(-squared / (2 * sigma**2))
    norm = np.linalg.norm(image)
    return image / norm if norm > 1e-3 else 0 * image


def matched_filter(frame, sigma, half, n_sub, valid=None):
    """Return the statistic on the fine grid, one stamp at a time."""
    height, width = frame.shape
    data = frame if valid is None else np.where(valid, frame, 0)
    out = np.empty(((height - 1) * n_sub + 1, (width - 1) * n_sub + 1))
    for y, x in np.ndindex(out.shape):
        # The grid belongs to the pixel at or before it; the stamp is centred there.
        stamp = np.zeros(frame.shape)
        for row in range(max(0, y // n_sub - half), min(height, y // n_sub + half + 1)):
            for column in range(max(0, x // n_sub - half), min(width, x // n_sub + half + 1)):
                if valid is None or valid[row, column]:
                    squared = (row - y / n_sub)**2 + (column - x / n_sub)**2
                    stamp[row, column] = np.exp(-squared / (2 * sigma**2))
        norm = np.linalg.norm(stamp)
        out[y, x] = np.sum(stamp * data) / norm if norm > 0 else 0
    return out


def shrink(row, weight):
    """Minimise 1/2 |x - row|^2 + weight |x| over x >= 0 (closed form)."""
    positive = np.maximum(row, 0)
    norm = np.linalg.norm(positive)
    return positive * max(0.0, 1 - weight / norm) if norm > 0 else positive


def convex_objective(amplitudes, matched, gram, weights, t):
    """Return 1/2 x'Gx - h'x + t sum_p w_p |x_p|."""
    n_paths, n_frames = amplitudes.shape
    value = 0.0
    for k in range(n_frames):
        x = amplitudes[:, k]
        value += 0.5 * x @ gram[:, :, k] @ x - matched[:, k] @ x
    return value + t * sum(w * np.linalg.norm(row)
                           for w, row in zip(weights, amplitudes, strict=True))
