"""``tbd simulate``: make a recording with known targets."""

from argparse import Namespace
import dataclasses
from pathlib import Path
from typing import Any

from track_before_detect.cli.console import (
    add_set_argument,
    assignments,
    check_output_file,
    FOUND,
    indented,
    option_lines,
    PrintAndExit,
)
from track_before_detect.recordings.npz import write_npz_recording
from track_before_detect.recordings.zarr_store import write_zarr_recording
from track_before_detect.simulation import scenarios
from track_before_detect.simulation.scenarios import Scenario, SCENARIOS

HELP = 'make a recording with known targets'
DESCRIPTION = (
    'Make a recording with known targets and write it with frames, stamps and '
    'truth rows\n[frame, id, x, y]: as .npz, or as Zarr (.zarr, a folder, or .zip), which may be '
    'larger than\nmemory.')
EXAMPLES = """\
examples:
  tbd simulate --list
  tbd simulate three_targets --seed 7 --output three.npz
  tbd simulate crossing --seed 7 --set snr=2.5 --set n_frames=40 --output crossing.npz
  one that is larger than memory:
    tbd simulate noise --set n_frames=600 --set height=4096 --set width=4096 --output sky.zarr
"""


def add_arguments(parser: Any) -> None:
    """Add the arguments of the command."""
    parser.add_argument('scenario', metavar='SCENARIO', help=f'one of: {", ".join(SCENARIOS)}')
    parser.add_argument('--seed', metavar='S', type=int, default=0,
                        help='the same seed gives the same recording (default: 0)')
    parser.add_argument('--output', metavar='FILE',
                        help='.npz, .zarr or .zip to write (default: SCENARIO.npz)')
    add_set_argument(parser, 'set one parameter of the scenario; may be repeated')
    parser.add_argument('--list', action=PrintAndExit, text=_listed,
                        help='list the scenarios and their parameters')


def run(arguments: Namespace) -> int:
    """Simulate and write the recording; return the exit code."""
    output = Path(arguments.output or f'{arguments.scenario}.npz')
    check_output_file(output, '.npz', '.zarr', '.zip')
    asked = arguments.scenario, arguments.seed
    parameters: dict[str, Any] = dict(assignments(arguments.set))
    if output.suffix == '.npz':
        made = scenarios.simulate(*asked, **parameters)
        write_npz_recording(output, made.frames, made.stamps, made.truth)
        scenario = made.scenario
    else:
        stream = scenarios.stream(*asked, **parameters)
        write_zarr_recording(output, stream.frames, stream.stamps, stream.truth)
        scenario = stream.scenario
    targets = f'{scenario.n_targets} target{"" if scenario.n_targets == 1 else "s"}'
    print(f'{output}: {scenario.n_frames} frames of {scenario.height} x {scenario.width} px at '
          f'{scenario.fps:g} Hz, {targets}')
    return FOUND


def _listed() -> str:
    """Return all scenarios and their parameters."""
    lines = ['Scenarios:']
    for name, scenario in SCENARIOS.items():
        lines.append(f'  {name}\n{indented(scenario.description)}')
        differences = _differences(scenario)
        if differences:
            lines.append(indented(differences))
    lines.append('\nParameters of every scenario (--set KEY=VALUE):')
    for field in dataclasses.fields(Scenario):
        if field.metadata:
            option = {'name': field.name, 'default': field.default, **field.metadata}
            lines.append(option_lines(option, ''))
    return '\n'.join(lines)


def _differences(scenario: Scenario) -> str:
    """Return what makes a scenario differ from the defaults of its parameters."""
    return ', '.join(f'{field.name}={getattr(scenario, field.name)}'
                     for field in dataclasses.fields(Scenario)
                     if field.metadata and getattr(scenario, field.name) != field.default)
