"""Trajectories as boxes around targets, for tools that evaluate detectors and trackers.

A target has no outline; its box reaches two standard deviations of the point spread function to
each side. Pixel centres are whole numbers here. Both formats count from the corner of the first
pixel instead, which lies at (0, 0) in COCO and at (1, 1) in MOTChallenge, where frames count from
one as well.
"""

from collections.abc import Iterator
import json
from pathlib import Path
from typing import Any

from track_before_detect.recordings.result_files import presences
from track_before_detect.results.found import Found

SIDE_PER_SIGMA = 4.0


def write_mot(path: Path, found: Found) -> None:
    """Write lines of frame, id, left, top, width, height, confidence, -1, -1, -1 (no world)."""
    rows = sorted((frame + 1, number, x + 1, y + 1, side, score)
                  for frame, number, x, y, side, score in _boxes(found))
    path.write_text(''.join(
        f'{frame},{number},{left:.3f},{top:.3f},{side:.3f},{side:.3f},{score:.6g},-1,-1,-1\n'
        for frame, number, left, top, side, score in rows), encoding='utf-8')


def write_coco(path: Path, found: Found) -> None:
    """Write a list of detections as the COCO tools load it, with the number of the trajectory."""
    detections: list[dict[str, Any]] = [
        {'image_id': frame, 'category_id': 1, 'track_id': number, 'score': round(score, 6),
         'bbox': [round(value, 3) for value in (left, top, side, side)]}
        for frame, number, left, top, side, score in sorted(_boxes(found))]
    path.write_text(json.dumps(detections) + '\n', encoding='utf-8')


def _boxes(found: Found) -> Iterator[tuple[int, int, float, float, float, float]]:
    """Yield frame, id, left, top, side and score from the corner of the frame, all from zero.

    The score is the statistic over the threshold, which recordings can be ranked by together.
    """
    # Compiled loops take a second to load, which most commands need not wait for.
    from track_before_detect.option_models import psf_of

    side = SIDE_PER_SIGMA * psf_of(found.options).width_px
    for trajectory, k in presences(found.result.trajectories):
        x, y = (float(value) + 0.5 - side / 2 for value in trajectory.positions[k])
        yield (int(trajectory.frame_indices[k]), trajectory.id, x, y, side,
               trajectory.statistic / found.result.threshold)
