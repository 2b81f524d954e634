"""Every path of a small graph one by one, and the convex optimum over all of them, slowly."""

import itertools

import numpy as np

import naive

HIDDEN = 1e-3


class EveryPath:
    """All paths of a graph in some frames, drawn pixel by pixel.

    Parameters
    ----------
    paths : list of (positions (T, 2) in pixels, cost of the turns)
    psf : Psf
    kind : str
        ``"non-negative"``, ``"signed"``, ``"complex"``, with ``" constant"`` for one amplitude.
    shape : tuple of int
        (H, W) of the frames.
    n_frames : int
    weights : array, shape (T, H, W), optional
        One over the noise of each pixel, zero where masked.
    """

    def __init__(self, paths, psf, kind, shape, n_frames, weights=None):
        self.kind, _, constant = kind.partition(' ')
        # A complex amplitude is constant in its modulus alone.
        self.one_modulus = kind == 'complex constant'
        self.constant = bool(constant) and not self.one_modulus
        self.positions = np.array([positions for positions, _ in paths])
        self.costs = np.array([cost for _, cost in paths])
        self.places, self.cells = np.unique(self.positions.reshape(-1, 2), axis=0,
                                            return_inverse=True)
        self.cells = self.cells.reshape(len(paths), n_frames)
        stamps = np.zeros((n_frames, len(self.places), *shape))
        self.norms = np.zeros((n_frames, len(self.places)))
        for t, place in itertools.product(range(n_frames), range(len(self.places))):
            whole = naive.psf_picture(psf, self.places[place])
            seen = naive.cut(whole, shape) * (1 if weights is None else weights[t])
            norm = np.linalg.norm(seen)
            if norm**2 > HIDDEN * np.linalg.norm(whole)**2:
                stamps[t, place] = seen / norm
                self.norms[t, place] = norm / np.linalg.norm(whole)
        if weights is None:
            self.norms[:] = 1.0
        self.stamps = stamps.reshape(n_frames, len(self.places), -1)
        frame = np.arange(n_frames)
        # Of constant amplitudes: the column of a path is the sum of its stamps times these.
        norms = self.norms[frame, self.cells]
        self.total = np.sqrt(np.sum(norms**2, axis=1))
        self.shares = norms / np.maximum(self.total, 1e-300)[:, None]
        # Columns of fluctuating amplitudes are divided by these.
        self.frame_weights = np.ones((len(paths), 1))

    def weighted(self, frame_weights):
        """Return the same paths with a weight for each of their frames, (P, T)."""
        other = EveryPath.__new__(EveryPath)
        other.__dict__ = {**self.__dict__, 'frame_weights': frame_weights}
        return other

    def along(self, frames):
        """Return the matched filter along each path, (P, T); one number each if constant."""
        seen = np.einsum('tpi,ti->tp', self.stamps, frames.reshape(len(frames), -1))
        seen = seen[np.arange(len(frames)), self.cells]
        if self.constant:
            return (self.shares * seen).sum(axis=1, keepdims=True)
        return seen / self.frame_weights

    def picture(self, x):
        """Return the frames of paths of amplitudes (P, T), or (P, 1) if constant."""
        n_frames = self.stamps.shape[0]
        spread = self.shares * x if self.constant else x / self.frame_weights
        at_places = np.zeros((n_frames, len(self.places)), x.dtype)
        for t in range(n_frames):
            np.add.at(at_places[t], self.cells[:, t], spread[:, t])
        return np.einsum('tpi,tp->ti', self.stamps, at_places)

    def statistics(self, frames):
        """Return eta of every path."""
        return self.dual_norms(self.along(frames), self.shares)

    def dual_norms(self, seen, shares):
        """Return the dual norm of what each path sees, (P,)."""
        if self.one_modulus:
            return np.sum(shares * np.abs(seen), axis=1)
        return np.linalg.norm(np.maximum(seen, 0) if self.kind == 'non-negative' else seen,
                              axis=1)

    def norms_of(self, x, shares):
        """Return the norm of the amplitudes of each path, (P,)."""
        if self.one_modulus:
            return np.max(np.abs(x) / np.where(shares > 0, shares, np.inf), axis=1)
        return np.linalg.norm(x, axis=1)

    def shrunk(self, x, shares, weights):
        """Return the proximal step of the norms times ``weights`` (P,) from x."""
        if self.one_modulus:
            return naive.clipped(x, shares, weights)
        if self.kind == 'non-negative':
            x = np.maximum(x, 0)
        size = np.linalg.norm(x, axis=1)
        return x * np.maximum(0, 1 - weights / np.maximum(size, 1e-300))[:, None]

    def weights_of(self, threshold):
        """Return lambda of every path."""
        if self.constant or self.one_modulus:
            return threshold + self._turn_prices()
        return np.sqrt(threshold**2 + self.costs)

    def _turn_prices(self):
        """Return the cost of the turns on the scale of the statistic of a constant amplitude."""
        return self.costs * np.sqrt(len(self.stamps)) / np.maximum(self.total, 1e-300)

    def values(self, frames):
        """Return statistic less cost as the search adds them up."""
        if self.constant or self.one_modulus:
            return self.statistics(frames) - self._turn_prices()
        return self.statistics(frames)**2 - self.costs

    def optimum(self, frames, weights, tolerance):
        """Minimise 1/2 |y - A x|^2 + sum w |x| over all paths by proximal steps.

        Returns the objective and a bound below the smallest one, from the dual.
        """
        data = frames.reshape(len(frames), -1)
        energy = 0.5 * np.linalg.norm(data)**2
        member = np.zeros(len(weights), bool)
        member[np.argmax(self.statistics(frames) / weights)] = True
        x = np.zeros((len(weights), 1 if self.constant else len(frames)), data.dtype)
        while True:
            x[member] = self._fitted(data, x, member, weights, 0.1 * tolerance * energy)
            residual = data - self.picture(x)
            excess = self.statistics(residual) / weights
            objective = (0.5 * np.linalg.norm(residual)**2
                         + np.sum(weights * self.norms_of(x, self.shares)))
            # Scaled until feasible the residual bounds the optimum from below.
            scale = min(1.0, 1 / excess.max())
            below = (scale * np.vdot(residual, data).real
                     - 0.5 * scale**2 * np.linalg.norm(residual)**2)
            if objective - below <= tolerance * energy:
                return objective, below
            member |= np.isin(np.arange(len(weights)), np.argsort(-excess)[:5]) & (excess > 1)

    def _columns(self, member):
        """Return the columns of paths, (n, K, pixels): K frames, or one of all if constant."""
        n_frames = self.stamps.shape[0]
        stamps = self.stamps[np.arange(n_frames), self.cells[member]]
        if self.constant:
            return (self.shares[member, :, None] * stamps).reshape(len(stamps), 1, -1)
        return stamps / self.frame_weights[member][..., None]

    def _fitted(self, data, x, member, weights, gap):
        """Return amplitudes of the members by accelerated proximal steps with restarts."""
        columns = self._columns(member)
        matched = np.einsum('pki,ki->pk', columns, data.reshape(columns.shape[1], -1))
        gram = np.einsum('pki,qki->kpq', columns, columns)
        energy = np.linalg.norm(data)**2
        x, weights, shares = x[member], weights[member], self.shares[member]
        step = 1 / np.linalg.eigvalsh(gram).max()

        def explained(x):
            return (gram @ x.T[..., None])[..., 0].T

        ahead, momentum = x, 1.0
        for number in range(100000):
            moved = ahead + step * (matched - explained(ahead))
            new = self.shrunk(moved, shares, step * weights)
            if np.vdot(ahead - new, new - x).real > 0:
                momentum = 1.0
            following = 0.5 * (1 + np.sqrt(1 + 4 * momentum**2))
            ahead = new + (momentum - 1) / following * (new - x)
            x, momentum = new, following
            if number % 50 == 0:
                fit = explained(x)
                left = matched - fit
                excess = np.max(self.dual_norms(left, shares) / weights)
                scale = min(1.0, 1 / excess)
                cross = np.vdot(x, matched).real
                residual = energy - 2 * cross + np.vdot(x, fit).real
                objective = 0.5 * residual + np.sum(weights * self.norms_of(x, shares))
                below = scale * (energy - cross) - 0.5 * scale**2 * residual
                if objective - below <= gap:
                    break
        return x


