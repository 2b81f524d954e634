"""``tbd calibrate``: search noise for a threshold, and compare it with the model's."""

from argparse import Namespace
from typing import Any

from track_before_detect.checks import checked_number
from track_before_detect.cli.console import (
    add_set_argument,
    assignments,
    FOUND,
    Progress,
    table,
)
from track_before_detect.options import DetectorOptions, parse_option

HELP = 'search noise for a threshold'
DESCRIPTION = (
    'Search simulated noise for the threshold of a false alarm rate, and print it '
    'beside that of\nthe model of noise, where there is one for the options. What is found is '
    "kept in the\nuser's cache: later searches with these options go by it instead of the "
    'model.')
EXAMPLES = """\
examples:
  batches of 20 frames of 256 x 320 pixels at 25 frames a second:
    tbd calibrate 20 256 320 --fps 25
    tbd calibrate 20 256 320 --set amplitude_model=constant --set psf_sigma_px=1.5
"""


def add_arguments(parser: Any) -> None:
    """Add the arguments of the command."""
    for name, words in (('frames', 'frames of a batch'), ('height', 'of the frames, px'),
                        ('width', 'of the frames, px')):
        parser.add_argument(name, metavar=name.upper(), type=int, help=words)
    parser.add_argument('--fps', type=float, default=1.0, help='frames a second (default: 1)')
    add_set_argument(parser, 'set an option of the detector; see tbd detect --list-options')


def run(arguments: Namespace) -> int:
    """Search noise and print both thresholds; return the exit code."""
    for name in ('frames', 'height', 'width'):
        checked_number(name, getattr(arguments, name), above=0)
    checked_number('--fps', arguments.fps, above=0)
    options = DetectorOptions.from_mapping(
        {key: parse_option(key, text) for key, text in assignments(arguments.set).items()})
    # Compiled loops take a second to load; errors need not wait for them.
    import numpy as np

    from track_before_detect.tracking.searched_noise import search_noise

    with Progress.asked_for(arguments) as progress:
        found = search_noise(options, np.arange(arguments.frames) / arguments.fps,
                             (arguments.height, arguments.width), progress)
    rows: list[tuple[str, ...]] = [('amplitudes', 'false alarm rate', 'simulated', 'model',
                                    'rate at the simulated one by the model')]
    rows += [(one.amplitude_model, f'{one.rate:.3g}', f'{one.simulated:.3f}',
              *('none' if value is None else f'{value:.4g}'
                for value in (one.modelled, one.modelled_rate))) for one in found]
    print(table(rows))
    return FOUND
