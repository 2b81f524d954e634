"""What ``fit_paths`` is given and what it returns: data, paths and their stamps; amplitudes."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.fit import given_paths as kernels
from track_before_detect.kernels.psf.psf_stamps import render
from track_before_detect.models.measurement.psf import ArrayPsf, GaussianPsf
from track_before_detect.types import Step

# Slots of the table that finds equal positions, as a power of two; sparse tables are fast.
LEAST_TABLE_BITS = 16
_NO_WEIGHTS = np.zeros((0, 0, 0), np.float32)


@dataclass(frozen=True)
class FittedPaths:
    """Amplitudes of given paths.

    Attributes
    ----------
    amplitudes : array, shape (P, T)
        Of the unit-norm stamps; complex for complex amplitudes.
    objective : float
        F_t, with half the energy of the residual.
    gap : float
        Duality gap over all paths, absolute: the objective is above the smallest possible one by
        no more than this. NaN at t < 1, where the objective is not convex.
    status : str
        ``"converged"`` or ``"iteration_limit"``.
    violation : float
        Largest statistic of any path on the residual over lambda, less t.
    history : list of Step
        One entry for each search of all paths.
    """

    amplitudes: NDArray
    objective: float
    gap: float
    status: str = 'converged'
    violation: float = float('nan')
    history: list[Step] = field(default_factory=list)


class Problem:
    """Data and paths, with the stamp of every position rendered once.

    Parameters
    ----------
    data : array, shape (D, T, H, W)
        Real and, where complex, imaginary part; masked pixels zero.
    valid : array of bool, shape (T, H, W), or None
        Pixels that are not masked; None where none is.
    paths : array, shape (P, T, 2)
        Inside the frame.
    psf : GaussianPsf or ArrayPsf
        What a target looks like.
    weights : array, shape (P, T), or None
        Diagonals of W; None for the identity.
    non_negative : bool
        Whether amplitudes must not be negative.

    Attributes
    ----------
    energy : float
        Half the squared norm of the data.
    columns : array of int32, shape (P, T)
        Column of each path in each frame; see the kernels ``given_paths`` for this and others.
    """

    def __init__(self, data: NDArray, valid: NDArray | None, paths: NDArray,
                 psf: GaussianPsf | ArrayPsf, weights: NDArray | None, non_negative: bool):
        self.data = data
        self.energy = 0.5 * float(np.vdot(data, data))
        self.weights = weights
        self.non_negative = non_negative
        places, keys = _numbered(paths)
        self.columns, self.column_place, column_frame = kernels.number_columns(places, len(keys))
        self.stamps, self.origins, shares = _rendered(keys, psf, data.shape[2:])
        if valid is not None:
            self.stamps, self.origins = kernels.mask_stamps(
                self.stamps, self.origins, shares, self.column_place, column_frame, valid)
            self.column_place = np.arange(len(self.column_place), dtype=np.int32)
        self._starts = kernels.first_pixels(self.column_place, column_frame, self.origins,
                                            *data.shape[2:])

    @property
    def n_paths(self) -> int:
        """Paths that are given."""
        return len(self.columns)

    @property
    def n_columns(self) -> int:
        """Positions in frames that any path passes."""
        return len(self.column_place)

    def correlate(self, residual: NDArray, chosen: NDArray, out: NDArray) -> None:
        """Fill the correlations (D, N) of the chosen columns with a residual."""
        kernels.correlate(chosen, self.stamps, self._starts, self.column_place, residual, out)

    def fill_statistics(self, chosen: NDArray, correlations: NDArray, out: NDArray) -> float:
        """Fill the statistics (P,) of the chosen paths and return the largest of these."""
        return kernels.path_statistics(chosen, self.columns, correlations, self.weights,
                                       self.non_negative, out)

    def places(self, members: NDArray) -> NDArray[np.int64]:
        """Return the number of the stamp of some paths in each frame, (n, T)."""
        return self.column_place[self.columns[members]].astype(np.int64)

    def fill_gram(self, places: NDArray, n_old: int, gram: NDArray) -> None:
        """Fill the inner products (n, n, T) of stamps (n, T) that ``n_old`` and later are in."""
        kernels.fill_gram(places, n_old, self.stamps, self.origins, gram)

    def residual(self, members: NDArray, amplitudes: NDArray) -> NDArray[np.float64]:
        """Return the data less amplitudes (n, D, T) of some paths."""
        residual = self.data.copy()
        kernels.subtract(members, amplitudes, self.columns, self.stamps, self.origins,
                         self.column_place, residual)
        return residual

    def fitted(self, members: NDArray, amplitudes: NDArray, gap: float, status: str,
               history: Sequence[Step]) -> FittedPaths:
        """Return the result: amplitudes (n, D, T) of some paths, those of all others zero."""
        n_parts, n_frames = amplitudes.shape[1:]
        result = np.zeros((self.n_paths, n_frames), complex if n_parts == 2 else float)
        result[members] = amplitudes[:, 0]
        if n_parts == 2:
            result[members] += 1j * amplitudes[:, 1]
        return FittedPaths(result, history[-1].objective, gap, status, history[-1].violation,
                           list(history))


def _numbered(paths: NDArray) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Return the place of each path in each frame, (P, T), and the keys of the places."""
    bits, enough = LEAST_TABLE_BITS, 2 * paths.shape[0] * paths.shape[1]
    while True:
        places, keys, fits = kernels.number_places(paths, bits)
        if fits:
            return places, keys
        bits = min(bits + 3, enough.bit_length())


def _rendered(keys: NDArray, psf: GaussianPsf | ArrayPsf,
              shape: tuple[int, int]) -> tuple[NDArray, NDArray, NDArray]:
    """Return stamps, origins and shares of all places, as the kernels ``given_paths`` say."""
    if psf.gaussian_sigma_px is not None:
        # Exact, where its splines are to 1e-7, and four times as fast.
        return kernels.render_gaussians(keys, float(psf.gaussian_sigma_px), psf.integrated,
                                        psf.half_width, *shape)
    optics = psf.optics()
    size = 2 * optics.half + 1
    stamps = np.empty((len(keys), size, size))
    origins, norms = np.empty((len(keys), 2), np.int64), np.empty(len(keys))
    render(optics, keys / kernels.PLACES_PER_PX, *shape, _NO_WEIGHTS, stamps, origins, norms)
    return *kernels.move_inside(stamps, origins, *shape), norms**2
