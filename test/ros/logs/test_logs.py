import logging
import os
import time
import warnings

import pytest

pytest.importorskip('rclpy')

from track_before_detect.ros.logs.library_log import LibraryLog  # noqa: E402
from track_before_detect.ros.logs.log_folder import ensure_log_folder  # noqa: E402
from track_before_detect.ros.logs.throttled import ThrottledLog  # noqa: E402


def test_a_flood_of_lines_is_thinned_out_and_its_last_one_logged():
    lines = []
    log = ThrottledLog(lines.append, most_lines=3, period_s=0.2)
    for number in range(50):
        log(f'line {number}')
    assert lines == ['line 0', 'line 1', 'line 2']
    log.catch_up()
    assert len(lines) == 3
    time.sleep(0.25)
    log.catch_up()
    log.catch_up()
    assert lines[3:] == ['line 49 (46 lines left out before)']
    log('line 50')
    assert lines[4:] == ['line 50']


def test_what_the_library_warns_of_is_handed_on_in_one_line_until_closed(recwarn):
    heard = []
    log = LibraryLog(lambda kind, text: heard.append((kind, text)))
    ours = logging.getLogger('track_before_detect.some.room')
    try:
        for number in (1, 2):
            ours.warning('the pixels have\n a median of %d', number)
        ours.info('nothing of interest')
        warnings.warn('a number is too large', RuntimeWarning, stacklevel=1)
        try:
            raise ZeroDivisionError('by hand')
        except ZeroDivisionError:
            ours.exception('the search has ended')
    finally:
        log.close()
    ours.warning('too late')
    kinds, texts = zip(*heard, strict=True)
    assert texts[:2] == ('the pixels have a median of 1', 'the pixels have a median of 2')
    assert kinds[0] == kinds[1] != kinds[2]
    assert texts[2] == 'a number is too large (RuntimeWarning of test_logs)'
    assert 'the search has ended' in texts[3] and 'ZeroDivisionError: by hand' in texts[3]
    assert len(heard) == 4


def test_warnings_go_where_they_went_once_nobody_hands_them_on():
    before = warnings.showwarning
    one, other = (LibraryLog(lambda *_: None) for _ in range(2))
    one.close()
    one.close()
    assert warnings.showwarning is not before
    other.close()
    assert warnings.showwarning is before
    logging.captureWarnings(True)
    try:
        captured = warnings.showwarning
        LibraryLog(lambda *_: None).close()
        assert warnings.showwarning is captured
    finally:
        logging.captureWarnings(False)


@pytest.mark.parametrize('kind', ['given', 'home', 'none', 'file'])
def test_ros_logs_to_a_folder_that_can_be_written(monkeypatch, tmp_path, kind):
    for name in ('ROS_LOG_DIR', 'ROS_HOME', 'HOME'):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr('tempfile.tempdir', str(tmp_path))
    (tmp_path / 'file').touch()
    if kind == 'given':
        monkeypatch.setenv('ROS_LOG_DIR', str(tmp_path / 'logs'))
    elif kind != 'none':
        monkeypatch.setenv('HOME', str(tmp_path / kind))
    note = ensure_log_folder()
    if kind in ('given', 'home'):
        assert note == ''
        assert os.environ.get('ROS_LOG_DIR', '') == str(tmp_path / 'logs') * (kind == 'given')
        return
    assert note.startswith(f'log files go to {tmp_path / "ros-log-"}')
    assert ('neither ROS_LOG_DIR nor HOME' in note) == (kind == 'none')
    assert os.path.isdir(os.environ['ROS_LOG_DIR'])
