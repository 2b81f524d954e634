"""What each detector can do: the values of every option that it honours, and why no others.

Declared once. It makes the refusals (:func:`check_options`), the tables of the README
(:mod:`track_before_detect.option_tables`) and the test that tries every option of every detector.
An option at its default is never refused; an option without a :class:`Limit` is honoured.
"""

from collections.abc import Callable
from dataclasses import fields
from typing import Any, NamedTuple

from track_before_detect.errors import ParameterError
from track_before_detect.options import DetectorOptions

_DEFAULTS = {field.name: field.default for field in fields(DetectorOptions)}


class Condition(NamedTuple):
    """When a limit holds.

    Attributes
    ----------
    words : str
        Follows an option and its value, as in ``'with motion_model=static'``.
    holds : callable
        Told the options.
    """

    words: str
    holds: Callable[[DetectorOptions], bool]


class Limit(NamedTuple):
    """The values of an option that can be honoured.

    Attributes
    ----------
    option : str
    reason : str
        Why no others, as the end of a sentence.
    allowed : tuple
        Values beside the default.
    no_effect : tuple
        Those of the allowed ones that change nothing, because the method does so anyway.
    when : Condition, optional
        Always unless given.
    """

    option: str
    reason: str
    allowed: tuple = ()
    no_effect: tuple = ()
    when: Condition | None = None

    def refuses(self, options: DetectorOptions) -> bool:
        """Return whether the options go beyond this limit."""
        value = getattr(options, self.option)
        return (value != _DEFAULTS[self.option] and value not in self.allowed
                and (self.when is None or self.when.holds(options)))

    @property
    def values(self) -> str:
        """What is allowed, in words."""
        return ' or '.join(value_words(self.option, value)
                           for value in (_DEFAULTS[self.option], *self.allowed))


class NoEffect(NamedTuple):
    """An option that changes nothing under a condition, and is not refused there."""

    option: str
    reason: str
    when: Condition


class Capability(NamedTuple):
    """What detectors of one kind can do.

    Attributes
    ----------
    detectors : tuple of str
        Their names.
    method : str
        What they do, with its source.
    limits : tuple of Limit
        Of these detectors, whatever they are combined with.
    """

    detectors: tuple[str, ...]
    method: str
    limits: tuple[Limit, ...] = ()


def _with(option: str, *values: Any) -> Condition:
    """Return the condition that an option has one of some values."""
    words = ' or '.join(value_words(option, value) for value in values)
    return Condition(f'with {option}={words}', lambda options: getattr(options, option) in values)


def value_words(option: str, value: Any) -> str:
    """Return the value of an option as a sentence names it."""
    if value is None:
        return 'none' if option in ('psf', 'variance', 'mask') else 'automatic'
    if isinstance(value, tuple):
        return ', '.join(f'{item:g}' for item in value)
    return f'{value:g}' if isinstance(value, float) else str(value)


_ONE_DIRECTION_SET = Limit('directions', 'only pc_dp splits its search by direction')
_NO_SCHEDULE = Limit('continuation', 'only convex goes from a convex objective to the number of '
                     'paths')
_NO_STREAKS = Limit('exposure_s', 'it takes an exposure for a moment; convex and greedy search '
                    'streaks')
_NOT_STOPPED = Limit('max_time_s', 'its compiled search of a batch ends by itself, after as many '
                     'targets as a batch may hold')
_SMALL = (
    Limit('max_memory_gb', 'only convex and greedy can hold a part of what they search'),
    Limit('tile_px', 'only convex and greedy are searched tile by tile'))
_WHOLE_BATCH = Limit('presence', 'it follows a target through the whole batch')
_ONE_MODEL = Limit('amplitude_model', 'it cancels targets with one model of their amplitudes',
                   ('constant',))
_ANY_MOTION = 'it bounds the speed and nothing else'
_IN_NOISE = Limit('calibration', 'only convex compares a path with the others of its batch')
_BOUNDED_SPEED = (
    Limit('motion_model', _ANY_MOTION, ('static',)), Limit('max_acceleration_px_s2', _ANY_MOTION))

