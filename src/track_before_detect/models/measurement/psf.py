"""Point spread functions: what a target looks like, at any position between the pixels."""

from __future__ import annotations

from abc import ABC, abstractmethod
from copy import copy
from dataclasses import dataclass
from functools import cached_property
import hashlib
import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import spline_filter1d
from scipy.special import ndtr

from track_before_detect.errors import ParameterError
from track_before_detect.kernels.psf.measurement import CompiledMeasurement
from track_before_detect.kernels.psf.psf_profiles import fill_profiles, Optics, product_norm
from track_before_detect.models.amplitudes import AmplitudeModel
from track_before_detect.models.measurement.base import Frames, OverRows, Scores, SearchWork
from track_before_detect.models.measurement.psf_scores import PsfScores
from track_before_detect.models.motion.state_graph import StateGraph

if TYPE_CHECKING:
    from typing_extensions import Self

LEAST_SIGMA_PX = 0.2
# Samples of a Gaussian per standard deviation: a cubic spline through them is exact to 1e-7.
SAMPLES_PER_SIGMA = 16
# Shares of the norm of an array that its splines may lose beyond the stamp, and that stamps and
# the matched filter may lose with the components left out.
LOST_IN_STAMP = 1e-4
LOST_TO_ROUNDING = 1e-8
LOST_IN_FILTER = 3e-3
WIDEST_MARGIN = 8


class Psf(ABC):
    """A point spread function that is the same everywhere in the frame.

    It is a sum of products of a profile in y and one in x, each a cubic spline. Stamps are scaled
    to unit norm over the pixels they cover inside the frame, weighed by one over their noise: so
    the matched filter statistic has unit variance everywhere.
    """

    _on_whole_pixels = False
    # Of a Gaussian, whether it is integrated over each pixel.
    integrated: bool = False

    @property
    @abstractmethod
    def key(self) -> str:
        """Text that differs between PSFs that differ."""

    @property
    @abstractmethod
    def half_width(self) -> int:
        """Pixels from the centre to the edge of the stamp."""

    @property
    @abstractmethod
    def per_px(self) -> int:
        """Spline coefficients per pixel."""

    @property
    @abstractmethod
    def coefficients(self) -> NDArray[np.float64]:
        """Spline coefficients, shape (C, 2, N): components, y and x, N odd."""

    @property
    def filter_rank(self) -> int:
        """Components that the matched filter needs."""
        return len(self.coefficients)

    @cached_property
    def curvature(self) -> NDArray[np.float64]:
        """Squared norm of the slope of the unit-norm stamp in x and in y, per pixel squared.

        A target d px off loses curvature * d^2 / 2 of its statistic.
        """
        found = []
        for phase in np.arange(4) / 4:
            rows, row_slopes = self.profiles(0, phase)
            columns, column_slopes = self.profiles(1, phase)
            ends = (0, rows.shape[1], 0, columns.shape[1])
            norm = product_norm(rows, columns, *ends)
            found.append([product_norm(rows, column_slopes, *ends) / norm,
                          product_norm(row_slopes, columns, *ends) / norm])
        return np.mean(found, axis=0)

    @property
    def width_px(self) -> float:
        """Standard deviation of the Gaussian that is as sharp."""
        return float(1 / math.sqrt(self.curvature.sum()))

    @property
    def oversampling(self) -> int:
        """Grid positions per pixel that keep the loss between grid positions small.

        A target half a grid step off in x and y loses 1 - exp(-step^2 / (8 sigma^2)) of its
        statistic: 3 % at sigma = 1 px on half pixels, 3 % at 2 px on whole pixels.
        """
        if self._on_whole_pixels:
            return 1
        return 1 if 1 / math.sqrt(2 * self.curvature.max()) >= 2 - 1e-9 else 2

    def on_whole_pixels(self) -> Self:
        """Return the same PSF, searched on whole pixels, which takes a tenth of the time.

        Between the grid positions more of the statistic is lost before paths are refined, 12 % at
        sigma = 1 px and 5 % at 1.5 px.
        """
        coarse = copy(self)
        object.__setattr__(coarse, '_on_whole_pixels', True)
        return coarse

    @property
    def gaussian_sigma_px(self) -> float | None:
        """Standard deviation of a Gaussian; None of any other PSF."""
        return None

    @property
    def is_one_gaussian(self) -> bool:
        """Whether it is a Gaussian that does not move while a frame is taken."""
        return False

    def profiles(self, axis: int, phase_px: float) -> tuple[NDArray, NDArray]:
        """Return the profiles around a position ``phase_px`` after a pixel centre, and slopes.

        Parameters
        ----------
        axis : int
            0 for y, 1 for x.
        phase_px : float
            Pixels, -1/2 to 1/2 or a little more.

        Returns
        -------
        values, slopes : array, shape (C, 2 * half_width + 1)
            The middle entry belongs to that pixel; slopes are those by the position.
        """
        shape = (len(self.coefficients), 2 * self.half_width + 1)
        values, slopes = np.empty(shape), np.empty(shape)
        fill_profiles(self.optics(), phase_px, 0.0, axis, -self.half_width, np.ones(1), values,
                      slopes)
        return values, slopes

    def optics(self, curvature: NDArray | None = None) -> Optics:
        """Return what compiled loops need; the curvature only for climbing."""
        return Optics(self.coefficients, self.per_px, self.half_width, np.zeros(1), np.ones(1),
                      np.zeros(2) if curvature is None else curvature, 0.0, 0.0, np.empty(0))

    def compiled(self, with_curvature: bool = False) -> CompiledMeasurement:
        """Return what compiled loops need to see a path in frames of these pixels."""
        optics = self.optics(self.curvature if with_curvature else None)
        return CompiledMeasurement((optics,), np.zeros(0, np.int64), np.empty((0, 3, 3)))

    @property
    def exact_times(self) -> bool:
        """Whether it matters when exactly each frame was taken: not with one sensor."""
        return False

    def slice(self, frames: Frames) -> Psf:
        """Return the model of some of the frames, which all look the same."""
        return self

    def plane_shape(self, frame_shape: tuple[int, int]) -> tuple[int, int]:
        """Return the size (H, W) of the plane of positions, that of the frames."""
        return frame_shape

    def frame_shape(self, plane_shape: tuple[int, int]) -> tuple[int, int]:
        """Return the size (H, W) of the frames that see a plane of a size."""
        return plane_shape

    def window(self, shape: tuple[int, int]) -> Psf:
        """Return the model of a part of the plane."""
        return self

    def limits(self, shape: tuple[int, int]) -> NDArray[np.float64]:
        """Return the largest x and y of a position in frames (H, W)."""
        return np.array([shape[1] - 1.0, shape[0] - 1.0])

    def gaussian(self, width_px: float) -> Psf:
        """Return what a Gaussian target of a width looks like, or of the least width there is."""
        return GaussianPsf(max(width_px, LEAST_SIGMA_PX))

    def scores(self, graph: StateGraph, shape: tuple[int, int], amplitudes: AmplitudeModel,
               over_rows: OverRows) -> Scores:
        """Return the scores of all positions; see ``MeasurementModel``."""
        return PsfScores(self, shape, amplitudes, over_rows)

    def search_work(self, graph: StateGraph, is_complex: bool) -> SearchWork:
        """Return what a search of the paths of a graph has to compute."""
        n_parts = len(self.coefficients)
        stamps = graph.n_frames * n_parts * self.optics().nodes.size
        return SearchWork(1, graph.n_frames * n_parts, 0, 0, 0, stamps,
                          stamps * (2 * self.half_width + 1)**2)


