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
    from track_before_detect.detection import detect, detect_sensors, Sensor
    from track_before_detect.solvers.given_paths.fit_paths import fit_paths, FittedPaths

__version__ = '0.1.0'

__all__ = [
    'DataError',
    'DetectionResult',
    'DetectorOptions',
    'FittedPaths',
    'MissingExtraError',
    'ParameterError',
    'Sensor',
    'Step',
    'TbdError',
    'Trajectory',
    'detect',
    'detect_sensors',
    'fit_paths',
]


def __getattr__(name: str) -> Any:
    """Import the solvers when they are first asked for: loading the compiler takes a second."""
    if name in ('detect', 'detect_sensors', 'Sensor'):
        from track_before_detect import detection
        return getattr(detection, name)
    if name in ('fit_paths', 'FittedPaths'):
        from track_before_detect.solvers.given_paths import fit_paths
        return getattr(fit_paths, name)
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
