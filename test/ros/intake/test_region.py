"""A region is cut out of frames, and what is found there told in pixels of the whole."""

import numpy as np
import pytest

pytest.importorskip('rclpy')

from track_before_detect import detect  # noqa: E402
from track_before_detect.errors import DataError, ParameterError  # noqa: E402
from track_before_detect.ros.intake.region import Region  # noqa: E402
from track_before_detect.ros.search_results import StreamResult  # noqa: E402
from track_before_detect.types import FrameBatch  # noqa: E402

UNTOLD = {'sensors': [], 'doppler_ambiguities': False, 'doppler_m_s_per_column': 0.0,
          'frame_height': 0, 'frame_width': 0}


def region(*numbers, **told):
    return Region.of({**UNTOLD, **told, 'region': [float(number) for number in numbers]})


def test_it_is_cut_and_what_is_found_is_told_where_it_is_in_the_whole(moving_target):
    frames, positions = moving_target(10, (40, 60))
    part = region(8, 5, 50, 30)
    cut = np.array([part.cut(frame) for frame in frames])
    np.testing.assert_array_equal(cut, frames[:, 5:35, 8:58])
    assert part.frame_shape == (40, 60) and str(part) == '8 5 50 30'
    found = detect(cut, threshold=12.0)
    whole = part.in_whole(StreamResult(found, FrameBatch.of(cut), {}, 1.0, 5))
    [one] = whole.detection.trajectories
    assert np.hypot(*(one.positions - positions).T).mean() < 0.5


def test_none_is_all_of_the_frames():
    assert region() is None


@pytest.mark.parametrize(('numbers', 'told', 'sentence'), [
    ((1, 2, 3), {}, 'region must be column, row, width and height in whole pixels, .*got 1 2 3'),
    ((1, 2, 3, 4.5), {}, 'got 1 2 3 4.5'),
    ((-1, 2, 3, 4), {}, 'got -1 2 3 4'),
    ((1, 2, 0, 4), {}, 'got 1 2 0 4'),
    ((1, 2, 3, 4), {'sensors': ['a']}, r"region \(1 2 3 4\) is .* got it beside sensors=\['a'\]"),
    ((1, 2, 3, 4), {'doppler_ambiguities': True}, 'beside doppler_ambiguities=True'),
    ((6, 0, 5, 4), {'frame_height': 4, 'frame_width': 10},
     r'region \(6 0 5 4: columns 6 to 10, rows 0 to 3\) must lie within the frames, found '
     r'frames of 10 x 4 \(width x height\)'),
])
def test_one_of_no_use_is_one_sentence(numbers, told, sentence):
    with pytest.raises(ParameterError, match=sentence):
        region(*numbers, **told)


def test_a_frame_that_ends_before_it_is_refused():
    with pytest.raises(DataError, match='rows 7 to 10.*found frames of 20 x 10'):
        region(0, 7, 20, 4).cut(np.zeros((10, 20)))
    np.testing.assert_array_equal(region(0, 7, 20, 3).cut(np.ones((10, 20))), np.ones((3, 20)))
