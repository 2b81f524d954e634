"""Recordings searched by one process, by one worker and by two, one of which is killed.

Also a long one, and one of large frames in tiles.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time
from typing import Any

import numpy as np

from track_before_detect.errors import DataError
from track_before_detect.evaluation.benchmarks import tiles
from track_before_detect.evaluation.benchmarks.bench import Bench
from track_before_detect.evaluation.benchmarks.workers.recordings import write_recordings
from track_before_detect.evaluation.engine.tables import aligned
from track_before_detect.evaluation.engine.timing import summary
from track_before_detect.runs.own_process import peak_memory
from track_before_detect.solvers.search.memory import BYTES_PER_GB

_PROGRAM = ('import sys; from track_before_detect.cli import main; '
            "sys.exit(main(['detect', *sys.argv[1:]]))")
# The threshold is given, for its calibration is not what is measured.
_OPTIONS = ('--preset', 'none', '--set', 'threshold=9', '--set', 'batch_length=20',
            '--no-overlay', '--formats', 'csv,json', '--quiet')
# Of grey levels; the large frames are noise of one.
_LEVELS = ('--set', 'background=spatial_median', '--set', 'noise=robust')


@dataclass(frozen=True)
class Run:
    """How a set of recordings is searched: without ``workers`` in the process itself."""

    name: str
    workers: int = 0
    killed: bool = False


ALONE, ONE, TWO = Run('one process'), Run('1 worker', 1), Run('2 workers', 2)
RUNS = (ALONE, ONE, TWO, Run('2 workers, one killed', 2, True))


@dataclass(frozen=True)
class Case:
    """Square recordings; a single one is shared out in parts, a batch of large frames in tiles."""

    n_recordings: int
    n_frames: int
    side_px: int
    tile_px: int | None = None

    def measure(self, repeats: int) -> dict[str, Any]:
        """Measure it, each time by new processes; the runs take turns."""
        with tempfile.TemporaryDirectory() as folder:
            inputs = Path(folder) / 'recordings'
            inputs.mkdir()
            options: tuple[str, ...] = _LEVELS
            if self.tile_px is None:
                paths = write_recordings(inputs, self.n_recordings, self.n_frames, self.side_px)
            else:
                paths = [inputs / 'tiles.npy']
                np.save(paths[0], tiles.scene(tiles.Case(self.side_px, self.tile_px))[0])
                options = ('--set', f'tile_px={self.tile_px}')
            seconds: dict[Run, list[tuple[float, float]]] = {run: [] for run in RUNS}
            peaks: dict[Run, int] = dict.fromkeys(RUNS, 0)
            found = {}
            for repeat in range(repeats):
                for run in RUNS:
                    output = Path(folder) / f'{repeat} {run.name}'
                    wall_s, cpu_s, peak = search(paths, output, run, options)
                    seconds[run].append((wall_s, cpu_s))
                    peaks[run] = max(peaks[run], peak)
                    found[run] = results_in(output)
        n_same = {run: sum(found[run].get(name) == text for name, text in found[ALONE].items())
                  for run in RUNS}
        return {**asdict(self), 'formats': sorted({path.suffix for path in paths}),
                'n_results': len(found[ALONE]), 'runs': {
                    run.name: {**summary(np.array(seconds[run])), 'n_same': n_same[run],
                               'peak_memory_bytes': peaks[run],
                               'speed_up': min(wall for wall, _ in seconds[ONE])
                               / min(wall for wall, _ in seconds[run])} for run in RUNS}}


def search(paths: Sequence[Path], output: Path, run: Run,
           options: Sequence[str] = _LEVELS) -> tuple[float, float, int]:
    """Search recordings by the command.

    Returns
    -------
    float, float
        Wall seconds, and CPU seconds of all processes.
    int
        Bytes that the largest process took.
    """
    workers = ['--scheduler', 'local', '--jobs', str(run.workers)] if run.workers else []
    began = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, '-c', _PROGRAM, *map(str, paths), '--output', str(output), *_OPTIONS,
         *options, *workers], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    if run.killed:
        _kill_a_worker(process, output / 'finished.jsonl', max(1, len(paths) // 4))
    assert process.stderr is not None
    said = process.stderr.read()
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    process.stderr.close()
    # Something was found, or nothing.
    if process.returncode not in (0, 3):
        raise DataError(f'the search by {run.name} ended with {process.returncode}: {said}')
    return time.perf_counter() - began, used.ru_utime + used.ru_stime, peak_memory(used)


def results_in(output: Path) -> dict[str, bytes]:
    """Return the trajectories of each recording in a folder of results, as they are written."""
    return {str(file.relative_to(output)): file.read_bytes()
            for file in output.rglob('trajectories.*')}


def _kill_a_worker(process: subprocess.Popen, finished: Path, n_finished: int) -> None:
    """Kill a worker of a command as soon as so much is finished."""
    import psutil
    while process.poll() is None:
        lines = finished.read_bytes().splitlines() if finished.exists() else []
        if sum(map(bool, lines)) >= n_finished:
            workers = [child for child in psutil.Process(process.pid).children()
                       if any('spawn_main' in word for word in child.cmdline())]
            if workers:
                workers[0].kill()
                return
        time.sleep(0.02)
    raise DataError('the search ended before one of its workers could be killed')


def cases(large: bool) -> dict[str, Sequence[Case]]:
    """Return what ``tbd bench workers`` measures."""
    n_frames = tiles.N_FRAMES
    return {'cases': (
        [Case(40, 200, 128), Case(1, 2000, 128), Case(1, n_frames, 2048, 512)] if large else
        [Case(40, 60, 64), Case(1, 400, 64), Case(1, n_frames, 512, 256)])}


def _lines(measured: Mapping[str, Any]) -> list[str]:
    rows: list[tuple[str, ...]] = [
        ('recordings', 'searched by', 'wall s', 'CPU s', 'peak GB', 'same results', 'speed-up')]
    for case in measured['cases']:
        size = f'{case["n_recordings"]} of {case["n_frames"]} x {case["side_px"]}²'
        size += f' in tiles of {case["tile_px"]}' * (case['tile_px'] is not None)
        for name, run in case['runs'].items():
            rows.append((
                size, name, *(f'{run[clock]["min"]:.1f}' for clock in ('wall_s', 'cpu_s')),
                f'{run["peak_memory_bytes"] / BYTES_PER_GB:.2f}',
                f'{run["n_same"]} of {case["n_results"]}', f'{run["speed_up"]:.2f}'))
    formats = {suffix or 'images' for case in measured['cases'] for suffix in case['formats']}
    return [*aligned(rows), '',
            f'Least of {measured["repeats"]}; speed-up of the wall clock beside 1 worker; '
            'peak of the largest process.',
            f'Formats: {", ".join(sorted(formats))}. Same: files, to the last byte.']


BENCH = Bench('workers', cases, _lines)
