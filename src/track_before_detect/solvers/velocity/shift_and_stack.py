"""The best constant velocity through each position, by shift-and-stack.

With psi the data over the variance seen through the PSF and phi the squared PSF over the variance,
a target of constant amplitude and known motion has the statistic sum psi / sqrt(sum phi), of unit
variance in noise, and the amplitude sum psi / sum phi (the velocity matched filtering of US
application 18/790,866, paragraph 18). A position is that in the middle of the batch; parts of a
motion outside the frame add nothing to either sum.
"""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels import velocity_stack
from track_before_detect.models.motion.velocity_grid import VelocityGrid


class VelocityStack:
    """Best velocity and its statistic for each position of frames of one size.

    Parameters
    ----------
    grid : VelocityGrid
        The velocities.
    shape : tuple of int
        (Y, X) of psi and phi.
    least_phi : float
        Sums with a smaller phi do not count.
    signed : bool
        Whether the statistic is that of either sign.
    n_threads : int
        Threads that share the rows.

    Attributes
    ----------
    best : float32 array, shape (Y, X)
        Largest statistic of each position.
    number : array of int32, shape (Y, X)
        Number of its velocity, -1 where there is none.
    """

    def __init__(self, grid: VelocityGrid, shape: tuple[int, int], least_phi: float,
                 signed: bool = False, n_threads: int = 1):
        self.grid = grid
        self.best = np.zeros(shape, np.float32)
        self.number = np.full(shape, -1, np.int32)
        self._least = np.float32(least_phi)
        self._signed = signed
        self._n_threads = n_threads
        self.reach = int(np.abs(grid.moves).max())

    def run(self, psi: NDArray, phi: NDArray,
            box: tuple[int, int, int, int] | None = None) -> None:
        """Search all positions, or those of a box (first y, last y, first x, last x).

        Parameters
        ----------
        psi, phi : float32 array, shape (T, Y, X)
            C-contiguous.
        box : tuple of int, optional
            The last ones are not included.
        """
        top, bottom, left, right = box or (0, self.best.shape[0], 0, self.best.shape[1])
        grid = self.grid

        def search(first: int, last: int) -> None:
            velocity_stack.best_velocities(
                self.best, self.number, psi, phi, grid.moves, grid.first_vx, grid.last_vx,
                self.reach, *grid.plan, self._least, self._signed, first, last, left,
                right)

        n_bands = min(self._n_threads, max(1, (bottom - top) // 8))
        if n_bands == 1:
            search(top, bottom)
            return
        bounds = np.linspace(top, bottom, n_bands + 1).astype(int)
        with ThreadPoolExecutor(n_bands) as pool:
            list(pool.map(search, bounds[:-1], bounds[1:]))
