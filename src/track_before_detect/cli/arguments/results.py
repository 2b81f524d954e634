"""What ``tbd detect`` writes, as its arguments say."""

from argparse import Namespace
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from track_before_detect.cli.console import require_extra
from track_before_detect.errors import ParameterError
from track_before_detect.results.film import check_film, FILMS
from track_before_detect.results.folder import Wanted
from track_before_detect.results.formats import FORMATS, formats_named


def add_result_arguments(parser: Any) -> None:
    """Add which files are written, and what goes to the standard output."""
    parser.add_argument('--formats', metavar='NAMES', default='csv',
                        help='files of trajectories beside trajectories.csv, separated by commas: '
                        + ', '.join(f'{name} ({one.file})' for name, one in FORMATS.items()))
    parser.add_argument('--json', metavar='-',
                        help='with -, print a line of JSON for each trajectory and nothing else '
                        'to the standard output; the table goes to that of errors')
    parser.add_argument('--video', metavar='NAME',
                        help='also make a film of the frames with the trajectories of the last '
                        'second, their ids and SNR: NAME.mp4 or NAME.gif in the folder of results')
    parser.add_argument('--no-overlay', action='store_true',
                        help='do not draw overlay.png (no matplotlib needed)')


def wanted_files(arguments: Namespace) -> Wanted:
    """Return the files that are asked for; refuse what could not be written."""
    if arguments.json not in (None, '-'):
        raise ParameterError(f'--json takes -, the standard output, got {arguments.json!r}; '
                             '--formats json writes a file')
    formats = formats_named(arguments.formats)
    for one in formats:
        if one.package:
            require_extra(one.package, one.extra, one.file)
    if arguments.video is not None:
        check_film(arguments.video)
        for package, extra in dict.fromkeys((FILMS['.gif'], FILMS[arguments.video[-4:]])):
            require_extra(package, extra, arguments.video)
    if not arguments.no_overlay:
        require_extra('matplotlib', 'plots', 'overlay.png', ', or give --no-overlay')
    return Wanted(formats, not arguments.no_overlay, arguments.video)


def check_inputs_stay(inputs: Iterable[Path], outputs: Iterable[Path],
                      names: Sequence[str]) -> None:
    """Refuse files of these names in folders of results that would take the place of an input."""
    kept = {path.resolve() for path in inputs}
    for file in (output / name for output in outputs for name in names):
        if file.resolve() in kept:
            raise ParameterError(f'{file} is an input, and a file of the result would replace it: '
                                 'give another name or another --output')
