"""``tbd doctor``: what is installed and in use, for whoever has to find out what is wrong."""

from argparse import Namespace
from collections.abc import Iterator, Mapping
import importlib
from importlib import metadata
import importlib.util
import json
import os
from pathlib import Path
import platform
import re
import subprocess
import sys
import tempfile
from typing import Any

from track_before_detect import __version__
from track_before_detect.cli.console import FAILED, FOUND
from track_before_detect.parallel import usable_cores

_PACKAGE = __name__.partition('.')[0]
_REQUIREMENT = re.compile(r'([\w.-]+)\s*(?:>=([\d.]+))?[^;]*(?:;.*extra\s*==\s*[\'"](\w+))?')
# Variables that change what happens; nobody keeps secrets in them.
_VARIABLES = re.compile(r'(ROS|RMW|FASTRTPS|FASTDDS|CYCLONEDDS|NUMBA|OMP|TBD)_|XDG_CACHE_HOME$')
_MESSAGES = ('sensor_msgs', 'nav_msgs', 'visualization_msgs', 'diagnostic_msgs', 'vision_msgs',
             'foxglove_msgs', 'radar_msgs')
# In another process, because a middleware that does not fit ends the one that loads it.
_MIDDLEWARE = 'import rclpy; print(rclpy.get_rmw_implementation_identifier())'
_PATIENCE_S = 30.0


HELP = 'say what is installed and in use, for reports of bugs'
DESCRIPTION = (
    'Say which versions, extras, cores, caches and which ROS are in use, and '
    'what is broken.\nExit code 0 unless something that is needed is broken, then 1.')
EXAMPLES = ''


def add_arguments(parser: Any) -> None:
    """Add the arguments of the command."""
    parser.add_argument('--json', action='store_true', help='print it as JSON')


def run(arguments: Namespace) -> int:
    """Print the report; return the exit code."""
    broken: list[str] = []
    report: dict[str, Mapping[str, Any]] = {
        'package': {_PACKAGE: __version__, 'python': platform.python_version(),
                    **_needed(broken), 'folder': str(Path(__file__).parents[1]),
                    'interpreter': sys.executable},
        'machine': _machine(),
        'caches': _caches(broken),
        'ROS': _ros(broken),
        'extras': _extras(),
        'environment': {name: value for name, value in sorted(os.environ.items())
                        if _VARIABLES.match(name)},
    }
    if arguments.json:
        print(json.dumps({**report, 'broken': broken}, indent=2))
    else:
        for title, facts in report.items():
            print('\n'.join([f'{title}:', *(f'  {name}: {_words(value)}'
                                            for name, value in facts.items())]))
        print('\n'.join(f'broken: {sentence}' for sentence in broken)
              or 'nothing that is needed is broken')
    return FAILED if broken else FOUND


def _words(value: Any) -> str:
    if isinstance(value, Mapping):
        return ', '.join(f'{name} {version or "missing"}' for name, version in value.items())
    if isinstance(value, bool):
        return 'yes' if value else 'no'
    return 'none' if value is None else str(value)


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _requirements() -> Iterator[tuple[str, str | None, str | None]]:
    """Yield the name, least version and extra of each package that ours asks for."""
    try:
        texts = metadata.requires(_PACKAGE) or []
    except metadata.PackageNotFoundError:
        texts = []
    for text in texts:
        if found := _REQUIREMENT.match(text):
            yield found[1], found[2], found[3]


def _needed(broken: list[str]) -> dict[str, str | None]:
    """Return the versions of what is needed, each imported, and numba tried."""
    versions = {}
    for package, least, _ in (one for one in _requirements() if one[2] is None):
        version = versions[package] = _version(package)
        if version is None or (least and _numbers(version) < _numbers(least)):
            broken.append(f'{package} must be {least or "there"} or newer, found {version}')
        try:
            importlib.import_module(package)
        except Exception as error:
            broken.append(f'{package} cannot be imported: {error}')
    try:
        from numba import njit
        if njit(lambda number: number + 1)(1) != 2:
            broken.append('numba compiles loops that compute what is wrong')
    except Exception as error:
        broken.append(f'numba cannot compile: {error}')
    return versions


def _numbers(version: str) -> list[int]:
    return [int(number) for number in re.findall(r'\d+', version)[:3]]


def _machine() -> dict[str, Any]:
    return {
        'system': platform.platform(),
        'cores': os.cpu_count(),
        'cores that may be used': usable_cores(),
        'memory [GB]': _gigabytes('SC_PHYS_PAGES'),
        'free memory [GB]': _gigabytes('SC_AVPHYS_PAGES'),
    }


def _gigabytes(pages: str) -> float | None:
    try:
        return round(os.sysconf(pages) * os.sysconf('SC_PAGE_SIZE') / 1e9, 1)
    except (AttributeError, OSError, ValueError):
        # The system does not tell.
        return None


def _caches(broken: list[str]) -> dict[str, Any]:
    """Return where compiled loops and thresholds are kept, and how much of them there is."""
    try:
        from track_before_detect.kernels.compiled_cache import cache_folder, user_cache_folder
        folders = {'loops': cache_folder(), 'thresholds': user_cache_folder()}
    except Exception as error:
        broken.append(f'no folder for compiled loops: {error}')
        return {}
    facts: dict[str, Any] = {}
    for name, folder in folders.items():
        files = [path.stat().st_size for path in folder.rglob('*' if name == 'loops' else '*.npy')
                 if path.is_file()]
        facts |= {name: str(folder), f'{name} can be written': _can_be_written(folder),
                  f'{name} [MB]': round(sum(files) / 1e6, 1)}
    return facts


def _can_be_written(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
        return True
    except OSError:
        return False


def _ros(broken: list[str]) -> dict[str, Any]:
    """Return which ROS there is, from where, and which middleware it uses."""
    found = importlib.util.find_spec('rclpy')
    if found is None or found.origin is None:
        return {'found': 'none', 'distribution': os.environ.get('ROS_DISTRO')}
    prefixes = [prefix for prefix in os.environ.get('AMENT_PREFIX_PATH', '').split(':') if prefix]
    sourced = any(Path(found.origin).is_relative_to(prefix) for prefix in prefixes)
    return {
        'found': 'sourced' if sourced else 'wheels',
        'distribution': os.environ.get('ROS_DISTRO'),
        'rclpy': _version('rclpy'),
        'middleware': _middleware(broken),
        'messages': {name: 'there' if importlib.util.find_spec(name) else None
                     for name in _MESSAGES},
    }


def _middleware(broken: list[str]) -> str | None:
    """Return what the middleware of ROS calls itself, if it answers."""
    try:
        asked = subprocess.run([sys.executable, '-c', _MIDDLEWARE], capture_output=True, text=True,
                               timeout=_PATIENCE_S)
    except subprocess.TimeoutExpired:
        broken.append('rclpy is there and cannot be used: its middleware did not answer within '
                      f'{_PATIENCE_S:g} s')
        return None
    if asked.returncode:
        reasons = re.findall(r'^\w+(?:Error|Exception): .*', asked.stderr, re.MULTILINE)
        reason = [f'exit code {asked.returncode}', *reasons][-1]
        broken.append(f'rclpy is there and cannot be used: {reason}')
    return asked.stdout.strip() or None


def _extras() -> dict[str, dict[str, str | None]]:
    """Return the packages of each extra with their versions."""
    extras: dict[str, dict[str, str | None]] = {}
    for package, _, extra in _requirements():
        if extra is not None:
            extras.setdefault(extra, {})[package] = _version(package)
    return extras
