"""``tbd inspect``: a page of what the detector sees of a recording."""

from argparse import Namespace
from collections.abc import Mapping, Sequence
import dataclasses
from pathlib import Path
from typing import Any

from track_before_detect.atomic_files import atomic_folder
from track_before_detect.cli.console import (
    add_output_argument,
    check_apart,
    check_output_folder,
    FOUND,
    Progress,
    require_extra,
    trajectory_cells,
    trajectory_header,
)
from track_before_detect.cli.detect import (
    add_input_arguments,
    n_above,
    numbered,
    search,
    told_options,
)
from track_before_detect.errors import DataError
from track_before_detect.options import DetectorOptions
from track_before_detect.recordings.open_recording import expand_inputs, open_recording
from track_before_detect.types import Trajectory

HELP = 'show what the detector sees of a recording'
DESCRIPTION = (
    'Search a recording and show each step of it, with words for what looks '
    'wrong. Writes to DIR:\n'
    '  inspect.html  one page with everything in it, opens offline\n'
    '  inspect.png   its pictures')
EXAMPLES = ''


def add_arguments(parser: Any) -> None:
    """Add the arguments of the command."""
    add_input_arguments(parser)
    add_output_argument(parser)


def run(arguments: Namespace) -> int:
    """Search the recording, write the page and print what looks wrong; return the exit code."""
    told = told_options(arguments)
    output = Path(arguments.output)
    check_output_folder(output)
    require_extra('matplotlib', 'plots', 'tbd inspect')
    if len(paths := expand_inputs(arguments.inputs)) > 1:
        raise DataError(f'tbd inspect takes one input, got {len(paths)}')
    check_apart(paths, [output])
    with open_recording(paths[0], arguments.topic, arguments.fps) as recording:
        from track_before_detect.inspection.findings import findings
        from track_before_detect.inspection.observation import Observation
        from track_before_detect.inspection.page import page, pictures, sentences, table
        from track_before_detect.inspection.panels import panels, png
        from track_before_detect.option_models import psf_of

        observed = Observation(len(recording) // 2)
        result, _ = search(recording, arguments, told, observe=observed)
        observed.add_motion_of_the_scene()
        rejected = numbered(result)
        wrong = findings(observed, result, len(recording))
        drawn = panels(observed, result.trajectories, rejected,
                       psf_of(observed.options).width_px)
        images = []
        with Progress.asked_for(arguments) as progress:
            for done, panel in enumerate(drawn):
                progress('drawing', done / len(drawn))
                images.append((panel.name, panel.caption, png([panel], 1)))
        searched = observed.frames_searched()
        facts = observed.all_facts()
        no_data = sum(fact.no_data for fact in facts) / len(facts)
        counts = [
            ('frames', 'searched', 'repeated or left out', 'batches', 'pixels without data',
             'noise level', 'trajectories', 'candidates above the threshold rejected'),
            (str(len(recording)), str(searched), str(len(recording) - searched),
             str(result.n_batches), f'{100 * no_data:.1f} %',
             f'{facts[0].level:.3g}', str(len(result.trajectories)),
             str(n_above(result)))]
        known = recording.stamps_known
        text = page(f'tbd inspect {recording.name}', [
            ('What looks wrong', sentences(wrong, 'Nothing.', 'wrong')),
            ('In numbers', table(counts, '')),
            ('What the detector sees', pictures(images)),
            ('Trajectories', table(_rows(result.trajectories, result.threshold, known),
                                   'No trajectory found.')),
            ('Candidates that are no targets', table(
                _rows(rejected, result.threshold, known, True),
                'None (calibration=clutter looks for reasons).')),
            ('Remarks', sentences(result.remarks, 'None.')),
            ('Options', table(_option_rows(observed.options, told), '')),
        ])
        with atomic_folder(output) as aside:
            (aside / 'inspect.html').write_text(text, encoding='utf-8')
            (aside / 'inspect.png').write_bytes(png(drawn, 3))
    for sentence in wrong:
        print(f'- {sentence}')
    print(f'written: {output / "inspect.html"}, {output / "inspect.png"}')
    return FOUND


def _rows(trajectories: Sequence[Trajectory], threshold: float, stamps_known: bool,
          with_reason: bool = False) -> list[list[str]]:
    """Return a table of trajectories, the header first."""
    return [[*trajectory_header(stamps_known), 'statistic/threshold', *['reason'] * with_reason],
            *([*trajectory_cells(one), f'{one.statistic / threshold:.2f}',
               *[one.reason] * with_reason] for one in trajectories)]


def _option_rows(used: DetectorOptions, told: Mapping[str, Any]) -> list[list[str]]:
    """Return the options as a table, those that are not the default first."""
    default = DetectorOptions()
    rows = []
    for name in (field.name for field in dataclasses.fields(used)):
        value = getattr(used, name)
        origin = 'set' if name in told else 'chosen' if value != getattr(default, name) else ''
        rows.append([name, _shown(value), origin])
    return [['option', 'value', ''], *sorted(rows, key=lambda row: row[2] == '')]


def _shown(value: Any) -> str:
    if value is None:
        return 'automatic'
    return ', '.join(f'{one:g}' for one in value) if isinstance(value, tuple) else str(value)
