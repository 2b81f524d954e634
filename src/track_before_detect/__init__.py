"""Find dim moving targets in sequences of frames where no single frame shows them."""

from typing import Any, TYPE_CHECKING

from track_before_detect.errors import (
    DataError,
    MissingExtraError,
    ParameterError,
    TbdError,
)
from track_before_detect.options import DetectorOptions
from track_before_detect.types import DetectionResult, Step, Trajectory

if TYPE_CHECKING:
    from track_before_detect.detection import detect

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


def __getattr__(name: str) -> Any:
    """Import the detection when it is first asked for: loading the compiler takes a second."""
    if name == 'detect':
        from track_before_detect.detection import detect
        return detect
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