@dataclass(frozen=True)
class GaussianPsf(Psf):
    """Gaussian point spread function.

    Attributes
    ----------
    sigma_px : float
        Standard deviation in pixels.
    integrated : bool
        Whether a pixel sees the mean over its area instead of the value at its centre.
    """

    sigma_px: float
    integrated: bool = False

    def __post_init__(self) -> None:
        if not (math.isfinite(self.sigma_px) and self.sigma_px >= LEAST_SIGMA_PX):
            raise ParameterError(
                f'sigma_px must be at least {LEAST_SIGMA_PX:g} px, got {self.sigma_px!r}: '
                'between pixels nothing would be seen of a narrower target')

    @property
    def key(self) -> str:
        """Text that differs between PSFs that differ."""
        return repr(self)

    @property
    def gaussian_sigma_px(self) -> float:
        """Standard deviation."""
        return self.sigma_px

    @property
    def is_one_gaussian(self) -> bool:
        """Sampled or integrated over each pixel."""
        return True

    @property
    def half_width(self) -> int:
        """Pixels from the centre to the edge of the stamp; 4 sigma holds all but 1e-7 of it."""
        return math.ceil(4 * self.sigma_px + (0.5 if self.integrated else 0.0))

    @property
    def per_px(self) -> int:
        """Spline coefficients per pixel."""
        return math.ceil(SAMPLES_PER_SIGMA / self.sigma_px)

    @cached_property
    def coefficients(self) -> NDArray[np.float64]:
        """Spline coefficients, shape (1, 2, N)."""
        reach = (self.half_width + 2) * self.per_px
        offset = np.arange(-reach, reach + 1) / self.per_px
        if self.integrated:
            profile = (ndtr((offset + 0.5) / self.sigma_px)
                       - ndtr((offset - 0.5) / self.sigma_px))
        else:
            profile = np.exp(-offset**2 / (2 * self.sigma_px**2))
        return np.repeat(spline_filter1d(profile, mode='mirror')[None, None], 2, axis=1)

    def taps(self, phase_px: float) -> NDArray[np.float64]:
        """Return the unit-norm profile around a position ``phase_px`` after a pixel centre.

        Returns
        -------
        array, shape (2 * half_width + 1,)
            Of one axis; the middle entry belongs to that pixel.
        """
        profile = self.profiles(1, phase_px)[0][0]
        return profile / np.linalg.norm(profile)

    @cached_property
    def curvature(self) -> NDArray[np.float64]:
        """Squared norm of the slope of the unit-norm stamp in x and in y, per pixel squared."""
        return super().curvature if self.integrated else np.full(2, 1 / (2 * self.sigma_px**2))


