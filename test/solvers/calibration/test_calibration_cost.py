"""A calibration takes no longer than it should, and those that are usual stay what they were."""

import numpy as np
import pytest

from track_before_detect import Sensor
from track_before_detect.kernels.amplitude_codes import NON_NEGATIVE
from track_before_detect.models.amplitudes import AMPLITUDE_MODELS
from track_before_detect.models.measurement.psf import GaussianPsf
from track_before_detect.models.motion.state_graph import build_state_graph
from track_before_detect.options import DetectorOptions
from track_before_detect.solvers.calibration import threshold
from track_before_detect.solvers.calibration.calibration_cost import search_seconds
from track_before_detect.solvers.convex.detector import ConvexDetector
from track_before_detect.solvers.detectors import DETECTOR_CLASSES
from track_before_detect.tracking.sensors import SensorArray


def study_of(n_frames, shape, detector='convex', **options):
    made = DETECTOR_CLASSES[detector](DetectorOptions(detector=detector, **options))
    return made.noise_study(np.arange(float(n_frames)), shape)


def two_sensors(shape):
    sensors = [Sensor(np.zeros((10, *shape)), np.arange(10) + 0.3 * number,
                      [[1, 0, 5.0 * number], [0, 1, 0]], 1.0) for number in range(2)]
    array = SensorArray(sensors, DetectorOptions())
    detector = ConvexDetector(DetectorOptions(), array.measurement)
    return detector.noise_study(array.stamps, array.measurement.shape)


@pytest.mark.parametrize(('shape', 'make'), [
    pytest.param((64, 64), lambda shape: study_of(20, shape), id='default, small'),
    pytest.param((512, 640), lambda shape: study_of(20, shape), id='default, large'),
    pytest.param((128, 128), lambda shape: study_of(50, shape), id='50 frames'),
    pytest.param((64, 64), lambda shape: study_of(20, shape, amplitudes='complex'), id='complex'),
    pytest.param((128, 128), lambda shape: study_of(20, shape, presence='partial'), id='partial'),
    pytest.param((32, 64), lambda shape: study_of(
        6, shape, exposure_s=0.85, max_speed_px_s=8.0, max_acceleration_px_s2=0.5), id='streaks'),
    pytest.param((512, 640), lambda shape: study_of(20, shape, exposure_s=1.0, max_speed_px_s=3.0),
                 id='streaks, large'),
    pytest.param((48, 48), two_sensors, id='sensors'),
    pytest.param((128, 128), two_sensors, id='sensors, large'),
    pytest.param((128, 128), lambda shape: study_of(20, shape, 'cso_dpr', max_speed_px_s=3.0),
                 id='second order'),
    pytest.param((128, 128), lambda shape: study_of(20, shape, 'velocity_filter'),
                 id='velocity filter'),
    pytest.param((128, 128), lambda shape: study_of(50, shape, 'velocity_filter'),
                 id='velocity filter, 50 frames')])
def test_a_calibration_takes_half_a_minute_on_two_cores(shape, make):
    study = make(shape)
    crop = threshold._crop(study, shape)
    n_crops = threshold._crop_count(study, crop)
    assert n_crops >= threshold.LEAST_CROPS
    assert 0 < n_crops * study.seconds(crop) < 60


@pytest.mark.parametrize(('n_frames', 'shape', 'options', 'n_crops'), [
    (20, (64, 64), {}, 2800), (20, (96, 96), {}, 1422), (20, (128, 128), {}, 800),
    (20, (512, 640), {}, 800), (20, (96, 96), {'detector': 'greedy'}, 1422),
    (20, (96, 96), {'detector': 'velocity_filter'}, 997),
    (6, (50, 50), {'detector': 'velocity_filter'}, 2800),
    (20, (96, 96), {'detector': 'cso_dpr'}, 1422), (6, (50, 50), {'detector': 'mff_dp'}, 2800)])
def test_usual_calibrations_keep_their_crops(n_frames, shape, options, n_crops):
    study = study_of(n_frames, shape, **options)
    crop = threshold._crop(study, shape)
    assert crop == tuple(min(side, threshold.CROP_PX) for side in shape)
    assert threshold._crop_count(study, crop) == n_crops


def test_whatever_takes_longer_is_said_to_take_longer():
    graph = build_state_graph(np.arange(12.0), step_px=0.5, max_speed=1.0, max_acceleration=0.05,
                              turn_cost=3.0)
    psf, model = GaussianPsf(1.0), AMPLITUDE_MODELS[NON_NEGATIVE]
    plain = search_seconds(graph, psf, (60, 60), model, False, 0)
    assert search_seconds(graph, psf, (120, 60), model, False, 0) == pytest.approx(2 * plain)
    assert search_seconds(graph, psf, (60, 60), model, True, 0) > 1.3 * plain
    refined = search_seconds(graph, psf, (60, 60), model, False, 3)
    assert refined > plain
    # Refining does not take longer in larger frames.
    assert search_seconds(graph, psf, (120, 60), model, False, 3) == pytest.approx(
        refined + plain)
    assert search_seconds(graph, GaussianPsf(3.0), (60, 60), model, False, 3) > refined
