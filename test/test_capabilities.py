"""Every option of every detector is honoured or refused, as the table of capabilities says."""

from dataclasses import dataclass, field
from functools import cache, lru_cache
import itertools
import re

import numpy as np
import pytest

import track_before_detect as tbd
from track_before_detect.capabilities import (
    CAPABILITIES,
    check_options,
    COMBINATIONS,
    WITHOUT_EFFECT,
)
from track_before_detect.errors import ParameterError, TbdError
from track_before_detect.options import describe, DetectorOptions, DETECTORS
from track_before_detect.simulation.sensor import add_target

T, SHAPE = 8, (28, 36)
DOPPLER = {'motion_model': 'range_doppler', 'range_bins_per_doppler_bin': 0.1}


@dataclass(frozen=True)
class Case:
    """A value of an option, and where it must make a difference.

    Attributes
    ----------
    value : object
    beside : dict
        Other options, with which the default of this one is compared.
    scene : str
    alike : tuple of str
        Detectors that have to find the same, but for rounding.
    """

    value: object
    beside: dict = field(default_factory=dict)
    scene: str = 'targets'
    alike: tuple[str, ...] = ()


CASES = {
    'psf_sigma_px': [Case(1.5)],
    'psf_model': [Case('integrated_gaussian')],
    'psf': [Case(np.outer([1, 3, 4, 3, 1], [1, 2, 3, 2, 1]))],
    'exposure_s': [Case(0.5)],
    'max_speed_px_s': [Case(3.0)],
    'max_acceleration_px_s2': [Case(0.5)],
    'motion_model': [
        Case('constant_velocity', scene='long'), Case('static'), Case('range_bearing'),
        Case('range_doppler', {'range_bins_per_doppler_bin': 0.1}, 'doppler')],
    'range_bins_per_doppler_bin': [Case(0.2, DOPPLER, 'doppler')],
    'doppler_offset_bins': [Case(3.0, DOPPLER, 'doppler')],
    'doppler_ambiguities': [Case(1, DOPPLER, 'doppler')],
    'directions': [Case(1)],
    'presence': [Case('partial'), Case('partial', {'exposure_s': 0.5})],
    'amplitudes': [Case('signed'), Case('complex', scene='complex')],
    'amplitude_model': [Case('constant'), Case('either', scene='steady')],
    'false_alarm_rate': [Case(0.4, {'threshold': None}, 'small')],
    'threshold': [Case(12.0)],
    'continuation': [Case((1.0,))],
    'batch_length': [Case(5)],
    'hop': [Case(1, {'batch_length': 5})],
    'frame_scale': [Case(name, {'background': 'temporal_median', 'threshold': 25.0}, 'maps')
                    for name in ('magnitude', 'power', 'decibels', 'auto')],
    'bad_frames': [Case('find', scene='blank')],
    'bad_pixels': [Case('find', {'noise': 'robust'}, 'hot')],
    'max_time_s': [Case(1e-9)],
    # No room for the fast.
    'max_memory_gb': [Case(0.0015, {'max_speed_px_s': 4.0, 'max_acceleration_px_s2': 1.0})],
    # Only convex improves targets in turn, and so those that lie near each other in two tiles.
    'tile_px': [Case(8, {'max_speed_px_s': 0.1}, alike=('greedy',))],
    'registration': [Case(name, {'threshold': 13.0}, 'panning')
                     for name in ('translation', 'affine', 'homography', 'auto')],
    'background': [Case(name, {'threshold': 13.0}, 'panning') for name in (
        'temporal_median', 'spatial_median', 'temporal_spatial_median', 'either')],
    'search_plane': [Case('image', {'registration': 'affine', 'threshold': None,
                                    'false_alarm_rate': 0.4}, 'panning')],
    'noise': [Case('robust'), Case('map'), Case('local')],
    'calibration': [Case('clutter', {'threshold': None})],
    'variance': [Case(1.0 + np.arange(SHAPE[0] * SHAPE[1]).reshape(SHAPE) / 500)],
    'mask': [Case(np.arange(SHAPE[1]) == 15 + np.zeros((SHAPE[0], 1)))],
}
PAIRS = [pytest.param(detector, option, case, id=f'{detector}-{option}-{n}')
         for detector in DETECTORS for option, cases in CASES.items()
         for n, case in enumerate(cases)]


@pytest.fixture(autouse=True)
def quick_calibration(monkeypatch, tmp_path):
    """Let a threshold be rough, and keep it out of the cache of a user."""
    monkeypatch.setattr('track_before_detect.solvers.calibration.threshold.MOST_CROPS', 160)
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))


