"""``tbd warm-up``: compile the loops ahead, for all later commands and nodes."""

from argparse import Namespace
from collections.abc import Mapping
import time
from typing import Any

from track_before_detect.cli.console import FOUND, Progress
from track_before_detect.errors import named
from track_before_detect.options import DetectorOptions, DETECTORS
from track_before_detect.parallel import map_in_threads

HELP = 'compile the loops ahead'
DESCRIPTION = (
    'Compile the loops of a search now, which otherwise the first search does. '
    "They are kept\nfor all installations of this version, in the user's cache or in "
    'NUMBA_CACHE_DIR, until the\nsources, numba or numpy change.')
EXAMPLES = """\
examples:
  what tbd detect and the node need without options, of frames that are not complex:
    tbd warm-up
  every detector, amplitude, presence and sensor:
    tbd warm-up everything
"""
# Searches that together need what options may ask for beside the default.
_MORE: tuple[Mapping[str, Any], ...] = (
    {'presence': 'partial'}, {'exposure_s': 0.5}, {'amplitudes': 'complex'},
    {'amplitudes': 'complex', 'amplitude_model': 'constant'},
    {'amplitude_model': 'constant'}, *({'detector': name} for name in DETECTORS[1:]))


def add_arguments(parser: Any) -> None:
    """Add the arguments of the command."""
    parser.add_argument('what', metavar='WHAT', nargs='?', default='default',
                        help='default (default), everything, or the name of a detector')


def run(arguments: Namespace) -> int:
    """Compile and say what took how long; return the exit code."""
    searches = named('set of loops', arguments.what, {
        'default': (), 'everything': _MORE,
        **{name: ({'detector': name},) for name in DETECTORS}})
    # Compiled loops take a second to load; errors need not wait for them.
    from track_before_detect.tracking.compilation import LABEL, told_of_compiling
    from track_before_detect.tracking.pipeline import TrackingPipeline
    from track_before_detect.tracking.presets import PRESETS

    if arguments.what in ('default', 'everything'):
        # What frames of noise, where targets may be fast, and of a scene ask for; one that moves
        # needs more than one at rest.
        searches = ({'max_speed_px_s': 5.0}, PRESETS['eoir_moving'], *searches)
    options = [DetectorOptions(**search) for search in searches]
    started = time.perf_counter()
    with Progress.asked_for(arguments, every=True) as progress:

        def compile_all(options: list[DetectorOptions]) -> None:
            progress(LABEL, 0.0)
            with told_of_compiling(progress, *options):
                for one in options:
                    TrackingPipeline(one).compile()
            progress(LABEL, 1.0)

        # In a thread of its own, which an interrupt does not wait for.
        map_in_threads(compile_all, [options], progress.show_time)
    print(f'ready in {time.perf_counter() - started:.1f} s')
    return FOUND
