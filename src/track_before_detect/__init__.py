"""Find dim moving targets in sequences of frames where no single frame shows them."""

from track_before_detect.detect import detect
from track_before_detect.errors import (
    DataError,
    MissingExtraError,
    ParameterError,
    TbdError,
)
from track_before_detect.options import DetectorOptions
from track_before_detect.types import DetectionResult, Step, Trajectory

__version__ = '0.1.0'

__all__ = [
    'DataError',
    'DetectionResult',
    'DetectorOptions',
    'MissingExtraError',
    'ParameterError',
    'Step',
    'TbdError',
    'Trajectory',
    'detect',
]