@lru_cache
def frames_of(scene):
    """Return a bright, a negative, a late and a fast target, and one across the seam."""
    rng = np.random.default_rng(7)
    n_frames = 20 if scene in ('long', 'maps') else T
    frames = rng.standard_normal((n_frames, *SHAPE)).astype(np.float32)
    for t, frame in enumerate(frames):
        add_target(frame, 10 + 0.8 * t, 20 - 0.3 * t, 1.0, 11.0 + 2 * np.cos(t))
        add_target(frame, 12 + 0.5 * t, 8.0, 1.0, -11.0)
        add_target(frame, 8 + 1.7 * t, 14 + 0.04 * t**2, 1.0, 10.0)
        if t >= 3:
            add_target(frame, 28.0, 10 + 0.6 * t, 1.0, 10.0)
        add_target(frame, (33 + 0.9 * t) % SHAPE[1], 24.0, 1.0, 10.0)
    if scene == 'doppler':
        # The columns are 36 bins off.
        for t, frame in enumerate(frames):
            add_target(frame, 27.0, 24 - 2.7 * t, 1.0, 12.0)
    elif scene == 'maps':
        frames = np.abs(frames + 1j * rng.standard_normal(frames.shape))**2 / 2
    elif scene == 'blank':
        frames[3] *= 0.1
    elif scene == 'hot':
        frames[:, 14, 14] += 50
    elif scene == 'steady':
        frames /= 3
        for t, frame in enumerate(frames):
            add_target(frame, 8 + 0.5 * t, 14.0, 1.0, 10.0)
    elif scene == 'small':
        frames = frames[:4, :16, :16]
    elif scene == 'complex':
        frames = frames * np.exp(1j * rng.uniform(0, 2 * np.pi, (T, *SHAPE)))
    elif scene == 'panning':
        ground = rng.standard_normal((SHAPE[0], SHAPE[1] + 2 * T)) * 1.5
        frames = frames + np.stack([ground[:, 2 * t:2 * t + SHAPE[1]] for t in range(T)])
    return frames


def one_sensor(frames, **options):
    return tbd.detect(frames, **options)


def several_sensors(frames, **options):
    """Search the frames twice, as one sensor and as one that is upside down."""
    upright = np.arange(float(len(frames)))
    turned = [[1, 0, 0], [0, -1, frames.shape[1] - 1]]
    return tbd.detect_sensors([tbd.Sensor(frames, upright),
                               tbd.Sensor(frames[:, ::-1], upright + 0.5, affine=turned)],
                              **options)


def observed(detector, scene, options, search=one_sensor):
    """Return all that a detection tells, or the kind of error that it ends with."""
    try:
        result = search(frames_of(scene), detector=detector, **{'threshold': 9.0, **options})
    except ParameterError:
        raise
    except TbdError as error:
        return type(error).__name__
    return (result.threshold, result.n_batches, result.status, [
        (trajectory.statistic, trajectory.snr, trajectory.positions.tolist(),
         trajectory.amplitudes.tolist()) for trajectory in result.trajectories])


@cache
def observed_before(detector, scene, options, search):
    """Return what is observed with options, as pairs of name and value; many compare with it."""
    return observed(detector, scene, dict(options), search)


def refusal(detector, options, **how):
    """Return what the table refuses, or nothing."""
    try:
        check_options(DetectorOptions(detector=detector, **options), **how)
    except ParameterError as error:
        return str(error)
    return ''


def same(one, other):
    """Return whether two observations are the same; NaN is."""
    return repr(one) == repr(other)


def test_the_cases_try_every_option_and_every_choice():
    for option in describe():
        if option['name'] == 'detector':
            continue
        tried = [case.value for case in CASES[option['name']]]
        if option['choices']:
            assert {*tried, option['default']} == set(option['choices'])
    assert [name for one in CAPABILITIES for name in one.detectors] == list(DETECTORS)


@pytest.mark.parametrize(('detector', 'option', 'case'), PAIRS)
def test_every_option_changes_something_or_is_refused(detector, option, case):
    assert_honoured_or_refused(detector, option, case, one_sensor)


@pytest.mark.parametrize(('detector', 'option', 'case'), [
    pair for pair in PAIRS if pair.values[0] in ('convex', 'greedy')])
def test_every_option_of_several_sensors_changes_something_or_is_refused(detector, option, case):
    assert_honoured_or_refused(detector, option, case, several_sensors)


