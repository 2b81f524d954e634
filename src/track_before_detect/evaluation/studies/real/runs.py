"""Single runs of the suite ``real``: one method on one recording.

As a program it makes the run that it reads from its input, so that a run that has no end can be
ended.
"""

from collections.abc import Mapping
import dataclasses
import json
import math
from pathlib import Path
import subprocess
import sys
import time
from typing import Any

import numpy as np

from track_before_detect.errors import TbdError
from track_before_detect.evaluation.studies.real.added_noise import (
    contrasts,
    NoisyFrames,
    sigma_for,
)
from track_before_detect.evaluation.studies.real.labelled import (
    find_recordings,
    LabelledRecording,
)
from track_before_detect.evaluation.studies.real.measures import measure_tracks, RealMeasures
from track_before_detect.evaluation.studies.real.methods import options_of
from track_before_detect.evaluation.studies.real.peers.registry import peer_named
from track_before_detect.parallel import at_most_cores, usable_cores
from track_before_detect.tracking.pipeline import TrackingPipeline
from track_before_detect.tracking.recording import detect_recording, FrameSequence

# Of a run whose recording is dimmer as it is than it was to be made.
DIMMER = 'dimmer as it is'
NO_ANSWER = 'no answer in time'
# Peers have no batches; their false tracks are counted as if these were their lengths and hops.
PEER_BATCH, PEER_HOP = 20, 10
# What stands for the measures of a run that ended without trajectories, and of one not made.
_NAN = float('nan')
_NOTHING = RealMeasures(0, 0.0, 0.0, 0, _NAN, _NAN, _NAN, 0.0, _NAN, _NAN)
_NOT_MADE = RealMeasures(0, _NAN, _NAN, 0, _NAN, _NAN, _NAN, _NAN, _NAN, _NAN)


def measure(item: Mapping[str, Any]) -> dict[str, Any]:
    """Make one run in a process of its own, and end it after its time limit.

    Parameters
    ----------
    item : mapping
        As of :func:`search`, and ``time_limit_s``.

    Returns
    -------
    dict
        As of :func:`search`; its ``status`` says so when there was no answer.
    """
    try:
        done = subprocess.run(
            [sys.executable, '-m', __name__, str(usable_cores())], input=json.dumps(dict(item)),
            capture_output=True, text=True, timeout=item['time_limit_s'], check=False)
    except subprocess.TimeoutExpired:
        return _row(item, NO_ANSWER, _NOTHING)
    if done.returncode != 0:
        said = done.stderr.strip().splitlines() or [f'exit code {done.returncode}']
        return _row(item, f'failed: {said[-1]}', _NOTHING)
    return json.loads(done.stdout.splitlines()[-1])


def search(item: Mapping[str, Any]) -> dict[str, Any]:
    """Search one recording and measure what was found.

    Parameters
    ----------
    item : mapping
        ``data`` (folder), ``recording`` (name in it), ``method`` (name), ``options`` (of the
        method; None of a peer of that name), ``snr`` (to bring the recording to by noise, or
        None) and ``seed`` (of the noise).
    """
    labelled = find_recordings(Path(item['data']))[item['recording']].open()
    with labelled.recording as recording:
        frames: FrameSequence = recording
        sigma = 0.0
        if item['snr'] is not None:
            sigma = sigma_for(contrasts(labelled), item['snr'])
            if sigma == 0:
                return _row(item, DIMMER, _NOT_MADE)
            frames = NoisyFrames(recording, sigma, item['seed'])
        try:
            return _found(item, labelled, frames, sigma)
        except TbdError as error:
            return _row(item, f'refused: {error}', _NOTHING, sigma=sigma)


def _found(item: Mapping[str, Any], labelled: LabelledRecording, frames: FrameSequence,
           sigma: float) -> dict[str, Any]:
    """Search frames; what is compiled and calibrated only once is no part of the time."""
    recording = labelled.recording
    n_frames = len(recording)
    interval = float(np.median(np.diff(recording.stamps)))
    if item['options'] is None:
        find_tracks = peer_named(item['method'])
        started = time.perf_counter()
        tracks, status = find_tracks(frames), 'done'
        n_batches = 1 + max(0, math.ceil((n_frames - PEER_BATCH) / PEER_HOP))
    else:
        options = options_of(item['options'], frames)
        pipeline = TrackingPipeline(options)
        pipeline.warm_up(
            recording.shape, interval, min(options.batch_length or n_frames, n_frames))
        started = time.perf_counter()
        result = detect_recording(frames, options, pipeline=pipeline)
        tracks = [trajectory.positions for trajectory in result.trajectories]
        status, n_batches = result.status, result.n_batches
    seconds = time.perf_counter() - started
    measures = measure_tracks(tracks, labelled.truth, recording.shape, n_batches,
                              n_frames * interval if recording.stamps_known else _NAN)
    return _row(item, status, measures, sigma, n_frames, n_batches, seconds / n_frames)


def _row(item: Mapping[str, Any], status: str, measures: RealMeasures, sigma: float = _NAN,
         n_frames: int = 0, n_batches: int = 0, seconds_per_frame: float = _NAN,
         ) -> dict[str, Any]:
    """Return what goes into the table."""
    return {
        'recording': item['recording'], 'method': item['method'], 'snr': item['snr'],
        'seed': item['seed'], 'sigma': sigma, 'status': status, 'n_frames': n_frames,
        'n_batches': n_batches, **dataclasses.asdict(measures),
        'seconds_per_frame': seconds_per_frame}


if __name__ == '__main__':
    with at_most_cores(int(sys.argv[1])):
        print(json.dumps(search(json.load(sys.stdin))))