class ArrayPsf(Psf):
    """Point spread function given as an array, between the pixels by a cubic spline.

    The array is taken as zero outside. Its scale does not matter.

    Parameters
    ----------
    array : array, shape (H, W), both odd
        The target is in the middle pixel.

    Attributes
    ----------
    array : array, shape (H, W)
        Scaled to unit norm.
    """

    def __init__(self, array: ArrayLike):
        self.array = of_unit_norm(array)
        left, values, right = np.linalg.svd(self.array)
        rest = np.sqrt(np.append(np.cumsum(values[::-1]**2)[::-1], 0.0))
        n_components = max(1, int(np.argmax(rest <= LOST_TO_ROUNDING * rest[0])))
        self._filter_rank = max(1, int(np.argmax(rest <= LOST_IN_FILTER * rest[0])))
        half = max(self.array.shape) // 2
        self._coefficients, self._half_width = _splines(
            left.T[:n_components] * values[:n_components, None], right[:n_components], half)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ArrayPsf) and np.array_equal(self.array, other.array)

    def __hash__(self) -> int:
        return hash(self.key)

    @cached_property
    def key(self) -> str:
        """Text that differs between PSFs that differ."""
        digest = hashlib.sha256(self.array.tobytes()).hexdigest()
        return f'ArrayPsf({self.array.shape}, {digest})'

    @property
    def half_width(self) -> int:
        """Pixels from the centre to the edge of the stamp, the ringing of the spline included."""
        return self._half_width

    @property
    def per_px(self) -> int:
        """Spline coefficients per pixel."""
        return 1

    @property
    def coefficients(self) -> NDArray[np.float64]:
        """Spline coefficients, shape (C, 2, N), components by descending norm."""
        return self._coefficients

    @property
    def filter_rank(self) -> int:
        """Components that the matched filter needs."""
        return self._filter_rank


def of_unit_norm(psf: ArrayLike) -> NDArray[np.float64]:
    """Return a point spread function that is given as an array, scaled to unit norm.

    Parameters
    ----------
    psf : array, shape (H, W), both odd
        Of any scale.

    Raises
    ------
    ParameterError
        It is no such array, not finite, or zero.
    """
    array = np.asarray(psf)
    if array.dtype.kind not in 'biuf':
        raise ParameterError(f'psf must be an array of real numbers, got {array.dtype}')
    if array.ndim != 2 or array.shape[0] % 2 == 0 or array.shape[1] % 2 == 0:
        raise ParameterError(
            f'psf must be a 2-D array with odd sides, got the shape {array.shape}')
    array = np.ascontiguousarray(array, np.float64)
    norm = float(np.linalg.norm(array))
    if not (math.isfinite(norm) and norm > 0):
        raise ParameterError(f'psf must be finite and not all zero, got one of norm {norm:g}')
    return array / norm


def _splines(rows: NDArray, columns: NDArray, half: int) -> tuple[NDArray[np.float64], int]:
    """Return coefficients (C, 2, N) of profiles in y and x, and the half width they reach."""
    padding = half + WIDEST_MARGIN + 3
    sides = []
    for profiles in (rows, columns):
        padded = np.zeros((len(profiles), 2 * padding + 1))
        own = profiles.shape[1] // 2
        padded[:, padding - own:padding + own + 1] = profiles
        sides.append(spline_filter1d(padded, axis=1, mode='mirror'))
    coefficients = np.ascontiguousarray(np.stack(sides, axis=1))
    # A spline rings beyond its last sample; away from the samples that is as large as its
    # coefficients.
    size = np.sqrt(np.sum(coefficients[:, 0]**2, axis=1) * np.sum(coefficients[:, 1]**2, axis=1))
    margin = 0
    while margin < WIDEST_MARGIN:
        beyond = coefficients.copy()
        beyond[:, :, padding - half - margin:padding + half + margin + 1] = 0
        share = np.sqrt(np.sum(beyond**2, axis=(1, 2)) / np.sum(coefficients**2, axis=(1, 2)))
        if np.linalg.norm(share * size) <= LOST_IN_STAMP * np.linalg.norm(size):
            break
        margin += 1
    return coefficients, half + margin
