"""``tbd config``: a file of options to start from."""

from argparse import Namespace
from typing import Any

from track_before_detect.cli.console import FOUND
from track_before_detect.option_tables import yaml_entry
from track_before_detect.options import describe

_HEADER = """\
# Options of tbd detect, each with its default: tbd detect INPUT --config FILE
#
# An option whose # is taken away keeps its value, be it the default; the preset chooses the
# others. What --set and --detector give wins over this file. null is automatic, or none.

# Where the options come from that are not given: auto looks at the first frames, none takes
# the defaults; eoir_static, eoir_moving, radar_range_doppler, radar_range_bearing and
# astronomy are for kinds of sensors.
preset: auto
"""
# What is worth telling first, because no frame tells it.
_FIRST = ('psf_sigma_px', 'max_speed_px_s', 'batch_length', 'false_alarm_rate')


HELP = 'print a file of options to start from'
DESCRIPTION = (
    'Print a YAML file with every option, its meaning, unit, range and default, '
    'for --config:\n  tbd config > options.yaml')
EXAMPLES = ''


def add_arguments(parser: Any) -> None:
    """Add nothing: it has no arguments."""


def run(arguments: Namespace) -> int:
    """Print the file; return the exit code."""
    options = {option['name']: option for option in describe()}
    print(_HEADER)
    for title, names in (('Start with these', _FIRST),
                         ('All others', (name for name in options if name not in _FIRST))):
        print(f'# ---- {title} ----\n')
        for name in names:
            print('\n'.join(yaml_entry(options[name], '', '#')) + '\n')
    return FOUND
