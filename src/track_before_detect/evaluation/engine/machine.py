"""The machine a measurement was made on, without its name."""

import os
from pathlib import Path
import platform

import numba
import numpy as np
import scipy

from track_before_detect import __version__
from track_before_detect.parallel import usable_cores


def describe_machine() -> dict[str, str | int]:
    """Return processor, cores and versions."""
    return {
        'processor': _processor(),
        'architecture': platform.machine(),
        'cores': os.cpu_count() or 1,
        'usable_cores': usable_cores(),
        'system': platform.system(),
        'python': platform.python_version(),
        'numpy': np.__version__,
        'scipy': scipy.__version__,
        'numba': numba.__version__,
        'track_before_detect': __version__,
    }


def machine_line() -> str:
    """Return the machine in one line."""
    machine = describe_machine()
    return (f'{machine["processor"]}, {machine["usable_cores"]} of {machine["cores"]} cores '
            f'usable, Python {machine["python"]}, numpy {machine["numpy"]}, scipy '
            f'{machine["scipy"]}, numba {machine["numba"]}, track_before_detect '
            f'{machine["track_before_detect"]}')


def _processor() -> str:
    """Return the processor's name where the system tells, else its architecture."""
    try:
        for line in Path('/proc/cpuinfo').read_text(encoding='utf-8').splitlines():
            key, _, value = line.partition(':')
            if key.strip() == 'model name':
                return value.strip()
    except OSError:
        pass
    return platform.processor() or platform.machine() or 'unknown processor'
