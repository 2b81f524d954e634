"""The sensors that a node is told of: their parameters, and how each sees the common plane."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import re
from typing import Any

import numpy as np

from track_before_detect.array_option import array_option
from track_before_detect.errors import ParameterError
from track_before_detect.ros.parameters import NodeParameter
from track_before_detect.tracking.sensors import Sensor

IMAGE, FRAME = 'image', 'frame'
SENSORS = [
    NodeParameter(
        'sensors', [], 'Names of several sensors whose frames are searched together on a common '
        'plane; parameters sensors.NAME... say how each sees it. Empty is one sensor.', 'texts'),
    NodeParameter(
        'sensor_wait_s', 0.2, 'Longest time that a frame waits for those of other sensors, so '
        'that all go on in the order of their stamps; what comes later is left out.', 'number',
        unit='s', minimum=0.0),
]
# Of each sensor, behind sensors.NAME. and a dot.
OF_SENSOR = [
    NodeParameter('topic', '', 'Topic of its frames. Empty is NAME/image or NAME/frame.', 'text'),
    NodeParameter('message', IMAGE, 'Whether its frames come as images or as arrays.', 'text',
                  choices=(IMAGE, FRAME)),
    NodeParameter('height', 0, 'Height of its frames.', 'integer', unit='px', minimum=0),
    NodeParameter('width', 0, 'Width of its frames.', 'integer', unit='px', minimum=0),
    NodeParameter(
        'map', [], 'Two rows of three numbers that take (x, y, 1) in its pixels to x and y on the '
        'common plane. Empty makes its pixels the plane.', 'numbers'),
    NodeParameter(
        'psf_sigma_px', 0.0, 'Standard deviation of its Gaussian point spread function. 0 is that '
        'of the options.', 'number', unit='px', minimum=0.0),
    NodeParameter('psf', '', 'File of its point spread function instead, sides odd.', 'array'),
    NodeParameter('noise_sigma', 1.0, 'Standard deviation of the noise of a pixel.', 'number',
                  above=0.0),
    NodeParameter(
        'variance', '', 'File of the variance of the noise of each pixel in units of noise_sigma '
        'squared, (H, W).', 'array'),
    NodeParameter('mask', '', 'File of the pixels that hold no data, (H, W): those where it is '
                  'not 0.', 'array'),
]
NAME = re.compile('[A-Za-z][A-Za-z0-9_]*')


@dataclass(frozen=True)
class SensorInput:
    """One sensor.

    Attributes
    ----------
    name, topic : str
    message : {'image', 'frame'}
    shape : tuple of int
        (H, W) of its frames.
    view : Sensor
        How it sees the plane, without frames.
    """

    name: str
    topic: str
    message: str
    shape: tuple[int, int]
    view: Sensor


def parameters_of(names: Sequence[str]) -> list[NodeParameter]:
    """Return the parameters of sensors of these names.

    Raises
    ------
    ParameterError
        A name cannot be that of a topic, or stands twice.
    """
    for name in names:
        if not NAME.fullmatch(name) or list(names).count(name) > 1:
            raise ParameterError('sensors must be names of letters, digits and underscores, each '
                                 f'once, got {", ".join(map(repr, names))}')
    return [replace(one, name=f'sensors.{name}.{one.name}')
            for name in names for one in OF_SENSOR]


def sensor_inputs(values: Mapping[str, Any]) -> list[SensorInput]:
    """Return the sensors that the parameters of a node tell of, none where it has one alone."""
    return [_input(name, values) for name in values['sensors']]


def _input(name: str, values: Mapping[str, Any]) -> SensorInput:
    own = {one.name: values[f'sensors.{name}.{one.name}'] for one in OF_SENSOR}
    shape = (own['height'], own['width'])
    if min(shape) < 1:
        raise ParameterError(f'sensors.{name}.height and width must be told, got {shape[0]} and '
                             f'{shape[1]}')
    if len(own['map']) not in (0, 6):
        raise ParameterError(f'sensors.{name}.map must be 6 numbers or none, got '
                             f'{len(own["map"])}')
    arrays = {key: array_option(f'sensors.{name}.{key}', own[key]).array if own[key] else None
              for key in ('psf', 'variance', 'mask')}
    for key in ('variance', 'mask'):
        given = arrays[key]
        if given is not None and given.shape != shape:
            raise ParameterError(f'sensors.{name}.{key} must be {shape[0]} x {shape[1]} numbers, '
                                 f'got shape {given.shape}')
    affine = np.reshape(own['map'], (2, 3)) if own['map'] else None
    return SensorInput(
        name, own['topic'] or f'{name}/{own["message"]}', own['message'], shape,
        Sensor(np.empty((0, *shape)), (), affine, own['psf_sigma_px'] or None,
               noise_sigma=own['noise_sigma'], **arrays))
