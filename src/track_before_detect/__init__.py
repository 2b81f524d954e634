"""Find dim moving targets in sequences of frames where no single frame shows them."""

from importlib import import_module
from typing import Any, TYPE_CHECKING

from track_before_detect.errors import (
    DataError,
    MissingExtraError,
    ParameterError,
    TbdError,
)

if TYPE_CHECKING:
    from track_before_detect.detection import detect, detect_sensors, Sensor
    from track_before_detect.models.measurement.psf import ArrayPsf, GaussianPsf
    from track_before_detect.options import DetectorOptions
    from track_before_detect.solvers.given_paths.fit_paths import fit_paths, FittedPaths
    from track_before_detect.types import DetectionResult, Step, Trajectory

__version__ = '0.1.0'

__all__ = [
    'ArrayPsf',
    'DataError',
    'DetectionResult',
    'DetectorOptions',
    'FittedPaths',
    'GaussianPsf',
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

# Imported when they are first asked for: loading the compiler takes a second, and what runs before
# cannot be interrupted cleanly.
_HOMES = {
    'ArrayPsf': 'models.measurement.psf',
    'DetectionResult': 'types',
    'DetectorOptions': 'options',
    'FittedPaths': 'solvers.given_paths.fit_paths',
    'GaussianPsf': 'models.measurement.psf',
    'Sensor': 'detection',
    'Step': 'types',
    'Trajectory': 'types',
    'detect': 'detection',
    'detect_sensors': 'detection',
    'fit_paths': 'solvers.given_paths.fit_paths',
}


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(f'{__name__}.{_HOMES[name]}'), name)
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