@pytest.mark.parametrize('detector', DETECTORS)
def test_two_options_that_are_not_refused_can_be_searched(detector):
    names = ('motion_model', 'amplitudes', 'amplitude_model', 'presence', 'psf_model',
             'max_acceleration_px_s2')
    values = [(name, case.value) for name in names for case in CASES[name]]
    for one, other in itertools.combinations(values, 2):
        options = {'threshold': 30.0, **dict([one, other])}
        if options.get('motion_model') == 'range_doppler':
            options['range_bins_per_doppler_bin'] = 0.5
        frames = frames_of('small')
        frames = frames.astype(complex) if options.get('amplitudes') == 'complex' else frames
        if refusal(detector, options):
            with pytest.raises(ParameterError):
                tbd.detect(frames, detector=detector, **options)
        else:
            result = tbd.detect(frames, detector=detector, **options)
            assert result.threshold == pytest.approx(30.0)


def test_every_combination_of_the_table_is_refused():
    given = [{**case.beside, option: case.value} for option, cases in CASES.items()
             for case in cases]
    given += [{'amplitudes': 'complex', 'amplitude_model': 'constant'}, {'hop': 1},
              {'range_bins_per_doppler_bin': 0.1}, {'motion_model': 'range_doppler'}]
    tried = set()
    for one, other in itertools.product(given, given):
        options = {**one, **other}
        limits = [limit for limit in COMBINATIONS if limit.refuses(DetectorOptions(**options))]
        tried.update(limits)
        if limits and 'directions' not in options:
            said = refusal('convex', options)
            assert said.startswith(f'convex cannot honour {limits[0].option}=')
            assert said.endswith(limits[0].reason) and '\n' not in said and '. ' not in said
    assert tried == set(COMBINATIONS)


def test_several_sensors_refuse_the_other_detectors():
    for detector in set(DETECTORS) - {'convex', 'greedy'}:
        with pytest.raises(ParameterError, match=f'detector={detector}, only convex or greedy'):
            several_sensors(frames_of('targets'), detector=detector, threshold=9.0)


def assert_honoured_or_refused(detector, option, case, search):
    given = {**case.beside, option: case.value}
    several = {'several_sensors': search is several_sensors}
    said = refusal(detector, given, **several)
    if said:
        with pytest.raises(ParameterError) as error:
            observed(detector, case.scene, given, search)
        assert str(error.value) == said
        assert re.match(rf'({detector}|several sensors) cannot honour ', said)
        assert any(f'{name}=' in said for name in given)
        assert '\n' not in said and '. ' not in said and not said.endswith('.')
        return
    # One that is needed by the value is refused without it.
    beside = {} if refusal(detector, case.beside, **several) else case.beside
    limits = next(one.limits for one in CAPABILITIES if detector in one.detectors)
    ignored = any(limit.option == option and case.value in limit.no_effect for limit in limits)
    changed = observed(detector, case.scene, given, search)
    before = observed_before(detector, case.scene, tuple(beside.items()), search)
    if detector in case.alike:
        found, known = ([(one[0], *np.ravel(one[2])) for one in told[3]]
                        for told in (changed, before))
        assert found and np.allclose(found, known, rtol=1e-6, equal_nan=True)
    else:
        assert same(changed, before) == ignored


WITHOUT = [
    ('psf_sigma_px', {'psf': CASES['psf'][0].value}),
    ('psf_model', {'psf': CASES['psf'][0].value}),
    ('false_alarm_rate', {'threshold': 9.0}),
    ('search_plane', {'registration': 'none'}),
    ('max_speed_px_s', {'motion_model': 'static'}),
    ('max_acceleration_px_s2', {'motion_model': 'static'}),
    ('max_acceleration_px_s2', {'motion_model': 'constant_velocity'})]


@pytest.mark.parametrize(('detector', 'option', 'other'), [
    pytest.param(detector, option, other, id=f'{detector}-{option}-{"-".join(other)}')
    for detector in DETECTORS for option, other in WITHOUT
    if not refusal(detector, {**other, option: CASES[option][0].value})])
def test_what_is_said_to_have_no_effect_has_none(detector, option, other):
    given = {**other, option: CASES[option][0].value}
    assert any(one.option == option and one.when.holds(DetectorOptions(**given))
               for one in WITHOUT_EFFECT)
    assert same(observed(detector, 'targets', given), observed(detector, 'targets', other))


def test_all_that_has_no_effect_is_tried():
    assert {one.option for one in WITHOUT_EFFECT} == {option for option, _ in WITHOUT}
