"""A part of a wide stream, which one of several detectors searches."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from numpy.typing import NDArray

from track_before_detect.errors import DataError, ParameterError
from track_before_detect.ros.parameters import NodeParameter
from track_before_detect.ros.search_results import StreamResult

REGION = NodeParameter(
    'region', [], 'The part of the frames that is searched: column and row of its first pixel, '
    'width and height. What is found is told in pixels of the whole frames. Empty is all.',
    'numbers', unit='px')


class Region:
    """Cuts frames, and tells of what is found where it is in the whole ones.

    Parameters
    ----------
    x, y : int
        Column and row of its first pixel.
    width, height : int
        Its size.

    Attributes
    ----------
    frame_shape : tuple of int
        (H, W) of the newest frame that was cut.
    """

    def __init__(self, x: int, y: int, width: int, height: int) -> None:
        self._origin = x, y
        self.shape = height, width
        self.frame_shape = (0, 0)

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Region | None:
        """Return the region that the parameters of a node tell of, None where it is all.

        Raises
        ------
        ParameterError
            It is none, lies beyond frames of the size that is told, or cannot be cut out.
        """
        numbers = values['region']
        if not numbers:
            return None
        if (len(numbers) != 4 or any(number % 1 for number in numbers) or min(numbers[:2]) < 0
                or min(numbers[2:]) < 1):
            raise ParameterError('region must be column, row, width and height in whole pixels, '
                                 'the first two from 0 and the others from 1, got '
                                 f'{_words(numbers)}')
        for name in ('sensors', 'doppler_ambiguities', 'doppler_m_s_per_column'):
            if values[name]:
                raise ParameterError(f'region ({_words(numbers)}) is of the pictures of one '
                                     f'sensor, got it beside {name}={values[name]}')
        region = cls(*map(int, numbers))
        told = (values['frame_height'], values['frame_width'])
        if min(told) > 0 and not region.lies_in(told):
            raise ParameterError(region.beyond(told))
        return region

    def __str__(self) -> str:
        height, width = self.shape
        return _words((*self._origin, width, height))

    def lies_in(self, shape: tuple[int, int]) -> bool:
        """Return whether frames (H, W) hold all of it."""
        (x, y), (height, width) = self._origin, self.shape
        return y + height <= shape[0] and x + width <= shape[1]

    def beyond(self, shape: tuple[int, int]) -> str:
        """Return the sentence that says that frames (H, W) do not."""
        (x, y), (height, width) = self._origin, self.shape
        return (f'region ({self}: columns {x} to {x + width - 1}, rows {y} to {y + height - 1}) '
                f'must lie within the frames, found frames of {shape[1]} x {shape[0]} '
                '(width x height)')

    def cut(self, pixels: NDArray) -> NDArray:
        """Return its pixels of a frame (H, W), which raises DataError where it ends before."""
        shape = (pixels.shape[0], pixels.shape[1])
        if not self.lies_in(shape):
            raise DataError(self.beyond(shape))
        self.frame_shape = shape
        (x, y), (height, width) = self._origin, self.shape
        # A copy, so that the rest of the frame is not kept while this waits.
        return pixels[y:y + height, x:x + width].copy()

    def in_whole(self, result: StreamResult) -> StreamResult:
        """Return a result with positions in the whole frames."""
        return replace(result, detection=replace(result.detection, trajectories=[
            replace(one, positions=one.positions + self._origin)
            for one in result.detection.trajectories]))


def _words(numbers: Any) -> str:
    return ' '.join(f'{number:g}' for number in numbers)
