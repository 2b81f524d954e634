"""A plane that several sensors see, each in its own pixels and with its own PSF."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
import hashlib
import math

import numpy as np
from numpy.typing import NDArray

from track_before_detect import geometry
from track_before_detect.kernels.psf.measurement import CompiledMeasurement, curvatures
from track_before_detect.models.amplitudes import AmplitudeModel
from track_before_detect.models.measurement.base import Frames, OverRows, Scores, SearchWork
from track_before_detect.models.measurement.multi_sensor_scores import MultiSensorScores
from track_before_detect.models.measurement.psf import Psf
from track_before_detect.models.motion.state_graph import StateGraph

# Places of the plane, along each side, at which the sharpness of the PSFs is looked at.
N_PLACES = 3
# Grid positions per pixel of the sharpest sensor with a standard deviation of one pixel, and the
# most per pixel of the plane.
POSITIONS_PER_SIGMA = 2.0
MOST_PER_PX = 4


@dataclass(frozen=True, eq=False)
class MultiSensor:
    """How each frame of a batch sees the positions of a common plane.

    It stands where the PSF of a single sensor does; positions are pixels of the plane.

    Attributes
    ----------
    psfs : tuple of Psf
        One for each sensor, in its own pixels.
    shapes : tuple of (int, int)
        (H, W) of each sensor's frames; frames of a batch are padded to the largest.
    sensor : array of int, shape (T,)
        Which sensor took each frame.
    maps : array, shape (T, 3, 3)
        Takes the plane to the pixels of each frame, see the module ``geometry``.
    shape : tuple of int
        (H, W) of the plane, whose first pixel centre is (0, 0).
    """

    psfs: tuple[Psf, ...]
    shapes: tuple[tuple[int, int], ...]
    sensor: NDArray[np.int64]
    maps: NDArray[np.float64]
    shape: tuple[int, int]

    @property
    def exact_times(self) -> bool:
        """Whether it matters when exactly each frame was taken: the sensors take turns."""
        return True

    @property
    def half_width(self) -> int:
        """Pixels from the centre to the edge of the largest stamp."""
        return max(psf.half_width for psf in self.psfs)

    def slice(self, frames: Frames) -> MultiSensor:
        """Return the model of some of the frames."""
        return replace(self, sensor=self.sensor[frames], maps=self.maps[frames])

    def plane_shape(self, frame_shape: tuple[int, int]) -> tuple[int, int]:
        """Return the size (H, W) of the plane."""
        return self.shape

    def frame_shape(self, plane_shape: tuple[int, int]) -> tuple[int, int]:
        """Return the size (H, W) that frames are padded to."""
        return max(h for h, _ in self.shapes), max(w for _, w in self.shapes)

    @cached_property
    def key(self) -> str:
        """Text that differs between views that differ."""
        digest = hashlib.sha256(np.round(self.maps, 6).tobytes())
        digest.update(np.asarray(self.sensor, np.int64).tobytes())
        psfs = ', '.join(psf.key for psf in self.psfs)
        return f'PlaneView({psfs}, {self.shapes}, {self.shape}, {digest.hexdigest()})'

    @property
    def gaussian_sigma_px(self) -> float | None:
        """Standard deviation of Gaussian PSFs that are the same for all sensors, else None."""
        sigmas = {psf.gaussian_sigma_px for psf in self.psfs}
        return sigmas.pop() if len(sigmas) == 1 else None

    @property
    def is_one_gaussian(self) -> bool:
        """Several views of one."""
        return False

    @cached_property
    def _curvature(self) -> NDArray[np.float64]:
        """Curvature of the statistic on the plane, shape (places, T, 2)."""
        compiled = self.compiled(with_curvature=True)
        found = np.empty((N_PLACES**2, len(self.maps), 2))
        places = np.stack(np.meshgrid(*(np.linspace(0, size - 1, N_PLACES)
                                        for size in self.shape[::-1])), axis=-1)
        for place, out in zip(places.reshape(-1, 2), found, strict=True):
            curvatures(compiled, np.tile(place, (len(self.maps), 1)), out)
        return found

    @property
    def width_px(self) -> float:
        """Standard deviation, on the plane, of the sharpest PSF as a Gaussian."""
        return float(1 / math.sqrt(self._curvature.sum(axis=-1).max()))

    @property
    def oversampling(self) -> int:
        """Grid positions per pixel of the plane that the sharpest sensor asks for."""
        sigma = 1 / math.sqrt(2 * self._curvature.max())
        return int(np.clip(math.ceil(POSITIONS_PER_SIGMA / sigma - 1e-6), 1, MOST_PER_PX))

    def compiled(self, with_curvature: bool = False) -> CompiledMeasurement:
        """Return what compiled loops need; the curvature of the PSFs only for climbing."""
        optics = tuple(psf.optics(psf.curvature if with_curvature else None) for psf in self.psfs)
        return CompiledMeasurement(optics, np.asarray(self.sensor, np.int64),
                                   np.ascontiguousarray(self.maps))

    def limits(self, _: tuple[int, int]) -> NDArray[np.float64]:
        """Return the largest x and y of a position."""
        return np.array([self.shape[1] - 1.0, self.shape[0] - 1.0])

    def scores(self, graph: StateGraph, shape: tuple[int, int], amplitudes: AmplitudeModel,
               over_rows: OverRows) -> Scores:
        """Return the scores of all positions; see ``MeasurementModel``."""
        return MultiSensorScores(self, amplitudes, over_rows)

    def search_work(self, graph: StateGraph, is_complex: bool) -> SearchWork:
        """Return what a search of the paths of a graph has to compute."""
        pixels = np.array([(2 * psf.half_width + 1)**2 for psf in self.psfs])
        stamps = np.array([len(psf.coefficients) * psf.optics().nodes.size for psf in self.psfs])
        n_seen = np.bincount(self.sensor, minlength=len(self.psfs))
        return SearchWork(1, 0, 0, int(pixels.sum()), int((1 + is_complex) * pixels @ n_seen),
                          int(stamps @ n_seen), int((stamps * pixels) @ n_seen))

    def window(self, shape: tuple[int, int]) -> MultiSensor:
        """Return the view of a part (H, W) in the middle of the plane."""
        offset = [(self.shape[1] - shape[1]) // 2, (self.shape[0] - shape[0]) // 2]
        return replace(self, maps=self.maps @ geometry.translations(np.array([offset])),
                       shape=shape)

    def gaussian(self, width_px: float) -> MultiSensor:
        """Return the view of Gaussian targets that are wider than each PSF by the same factor.

        Parameters
        ----------
        width_px : float
            On the plane, of the sensor that is sharpest there.
        """
        factor = width_px / self.width_px
        return replace(self, psfs=tuple(psf.gaussian(factor * psf.width_px) for psf in self.psfs))
