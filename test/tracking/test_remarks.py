"""What batches say of their frames is said once."""

import logging

from track_before_detect.tracking.remarks import Remarks
from track_before_detect.types import Remark


def test_each_frame_is_named_once(caplog):
    remarks = Remarks()
    with caplog.at_level(logging.WARNING):
        assert remarks.new([Remark('blank', '{frames} masked', (3, 4, 5, 8))]) == [
            'frames 3 to 5, 8 masked']
        assert remarks.new([Remark('blank', '{frames} masked', (5, 8, 9))]) == ['frame 9 masked']
        assert remarks.new([Remark('blank', '{frames} masked', (8, 9))]) == []
        assert remarks.new([Remark('cut', 'cut at {frames}', (9,))]) == ['cut at frame 9']
    assert [record.message for record in caplog.records] == [
        'frames 3 to 5, 8 masked', 'frame 9 masked', 'cut at frame 9']


def test_what_is_about_pixels_is_said_once():
    remarks = Remarks()
    assert remarks.new([Remark('hot', '2 hot pixels are masked')]) == ['2 hot pixels are masked']
    assert remarks.new([Remark('hot', '3 hot pixels are masked'), Remark('dead', '1 dead')]) == [
        '1 dead']


def test_many_frames_are_counted():
    [sentence] = Remarks().new([Remark('blank', '{frames} masked', tuple(range(1, 30, 3)))])
    assert sentence == '10 frames from 1 to 28 masked'
