"""Text of the files in ``config/``: every parameter with its meaning, unit, range and default.

``python -m track_before_detect.ros.parameter_files FOLDER`` writes them anew after a parameter
was added or changed.
"""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
import sys

from track_before_detect.option_tables import yaml_entry
from track_before_detect.ros import detector_node, frame_publisher_node
from track_before_detect.ros.parameters import NodeParameter
from track_before_detect.ros.recorder import recorder_node
from track_before_detect.ros.stitching import stitcher_node
from track_before_detect.tracking.presets import NONE, PRESETS

DETECTOR_HEADER = """\
# Parameters of the node detector, each with its default.
#
# The options of the detector are commented out, so that the preset chooses them; one whose # is
# taken away keeps its value, be it the default. Live parameters may be changed while the node runs
# and take effect from the next batch on; the others are read once, at start. Not listed:
# use_sim_time, and the overrides of the quality of service of the inputs, such as
#   qos_overrides./image.subscription.reliability: reliable
# A parameter that the node does not know is an error.
"""
FRAME_PUBLISHER_HEADER = """\
# Parameters of the node frame_publisher, each with its default. Live parameters may be changed
# while it plays; the others are read once, at start.
#
# Not listed: use_sim_time, and the overrides of the quality of service of the output, such as
#   qos_overrides./image.publisher.depth: 50
# A parameter that the node does not know is an error.
"""
RECORDER_HEADER = """\
# Parameters of the node recorder, each with its default. All are read once, at start.
#
# Not listed: use_sim_time. A parameter that the node does not know is an error.
"""
STITCHER_HEADER = """\
# Parameters of the node stitcher, each with its default. All are read once, at start.
#
# Not listed: use_sim_time. A parameter that the node does not know is an error.
"""
PRESET_HEADER = """\
# Options for a kind of sensor, the preset {}: a file of parameters for the node
# detector (--params-file, or params_file of the launch file) and for tbd detect --config.
#
# What is changed or added here wins over the preset{}
"""
NEEDS = {
    'radar_range_doppler': ';\n# range_bins_per_doppler_bin has to be added, see config/'
                           'detector.param.yaml.'}


def parameter_file(header: str, parameters: Iterable[NodeParameter],
                   open_to_preset: bool = False) -> str:
    """Return a YAML file of parameters, usable for a node of any name and namespace.

    Parameters
    ----------
    header : str
        Comment at the top.
    parameters : iterable of NodeParameter
        Written with their defaults.
    open_to_preset : bool
        Whether options of the detector are commented out.
    """
    lines = [header + '/**:\n  ros__parameters:']
    for parameter in parameters:
        mark = '#' if open_to_preset and parameter.is_option else ''
        lines += ['', *yaml_entry(vars(parameter), '    ', mark, _facts(parameter))]
    return '\n'.join(lines) + '\n'


def _preset_file(name: str) -> str:
    """Return the file of a preset: its options, and its name for those that are taken out."""
    values = {'preset': name, **PRESETS[name]}
    return parameter_file(PRESET_HEADER.format(name, NEEDS.get(name, '.')), [
        replace(parameter, default=values[parameter.name])
        for parameter in detector_node.PARAMETERS if parameter.name in values])


def _facts(parameter: NodeParameter) -> list[str]:
    facts = []
    if parameter.optional:
        facts.append('empty is none' if parameter.kind == 'array' else '0 is automatic')
    if parameter.live:
        facts.append('live')
    return facts


FILES = {
    'detector.param.yaml': parameter_file(DETECTOR_HEADER, detector_node.PARAMETERS, True),
    'frame_publisher.param.yaml': parameter_file(
        FRAME_PUBLISHER_HEADER, frame_publisher_node.PARAMETERS),
    'recorder.param.yaml': parameter_file(RECORDER_HEADER, recorder_node.PARAMETERS),
    'stitcher.param.yaml': parameter_file(STITCHER_HEADER, stitcher_node.PARAMETERS),
    **{f'{name}.yaml': _preset_file(name) for name in PRESETS if name != NONE},
}


def main(folder: str) -> None:
    """Write the files to a folder."""
    for name, text in FILES.items():
        Path(folder, name).write_text(text, encoding='utf-8')


if __name__ == '__main__':
    main(sys.argv[1])