def best_in_any_frames(graph, scores, presence=None, squares=None, kinds=None):
    """Return the largest value of any path of a graph in any frames, and its positions (T, 2).

    Positions are in grid steps, NaN where the path is absent. Without ``presence`` paths last from
    the first frame to the last.

    scores : array, shape (C * T, Y, X), one for each kind; -inf where no path may be
    squares : array, of the same shape
        n^2 where scores are n h of a constant amplitude, whose statistic is sought.
    kinds : array of int, shape (V,)
    """
    n_frames, (n_y, n_x) = graph.n_frames, scores.shape[1:]
    kinds = np.zeros(graph.n_velocities, int) if kinds is None else kinds
    start_y, start_x = np.mgrid[:n_y, :n_x]
    best, found = -np.inf, None
    for j_first, j_last in itertools.combinations_with_replacement(range(graph.n_segments), 2):
        if presence is None and (j_first, j_last) != (0, graph.n_segments - 1):
            continue
        frames = range(graph.knots[j_first], graph.knots[j_last + 1])
        for chosen in itertools.product(range(graph.n_velocities), repeat=j_last - j_first + 1):
            turns = np.abs(np.diff(graph.grid[list(chosen)], axis=0))
            if turns.size and turns.max() > graph.reach:
                continue
            start = np.stack([start_x, start_y], axis=-1)
            possible = np.zeros((n_y, n_x))
            met, seen, places = (np.full((n_frames, n_y, n_x, *more), np.nan)
                                 for more in ((), (), (2,)))
            for j, velocity in enumerate(chosen, j_first):
                possible[~inside(start, n_y, n_x)] = -np.inf
                for t in range(graph.knots[j], graph.knots[j + 1]):
                    places[t] = start + graph.moves[t, velocity]
                    x, y = np.moveaxis(places[t].astype(int), -1, 0)
                    here = (kinds[velocity] * n_frames + t, y.clip(0, n_y - 1),
                            x.clip(0, n_x - 1))
                    met[t] = np.where(inside(places[t], n_y, n_x), scores[here], -np.inf)
                    seen[t] = 0 if squares is None else squares[here]
                start = start + graph.end_moves[j, velocity]
            for first, last in itertools.combinations_with_replacement(frames, 2):
                if first >= graph.knots[j_first + 1] or last < graph.knots[j_last]:
                    continue
                if presence is None and (first, last) != (0, n_frames - 1):
                    continue
                cost = graph.turn_cost * turns.sum()
                if presence:
                    cost += presence.cost(first, last, n_frames)
                value = met[first:last + 1].sum(axis=0) + possible
                if squares is None:
                    value = value - cost
                else:
                    value = ((value - n_frames**0.5 * cost)
                             / np.sqrt(np.maximum(seen[first:last + 1].sum(axis=0), 1e-9)))
                at = np.unravel_index(np.argmax(value), value.shape)
                if value[at] > best:
                    best, found = value[at], np.full((n_frames, 2), np.nan)
                    found[first:last + 1] = places[first:last + 1, at[0], at[1]]
    return best, found


def inside(positions, n_y, n_x):
    """Return which positions (..., 2) are on a grid."""
    return np.all((positions >= 0) & (positions < (n_x, n_y)), axis=-1)
