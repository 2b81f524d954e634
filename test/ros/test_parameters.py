from pathlib import Path
import re

import pytest

pytest.importorskip('rclpy')

import yaml  # noqa: E402

from track_before_detect.errors import ParameterError  # noqa: E402
from track_before_detect.options import describe, DetectorOptions  # noqa: E402
from track_before_detect.ros import (  # noqa: E402
    detector_node,
    frame_publisher_node,
    parameter_files,
)
from track_before_detect.ros.parameters import (  # noqa: E402
    NodeParameter,
    option_parameters,
    option_values,
)
from track_before_detect.ros.recorder import recorder_node  # noqa: E402
from track_before_detect.ros.stitching import stitcher_node  # noqa: E402
from track_before_detect.tracking.presets import PRESETS  # noqa: E402

ROOT = Path(__file__).parents[2]


NODES = {'detector.param.yaml': detector_node.PARAMETERS,
         'frame_publisher.param.yaml': frame_publisher_node.PARAMETERS,
         'recorder.param.yaml': recorder_node.PARAMETERS,
         'stitcher.param.yaml': stitcher_node.PARAMETERS}


def parameters_in(text):
    return yaml.safe_load(text)['/**']['ros__parameters']


@pytest.mark.parametrize('name', NODES)
def test_parameter_files_list_exactly_the_parameters_with_their_defaults(name):
    text = (ROOT / 'config' / name).read_text()
    # An option that is given would keep its default where the preset chooses another value.
    assert parameters_in(text) == {
        parameter.name: parameter.default for parameter in NODES[name] if not parameter.is_option}
    assert parameters_in(re.sub(r'(?m)^    #(?=\w)', '    ', text)) == {
        parameter.name: parameter.default for parameter in NODES[name]}


@pytest.mark.parametrize('name', parameter_files.FILES)
def test_parameter_files_say_what_the_descriptors_say(name):
    # python -m track_before_detect.ros.parameter_files config writes them anew.
    assert (ROOT / 'config' / name).read_text() == parameter_files.FILES[name]


@pytest.mark.parametrize('preset', sorted(set(PRESETS) - {'none'}))
def test_every_preset_has_a_file_with_its_options(preset):
    text = (ROOT / 'config' / f'{preset}.yaml').read_text()
    assert parameters_in(text) == {'preset': preset, **PRESETS[preset]}


def test_defaults_of_the_parameters_are_the_defaults_of_the_options():
    parameters = option_parameters({})
    values = {parameter.name: parameter.default for parameter in parameters}
    assert DetectorOptions.from_mapping(option_values(parameters, values)) == DetectorOptions()


def test_every_option_is_a_live_parameter_with_its_unit_range_and_description():
    parameters = {parameter.name: parameter for parameter in detector_node.PARAMETERS}
    for option in describe():
        parameter = parameters[option['name']]
        descriptor = parameter.descriptor()
        assert parameter.live and not descriptor.read_only
        assert option['description'] in descriptor.description
        assert option['unit'] in descriptor.description
        if option['maximum'] is not None and option['kind'] == 'number':
            assert descriptor.floating_point_range[0].to_value == option['maximum']
        for choice in option['choices'] or ():
            assert choice in descriptor.additional_constraints


def test_every_default_lies_in_the_range_of_its_descriptor():
    for parameters in NODES.values():
        for parameter in parameters:
            assert parameter.check(parameter.default) == parameter.default
            descriptor = parameter.descriptor()
            for bounds in [*descriptor.floating_point_range, *descriptor.integer_range]:
                assert bounds.from_value <= parameter.default <= bounds.to_value


def test_a_whole_number_is_taken_where_a_number_is_expected():
    parameter = NodeParameter('rate', 0.0, 'Rate.', 'number', minimum=0.0)
    assert isinstance(parameter.check(3), float)
    psf = next(p for p in option_parameters({}) if p.name == 'psf_sigma_px')
    assert isinstance(psf.check(2), float)
    steps = next(p for p in option_parameters({}) if p.name == 'continuation')
    assert [type(item) for item in steps.check([1, 0])] == [float, float]


@pytest.mark.parametrize(('kind', 'bounds', 'value', 'sentence'), [
    ('number', {'minimum': 0.0}, -1.0, 'p must be at least 0 px, got -1'),
    ('number', {'maximum': 5.0}, 6.0, 'p must be at most 5 px, got 6'),
    ('number', {'above': 0.0}, 0.0, 'p must be above 0 px, got 0'),
    ('number', {}, 'x', "p must be a number, got 'x'"),
    ('number', {}, float('nan'), 'p must be a number, got nan'),
    ('number', {}, True, 'p must be a number, got True'),
    ('integer', {}, 1.5, 'p must be a whole number, got 1.5'),
    ('boolean', {}, 1, 'p must be true or false, got 1'),
    ('text', {}, 1, 'p must be text, got 1'),
    ('text', {'choices': ('a', 'b')}, 'c', "p must be one of a, b, got 'c'"),
])
def test_a_bad_value_is_refused_in_one_sentence(kind, bounds, value, sentence):
    parameter = NodeParameter('p', 0, 'P.', kind, unit='px', **bounds)
    with pytest.raises(ParameterError) as refused:
        parameter.check(value)
    assert str(refused.value) == sentence


