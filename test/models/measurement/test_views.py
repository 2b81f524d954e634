"""Every measurement model can be cut to some frames, and seen with a Gaussian of another width."""

import numpy as np
import pytest

from track_before_detect import geometry
from track_before_detect.models.measurement.multi_sensor import MultiSensor
from track_before_detect.models.measurement.psf import ArrayPsf, GaussianPsf
from track_before_detect.models.measurement.streak import StreakPsf
from track_before_detect.solvers.fit.working_set import StampRenderer

T, SHAPE = 6, (24, 30)
TIMES = np.arange(float(T))
LINE = np.array([9.3, 10.6]) + TIMES[:, None] * np.array([1.7, 0.4])
NO_WEIGHTS = np.zeros((0, 0, 0), np.float32)
SENSOR = np.array([0, 1, 0, 1, 1, 0])
MAPS = geometry.translations(np.array([[0.0, 0.0], [-4.0, 2.0]]))[SENSOR]
SENSORS = MultiSensor((GaussianPsf(1.0), GaussianPsf(1.3)), (SHAPE, SHAPE), SENSOR, MAPS, SHAPE)
MODELS = {
    'gaussian': GaussianPsf(1.0),
    'array': ArrayPsf(np.outer([1, 3, 1], [1, 4, 2])),
    'streak': StreakPsf(GaussianPsf(1.0), 0.9, 4.0, tuple(TIMES)),
    'sensors': SENSORS,
}


@pytest.mark.parametrize('name', MODELS)
@pytest.mark.parametrize('frames', [slice(2, 5), np.array([2, 3, 4])], ids=['slice', 'numbers'])
def test_a_slice_sees_its_frames_as_the_whole_does(name, frames):
    model = MODELS[name]
    whole = StampRenderer(model, (T, *SHAPE), NO_WEIGHTS).render(LINE)
    part = StampRenderer(model.slice(frames), (3, *SHAPE), NO_WEIGHTS).render(LINE[frames])
    # The motion is straight, so that velocities at the ends of the slice are those of the whole.
    for all_frames, some in zip(whole, part, strict=True):
        np.testing.assert_allclose(some, all_frames[frames], atol=1e-9)


@pytest.mark.parametrize('name', MODELS)
@pytest.mark.parametrize('width', [0.8, 1.6])
def test_the_same_view_of_a_gaussian_is_as_wide_as_asked(name, width):
    model = MODELS[name].gaussian(width)
    assert model.width_px == pytest.approx(width, rel=1e-6)
    assert model.slice(slice(0, 2)).width_px == pytest.approx(width, rel=1e-6)


def test_the_view_of_a_gaussian_keeps_maps_and_smear():
    wide = SENSORS.gaussian(2.0)
    np.testing.assert_array_equal(wide.maps, SENSORS.maps)
    assert [psf.sigma_px for psf in wide.psfs] == pytest.approx([2.0, 2.6])
    streak = MODELS['streak'].gaussian(2.0)
    assert (streak.exposure, streak.longest_px, streak.times) == (0.9, 4.0, tuple(TIMES))


def test_one_sigma_is_told_where_all_psfs_have_it():
    assert [MODELS[name].gaussian_sigma_px for name in MODELS] == [1.0, None, 1.0, None]
    alike = MultiSensor((GaussianPsf(1.2), GaussianPsf(1.2)), (SHAPE, SHAPE), SENSOR, MAPS, SHAPE)
    assert alike.gaussian_sigma_px == 1.2