CAPABILITIES = (
    Capability(
        ('convex',),
        'all trajectories jointly, from a convex objective to the number of paths',
        (_ONE_DIRECTION_SET,)),
    Capability(
        ('greedy',), 'one trajectory after the other over the same paths, none fitted again',
        (_NO_SCHEDULE, _IN_NOISE, _ONE_DIRECTION_SET)),
    Capability(
        ('cfo_dp', 'cso_dp', 'mff_dp', 'cfo_dpr', 'cso_dpr', 'mff_dpr'),
        'dynamic programming over whole pixels, of first (`cfo`) or second order (`cso`, `mff`), '
        'in one direction (`_dp`) or as a ring (`_dpr`): Fu et al. 2022',
        (*(Limit(name, 'it needs a Gaussian sampled at the pixel centres')
           for name in ('psf', 'psf_model')),
         _NO_STREAKS, *_BOUNDED_SPEED, *_SMALL, _WHOLE_BATCH,
         Limit('amplitudes', 'it looks for the largest sums'),
         Limit('amplitude_model', 'it adds up amplitudes as they are, as if they were constant',
               ('constant',), no_effect=('constant',)),
         Limit('noise', 'it does not weigh pixels by their noise', ('robust',)),
         Limit('variance', 'it does not weigh pixels by their noise'),
         _NO_SCHEDULE, _IN_NOISE, _ONE_DIRECTION_SET)),
    Capability(
        ('mt_dp',), 'dynamic programming with target cancellation: Guo et al. 2018',
        (_NO_STREAKS, *_BOUNDED_SPEED, *_SMALL, _WHOLE_BATCH, _ONE_MODEL, _NO_SCHEDULE,
         _IN_NOISE, _NOT_STOPPED, _ONE_DIRECTION_SET)),
    Capability(
        ('pc_dp',), 'the same for each sector of directions at the same time',
        (_NO_STREAKS, *_BOUNDED_SPEED, *_SMALL, _WHOLE_BATCH, _ONE_MODEL, _NO_SCHEDULE,
         _IN_NOISE, _NOT_STOPPED)),
    Capability(
        ('velocity_filter',), 'shift-and-stack along straight lines',
        (_NO_STREAKS, *_SMALL,
         Limit('motion_model', 'it searches straight lines', ('constant_velocity', 'static'),
               no_effect=('constant_velocity',)),
         Limit('max_acceleration_px_s2', 'it searches straight lines'),
         _WHOLE_BATCH,
         Limit('amplitudes', 'it adds up what keeps its sign', ('signed',)),
         Limit('amplitude_model', 'it takes amplitudes for constant', ('constant',),
               no_effect=('constant',)),
         _NO_SCHEDULE, _IN_NOISE, _ONE_DIRECTION_SET)),
)

_NO_DOPPLER = Condition('without motion_model=range_doppler',
                        lambda options: options.motion_model != 'range_doppler')
_COMPLEX = _with('amplitudes', 'complex')
_STREAKS = 'exposure_s'
_CLUTTER = _with('calibration', 'clutter')

