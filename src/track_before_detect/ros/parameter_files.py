"""Text of the files in ``config/``: every parameter with its meaning, unit, range and default.

``python -m track_before_detect.ros.parameter_files FOLDER`` writes them anew after a parameter
was added or changed.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
import sys
import textwrap
from typing import Any

from track_before_detect.options import range_words
from track_before_detect.ros import detector_node, frame_publisher_node
from track_before_detect.ros.parameters import NodeParameter

WIDTH = 95

DETECTOR_HEADER = """\
# Parameters of the node detector, each with its default.
#
# Live parameters may be changed while the node runs and take effect from the next batch on; the
# others are read once, at start. Not listed: use_sim_time, and the overrides of the quality of
# service of the inputs, such as
#   qos_overrides./image.subscription.reliability: reliable
# A parameter that the node does not know is an error.
"""
FRAME_PUBLISHER_HEADER = """\
# Parameters of the node frame_publisher, each with its default. All are read once, at start.
#
# Not listed: use_sim_time, and the overrides of the quality of service of the output, such as
#   qos_overrides./image.publisher.depth: 50
# A parameter that the node does not know is an error.
"""
FILES = {
    'detector.param.yaml': (DETECTOR_HEADER, detector_node.PARAMETERS),
    'frame_publisher.param.yaml': (FRAME_PUBLISHER_HEADER, frame_publisher_node.PARAMETERS),
}


def parameter_file(header: str, parameters: Iterable[NodeParameter]) -> str:
    """Return a YAML file of parameters, usable for a node of any name and namespace."""
    lines = [header + '/**:\n  ros__parameters:']
    for parameter in parameters:
        lines.append('')
        lines += textwrap.wrap(_explanation(parameter), WIDTH, initial_indent='    # ',
                               subsequent_indent='    # ')
        lines.append(f'    {parameter.name}: {_yaml(parameter.default)}')
    return '\n'.join(lines) + '\n'


def main(folder: str) -> None:
    """Write the files to a folder."""
    for name, (header, parameters) in FILES.items():
        Path(folder, name).write_text(parameter_file(header, parameters), encoding='utf-8')


def _explanation(parameter: NodeParameter) -> str:
    facts = [*([parameter.unit] if parameter.unit else []), *range_words(vars(parameter))]
    if parameter.optional:
        facts.append('empty is none' if parameter.kind == 'array' else '0 is automatic')
    if parameter.live:
        facts.append('live')
    return f'{parameter.description} [{"; ".join(facts)}]' if facts else parameter.description


def _yaml(value: Any) -> str:
    if isinstance(value, bool):
        return 'true' if value else 'false'
    if isinstance(value, str):
        return f"'{value}'"
    if isinstance(value, list):
        return f'[{", ".join(_yaml(item) for item in value)}]'
    return repr(value)


if __name__ == '__main__':
    main(sys.argv[1])
