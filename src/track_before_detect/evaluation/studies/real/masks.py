"""Truth that is given as one image for each frame, not 0 where a target is."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.optimize import linear_sum_assignment

from track_before_detect.errors import DataError
from track_before_detect.evaluation.studies.real.truth import Truth
from track_before_detect.recordings.images import images_in, read_image

# Masks number no targets: one farther than this from where all known ones were last is new.
SAME_TARGET_PX = 20.0
_NEIGHBOURS = np.ones((3, 3))


def labels_of_masks(images: Path, masks: Path, shape: tuple[int, int]) -> Truth:
    """Return the truth in a folder of masks.

    Parameters
    ----------
    images, masks : path
        Folders; frame and mask have the same name but for its suffix. A frame without a mask is
        one of which nothing is known.
    shape : tuple of int
        Height and width of the frames.

    Returns
    -------
    Truth
        Each group of pixels that touch is a target.
    """
    frames = _images_in(images)
    by_stem = {file.stem: file for file in _images_in(masks)}
    known = np.array([file.stem in by_stem for file in frames])
    labels: list[list[float]] = []
    pixels: list[NDArray[np.float64]] = [np.zeros((0, 4))]
    last = np.zeros((0, 2))
    for frame in np.flatnonzero(known):
        file = by_stem[frames[frame].stem]
        mask = read_image(file)
        if mask.shape != shape:
            raise DataError(f'{file} must be {shape[0]} x {shape[1]} like its frame, got '
                            f'{mask.shape[0]} x {mask.shape[1]}')
        groups, count = ndimage.label(mask > 0, _NEIGHBOURS)
        places = [np.argwhere(groups == group + 1)[:, ::-1] for group in range(count)]
        centres = np.array([place.mean(axis=0) for place in places]).reshape(-1, 2)
        ids, last = _same_targets(centres, last)
        for identity, centre, place in zip(ids, centres, places, strict=True):
            size = place.max(axis=0) - place.min(axis=0) + 1
            labels.append([float(frame), identity, *centre, *size])
            pixels.append(np.column_stack([np.full(len(place), frame),
                                           np.full(len(place), identity), place]))
    return Truth.of_labels(np.array(labels).reshape(-1, 6), len(frames), known=known,
                           pixels=np.concatenate(pixels))


def _images_in(folder: Path) -> list[Path]:
    if not folder.is_dir():
        raise DataError(f'folder {folder} does not exist')
    return images_in(folder)


def _same_targets(centres: NDArray[np.float64], last: NDArray[np.float64],
                  ) -> tuple[list[int], NDArray[np.float64]]:
    """Return the number of each target, and where all that are numbered were last."""
    apart = np.linalg.norm(centres[:, None] - last[None], axis=2)
    taken = dict(zip(*linear_sum_assignment(apart), strict=True))
    last = last.copy()
    ids = []
    for k, centre in enumerate(centres):
        identity = taken.get(k)
        if identity is None or apart[k, identity] > SAME_TARGET_PX:
            identity = len(last)
            last = np.vstack([last, centre])
        last[identity] = centre
        ids.append(int(identity))
    return ids, last