# What cannot be combined, with any detector.
COMBINATIONS = (
    Limit('motion_model', 'range_bins_per_doppler_bin has to say how far a Doppler bin moves a '
          'target',
          ('constant_velocity', 'static', 'range_bearing'),
          when=Condition('without range_bins_per_doppler_bin',
                         lambda options: not options.range_bins_per_doppler_bin)),
    Limit('range_bins_per_doppler_bin', 'there are no Doppler bins', (0.0,), when=_NO_DOPPLER),
    *(Limit(name, 'there are no Doppler bins', when=_NO_DOPPLER)
      for name in ('doppler_offset_bins', 'doppler_ambiguities')),
    Limit('max_speed_px_s', 'the Doppler bins say how fast a target is',
          when=_with('motion_model', 'range_doppler')),
    Limit('registration', 'the columns go round', when=_with('motion_model', 'range_bearing')),
    Limit('registration', 'the columns go round', when=Condition(
        'with doppler_ambiguities', lambda options: options.doppler_ambiguities > 0)),
    Limit('registration', 'shifts are found between pictures of real numbers', when=_COMPLEX),
    Limit('frame_scale', 'complex numbers are no scale of magnitudes', when=_COMPLEX),
    Limit('background', 'the phase of neighbouring pixels has no median', ('temporal_median',),
          when=_COMPLEX),
    Limit('presence', 'the magnitudes of noise have a mean above zero, so their sum over the root '
          'of the frames grows with the frames',
          when=Condition('with amplitudes=complex and amplitude_model=constant',
                         lambda options: (options.amplitudes == 'complex'
                                          and options.amplitude_model == 'constant'))),
    Limit('tile_px', 'the columns are no places that a tile could hold some of',
          when=_with('motion_model', 'range_doppler', 'range_bearing')),
    Limit('tile_px', 'the other paths of the whole batch are the threshold', when=_CLUTTER),
    *(Limit(name, 'the strongest other paths of the batch are the threshold', when=_CLUTTER)
      for name in ('presence', 'amplitude_model', 'threshold', 'motion_model', 'exposure_s')),
    Limit('amplitude_model', 'a modulus that is constant gains too little to be searched beside',
          ('constant',), when=_COMPLEX),
    Limit('variance', 'both say how much noise a pixel has', when=_with('noise', 'map')),
    Limit('hop', 'it goes with the length that is given to batches', when=Condition(
        'without batch_length', lambda options: options.batch_length is None)),
    Limit(_STREAKS, 'their columns are no places along which a target is smeared',
          when=_with('motion_model', 'range_doppler', 'range_bearing')),
    Limit(_STREAKS, 'a target is smeared along its motion in the frame, not on the registered '
          'plane', when=_with('registration', 'translation', 'affine', 'homography', 'auto')),
    Limit(_STREAKS, 'a streak has unit norm whatever its length, so what is constant of a target '
          'is not its amplitude', when=_with('amplitude_model', 'constant', 'either')),
    Limit(_STREAKS, 'streaks are searched by shapes that are near to theirs, which a certificate '
          'over all paths cannot rest on',
          when=Condition('with a continuation that ends with 1',
                         lambda options: options.continuation[-1] == 1.0)),
)

# What several sensors cannot honour either.
SEVERAL_SENSORS = (
    Limit('detector', 'only these take each frame through the map of its sensor', ('greedy',)),
    Limit('registration', 'their maps are given'),
    Limit('background', 'a background is of one sensor',
          ('temporal_median', 'spatial_median', 'temporal_spatial_median')),
    Limit('calibration', 'clutter is that of one sensor'),
    Limit('tile_px', 'they look at a common plane as a whole'),
    Limit('motion_model', 'they look at a common plane', ('constant_velocity', 'static')),
    Limit('amplitude_model', 'what is constant in the units of one sensor is not in those of '
          'another'),
    Limit(_STREAKS, 'the exposure is that of one sensor'),
    *(Limit(name, 'the pixels of one sensor are not those of another: give each its own')
      for name in ('variance', 'mask')),
)

WITHOUT_EFFECT = (
    NoEffect('search_plane', 'there is no other plane', _with('registration', 'none')),
    *(NoEffect(name, 'the array takes the place of the Gaussian',
               Condition('with psf', lambda options: options.psf is not None))
      for name in ('psf_sigma_px', 'psf_model')),
    NoEffect('false_alarm_rate', 'the threshold is given',
             Condition('with threshold, but for amplitude_model=either', lambda options: (
                 options.threshold is not None and options.amplitude_model != 'either'))),
    NoEffect('max_speed_px_s', 'targets stand still', _with('motion_model', 'static')),
    NoEffect('max_acceleration_px_s2', 'velocities do not change',
             _with('motion_model', 'constant_velocity', 'static')),
)


def capability(detector: str) -> Capability:
    """Return what a detector can do."""
    return next(one for one in CAPABILITIES if detector in one.detectors)


def check_options(options: DetectorOptions, *, several_sensors: bool = False) -> None:
    """Raise ParameterError where the detector cannot honour an option.

    Parameters
    ----------
    options : DetectorOptions
        With the name of the detector among them.
    several_sensors : bool
        Whether frames of several sensors are searched together.
    """
    kinds = (('several sensors', SEVERAL_SENSORS if several_sensors else ()),
             (options.detector, (*capability(options.detector).limits, *COMBINATIONS)))
    for who, limits in kinds:
        for limit in limits:
            if limit.refuses(options):
                value = value_words(limit.option, getattr(options, limit.option))
                condition = f' {limit.when.words}' if limit.when else ''
                raise ParameterError(f'{who} cannot honour {limit.option}={value}{condition}, '
                                     f'only {limit.values}: {limit.reason}')
