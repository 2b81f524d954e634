"""What lets a shell complete ``tbd``."""

import argparse
from typing import Any

from track_before_detect.cli.console import require_extra
from track_before_detect.options import DETECTORS
from track_before_detect.simulation.scenarios import SCENARIOS

SHELLS = ('bash', 'zsh', 'tcsh')
# By the name of the argument; where they are refused in words of our own, argparse has none.
_CHOICES = {'detector': DETECTORS, 'scenario': tuple(SCENARIOS)}


class PrintCompletion(argparse.Action):
    """Print the script for a shell and exit."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace,
                 values: Any, option_string: str | None = None) -> None:
        """Act on the argument."""
        require_extra('shtab', 'completion', '--print-completion')
        import shtab

        for action in _actions(parser):
            metavar = str(action.metavar or '')
            if action.dest in _CHOICES:
                action.choices = _CHOICES[action.dest]
            elif metavar.startswith(('FILE', 'INPUT')):
                action.complete = shtab.FILE
            elif metavar in ('DIR', 'FOLDER'):
                action.complete = shtab.DIRECTORY
        print(shtab.complete(parser, values))
        parser.exit()


def _actions(parser: argparse.ArgumentParser) -> list[Any]:
    """Return the arguments of a parser and of its commands."""
    actions: list[Any] = list(parser._actions)
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            actions += [one for inner in action.choices.values() for one in _actions(inner)]
    return actions
