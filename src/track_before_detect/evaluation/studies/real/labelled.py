"""Recordings with known targets, in the layouts in which they are published."""

from collections.abc import Callable
import csv
import functools
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import DataError
from track_before_detect.evaluation.studies.real.masks import labels_of_masks
from track_before_detect.evaluation.studies.real.truth import Truth
from track_before_detect.evaluation.studies.real.unlabelled import OTHERS
from track_before_detect.recordings.open_recording import open_recording
from track_before_detect.recordings.read_errors import closed_on_error
from track_before_detect.recordings.recording import Recording
from track_before_detect.recordings.video import VIDEO_SUFFIXES

BOX_COLUMNS = ('frame', 'id', 'x_px', 'y_px', 'width_px', 'height_px')
# Test sequences of NUDT-MIRSDT whose targets have an SNR of at most 3, by its authors.
_NUDT_DIM = (47, 56, 59, 76, 92, 101, 105, 119)


class LabelledRecording(NamedTuple):
    """A recording whose targets are known.

    Attributes
    ----------
    recording : Recording
        Its frames; to be closed.
    truth : Truth
        Its targets.
    """

    recording: Recording
    truth: Truth


class Source(NamedTuple):
    """Where a recording with truth is.

    Attributes
    ----------
    group : str
        What it is averaged with.
    path : path
        File or folder of its frames.
    open : callable
        Opens it.
    """

    group: str
    path: Path
    open: Callable[[], LabelledRecording]


def find_recordings(folder: Path) -> dict[str, Source]:
    """Return the recordings with truth in a folder and its subfolders, by name.

    Parameters
    ----------
    folder : path
        Holds archives (``NAME.npz`` with ``frames`` and ``truth``), videos with a table of boxes
        (``NAME.mp4`` and ``NAME.csv`` with the columns :data:`BOX_COLUMNS`), or is NUDT-MIRSDT or
        IRSatVideo, of which the test sequences count.

    Raises
    ------
    DataError
        When there are none.
    """
    if not folder.is_dir():
        raise DataError(f'{folder} is no folder')
    found: dict[str, Source] = {}
    for place in (folder, *sorted(path for path in folder.iterdir() if path.is_dir())):
        if (place / 'video_idx').is_dir():
            found |= _irsatvideo(place)
        elif (place / 'test.txt').is_file():
            found |= _nudt_mirsdt(place)
        else:
            found |= _files(place)
    if not found:
        raise DataError(
            f'{folder} holds no recording with truth: no .npz with truth, no video with a .csv '
            'of boxes, and not the layout of NUDT-MIRSDT or IRSatVideo')
    return found


def _files(place: Path) -> dict[str, Source]:
    found = {}
    for file in sorted(place.iterdir()):
        if file.suffix == '.npz' and _has_truth(file):
            found[file.stem] = Source(
                'archives', file, functools.partial(_open_with_points, file))
        elif file.suffix.lower() in VIDEO_SUFFIXES and file.with_suffix('.csv').exists():
            found[file.stem] = Source('videos', file, functools.partial(_open_with_boxes, file))
    return found


def _has_truth(file: Path) -> bool:
    with np.load(file) as archive:
        return 'truth' in archive and len(archive['truth']) > 0


def _open_with_points(file: Path) -> LabelledRecording:
    recording = open_recording(file)
    assert recording.truth is not None
    labels = np.column_stack([recording.truth, np.zeros((len(recording.truth), 2))])
    return _labelled(file.stem, recording, labels)


def _open_with_boxes(file: Path) -> LabelledRecording:
    labels = _read_boxes(file.with_suffix('.csv'))
    return _labelled(file.stem, open_recording(file), labels)


def _read_boxes(file: Path) -> NDArray[np.float64]:
    """Return the labels of a table, shape (N, 6), as :class:`Truth` holds them."""
    with open(file, newline='', encoding='utf-8') as lines:
        table = csv.reader(lines)
        header = tuple(next(table, ()))
        if header != BOX_COLUMNS:
            raise DataError(f'{file} must have the columns {", ".join(BOX_COLUMNS)}, found '
                            f'{", ".join(header) or "nothing"}')
        try:
            rows = [[float(cell) for cell in row] for row in table]
            return np.array(rows, float).reshape(len(rows), len(BOX_COLUMNS))
        except ValueError as error:
            raise DataError(f'{file} must hold six numbers in each row: {error}') from error


def _labelled(name: str, recording: Recording, labels: NDArray) -> LabelledRecording:
    """Return a recording with its labels, which must lie within its frames."""
    frames = labels[:, 0]
    if len(labels) and not (frames.min() >= 0 and frames.max() < len(recording)):
        recording.close()
        raise DataError(
            f'{name} has labels in frames {frames.min():g} to {frames.max():g}, but its frames '
            f'are 0 to {len(recording) - 1}')
    return LabelledRecording(recording, Truth.of_labels(
        labels, len(recording), others=OTHERS.get(name, ())))


def _nudt_mirsdt(root: Path) -> dict[str, Source]:
    """Return the test sequences of NUDT-MIRSDT: ROOT/SequenceN/{images,masks}/00001.png."""
    lines = (root / 'test.txt').read_text(encoding='utf-8').split()
    found = {}
    for name in dict.fromkeys(line.replace('\\', '/').split('/')[0] for line in lines):
        dim = name.removeprefix('Sequence') in map(str, _NUDT_DIM)
        found[name] = Source(
            f'{root.name}, SNR {"at most" if dim else "above"} 3', root / name / 'images',
            functools.partial(_open_with_masks, root / name / 'images', root / name / 'masks'))
    return found


def _irsatvideo(root: Path) -> dict[str, Source]:
    """Return the test sequences of IRSatVideo: ROOT/{images,masks}/NAME/0000.png."""
    groups = {}
    # The list of all of them comes before those of its parts, which say more.
    for file in sorted((root / 'video_idx').glob('test_*.txt'), key=lambda file: len(file.stem)):
        part = file.stem.removeprefix(f'test_{root.name}').lstrip('-')
        for name in file.read_text(encoding='utf-8').split():
            groups[name] = f'{root.name}, {part}' if part else root.name
    return {name: Source(
        group, root / 'images' / name, functools.partial(
            _open_with_masks, root / 'images' / name, root / 'masks' / name))
        for name, group in groups.items()}


def _open_with_masks(images: Path, masks: Path) -> LabelledRecording:
    recording = open_recording(images)
    with closed_on_error(recording):
        return LabelledRecording(recording, labels_of_masks(images, masks, recording.shape))
