"""The node shows its search on rerun, beside it, and goes on where it cannot."""

from functools import partial
import signal
import sys
import threading
import time
from urllib.error import URLError
from urllib.request import urlopen

import numpy as np
import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from lifecycle_msgs.msg import Transition  # noqa: E402
from lifecycle_msgs.srv import ChangeState  # noqa: E402
import rclpy  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import QoSProfile, QoSReliabilityPolicy  # noqa: E402
from sensor_msgs.msg import Image, PointCloud2  # noqa: E402
from std_msgs.msg import Header  # noqa: E402

from track_before_detect.errors import ParameterError  # noqa: E402
from track_before_detect.options import DetectorOptions  # noqa: E402
from track_before_detect.ros import conversions  # noqa: E402
from track_before_detect.ros.detector_node import DetectorNode  # noqa: E402
from track_before_detect.ros.outputs.stream_view import check_view, StreamView  # noqa: E402
from track_before_detect.ros.search_results import StreamResult  # noqa: E402
from track_before_detect.tracking.pipeline import TrackingPipeline  # noqa: E402
from track_before_detect.types import FrameBatch  # noqa: E402
from views.page import make_clip, opened_page, RATE_HZ, SHAPE, wait_until_shown  # noqa: E402
from views.rows import rows_of  # noqa: E402

RELIABLE = QoSProfile(depth=100, reliability=QoSReliabilityPolicy.RELIABLE)
# A threshold of its own saves the calibration.
OPTIONS = {'threshold': 12.0, 'batch_length': 20, 'hop': 10, 'background': 'temporal_median',
           'noise': 'robust'}
PARAMETERS = {**OPTIONS, 'preset': 'none', 'queue_length': 100, 'reliable': True,
              'frame_height': SHAPE[0], 'frame_width': SHAPE[1], 'frame_rate_hz': RATE_HZ,
              'qos_overrides./image.subscription.depth': 100}
ARGUMENTS = [part for name, value in PARAMETERS.items() for part in ('-p', f'{name}:={value}')]
TIMEOUT_S = 60.0


def send(station, publisher, frames, first=0):
    for k, frame in enumerate(frames, first):
        stamp = conversions.time_from_seconds(100.0 + k / RATE_HZ)
        publisher.publish(conversions.image_from_frame(frame, Header(stamp=stamp)))
        station.spin_for(0.005)


def answers(address):
    """Return whether a page is served."""
    try:
        return urlopen(address.partition('?')[0], timeout=5).status == 200
    except (URLError, ConnectionError):
        return False


def wait_until_gone(address):
    end_s = time.monotonic() + TIMEOUT_S
    while answers(address):
        assert time.monotonic() < end_s
        time.sleep(0.05)


def searched(view, first):
    """Search a batch of the clip from a frame on, as a view sees it; return the result."""
    frames, _ = make_clip()
    numbers = np.arange(first, first + OPTIONS['batch_length'])
    batch = FrameBatch(frames[numbers], numbers / RATE_HZ, numbers)
    found = TrackingPipeline(DetectorOptions(**OPTIONS), observe=view.observe).process(batch)
    return StreamResult(found, batch, {}, 1 / RATE_HZ, OPTIONS['hop'])


def grown(path, size):
    return path.stat().st_size > size


def wait_until_taken(view):
    end_s = time.monotonic() + TIMEOUT_S
    while view.next is not None and time.monotonic() < end_s:
        time.sleep(0.01)


def end_of(view):
    """End a view once it has shown what it was handed."""
    wait_until_taken(view)
    view.close()
    assert view.join(TIMEOUT_S)


def test_a_file_shows_what_the_node_searches_and_is_whole_after_cleanup(launch, station, tmp_path):
    pytest.importorskip('rerun', reason='the extra [view] is missing')
    saved = tmp_path / 'a.rrd'
    detector = launch('detector', *ARGUMENTS, '-p', f'view:={saved}')
    detector.wait_for_line(f'view: {saved}')
    station.listen(DiagnosticArray, '/diagnostics')
    publisher = station.publisher(Image, 'image', RELIABLE)
    frames, positions = make_clip()
    send(station, publisher, frames[:10])
    for k in range(10, len(frames), 10):
        size = saved.stat().st_size
        send(station, publisher, frames[k:k + 10], k)
        station.wait_for_diagnostics(frames_used=k + 10, batches=k // 10)
        # Nothing else tells that a batch is shown; one that comes before that may be left out.
        station.wait_until(partial(grown, saved, size), 'a batch in the file')
        size = 0
        while size < (size := saved.stat().st_size):
            station.spin_for(0.5)
    request = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_DEACTIVATE))
    assert station.call(ChangeState, 'detector/change_state', request).success
    request.transition.id = Transition.TRANSITION_CLEANUP
    assert station.call(ChangeState, 'detector/change_state', request).success
    rows = rows_of(saved)
    for name in ('frame', 'residual/temporal_median', 'matched_filter/temporal_median',
                 'frame/trajectories'):
        assert sorted(rows[f'/{name}']) == list(range(len(frames))), name
    for number, position in enumerate(positions):
        shown = rows['/frame/trajectories'][number]
        np.testing.assert_allclose(shown['centers'], [position + 0.5], atol=0.6)
        assert shown['labels'][0].startswith('1  ')
    for name in ('threshold', 'strongest_path'):
        assert sorted(rows[f'/statistic/temporal_median/{name}']) == [19, 29, 39]
    assert {row['scalars'][0] for row in rows['/statistic/temporal_median/threshold'].values()
            } == {12.0}
    assert detector.interrupt() == 0


@pytest.mark.parametrize('ends', ['cleanup', 'interrupt', 'kill'])
def test_a_page_ends_with_the_search_and_with_the_process(launch, station, ends):
    pytest.importorskip('rerun', reason='the extra [view] is missing')
    detector = launch('detector', *ARGUMENTS, '-p', 'view:=web')
    address = detector.wait_for_line(r'view: (http://127\.0\.0\.1\S+)')[1]
    assert answers(address)
    if ends == 'cleanup':
        for transition in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP):
            request = ChangeState.Request(transition=Transition(id=transition))
            assert station.call(ChangeState, 'detector/change_state', request).success
    elif ends == 'interrupt':
        began_s = time.monotonic()
        assert detector.interrupt() == 0
        assert time.monotonic() - began_s < 2.0
    else:
        assert detector.interrupt(signal.SIGKILL) != 0
    wait_until_gone(address)
    assert 'Traceback' not in detector.output and 'rror' not in detector.output


def test_the_search_goes_on_when_the_page_is_gone(launch, station):
    psutil = pytest.importorskip('psutil', reason='psutil is missing')
    pytest.importorskip('rerun', reason='the extra [view] is missing')
    station.listen(DiagnosticArray, '/diagnostics')
    detector = launch('detector', *ARGUMENTS, '-p', 'view:=web')
    detector.wait_for_line('view: http')
    publisher = station.publisher(Image, 'image', RELIABLE)
    server = psutil.Process(detector.process.pid).children(recursive=True)
    for one in server:
        one.kill()
    frames, _ = make_clip()
    send(station, publisher, frames)
    assert station.wait_for_diagnostics(batches=3)['failures'] == '0'
    detector.wait_for_line('the node goes on without view: ')
    assert detector.interrupt() == 0


def test_without_rerun_the_node_says_so_in_a_sentence_and_goes_on(
        ros_domain, station, monkeypatch):
    monkeypatch.setitem(sys.modules, 'rerun', None)
    context = rclpy.Context()
    context.init(domain_id=int(ros_domain))
    executor = SingleThreadedExecutor(context=context)
    clouds = station.listen(PointCloud2, 'trajectories/points')
    station.listen(DiagnosticArray, '/diagnostics')
    detector = DetectorNode('detector', context=context, parameter_overrides=[
        Parameter(name, value=value) for name, value in {**PARAMETERS, 'view': 'web'}.items()])
    executor.add_node(detector)
    spinning = threading.Thread(target=executor.spin)
    spinning.start()
    try:
        station.wait_for_diagnostics(last_warning=(
            "the node goes on without view: it needs rerun: pip install "
            "'track_before_detect[view]'"))
        send(station, station.publisher(Image, 'image', RELIABLE), make_clip()[0][:20])
        station.wait_until(lambda: clouds, 'a cloud')
    finally:
        executor.shutdown()
        spinning.join()
        detector.destroy_node()
        context.try_shutdown()


def test_of_batches_that_wait_the_newest_is_shown_and_nobody_waits_for_it(tmp_path):
    pytest.importorskip('rerun', reason='the extra [view] is missing')
    said, go_on = [], threading.Event()
    view = StreamView(str(tmp_path / 'a.rrd'), lambda _: go_on.wait(TIMEOUT_S),
                      lambda *words: said.append(words))
    view.start()
    for first in (0, 10, 20):
        view.show(searched(view, first))
    go_on.set()
    end_of(view)
    assert sorted(rows_of(tmp_path / 'a.rrd')['/frame']) == list(range(20, 40))
    assert said == [('left out', f'{n} batches were not shown so far in the view, which gives '
                     'way to the search') for n in (1, 2)]


def test_where_the_search_is_late_a_batch_is_shown_now_and_then(tmp_path):
    pytest.importorskip('rerun', reason='the extra [view] is missing')
    said = []
    view = StreamView(str(tmp_path / 'a.rrd'), lambda _: None, lambda *words: said.append(words))
    first, second = searched(view, 0), searched(view, 20)
    view.show(first, is_late=True)
    wait_until_taken(view)
    for _ in range(2):
        view.show(second, is_late=True)
    end_of(view)
    assert [words.partition(' ')[0] for _, words in said] == ['1', '2']
    assert sorted(rows_of(tmp_path / 'a.rrd')['/frame/trajectories']) == list(range(20))


@pytest.mark.parametrize(('where', 'fragment'), [
    ('wbe', "view must be web or end with .rrd, got 'wbe'"),
    ('no/such/a.rrd', 'folder no/such of view does not exist')])
def test_what_cannot_be_shown_is_refused_at_the_start(where, fragment):
    with pytest.raises(ParameterError, match=fragment):
        check_view({'view': where})


def test_a_page_shows_the_trajectory_of_a_running_node_where_it_is(launch, station, tmp_path):
    pytest.importorskip('rerun', reason='the extra [view] is missing')
    detector = launch('detector', *ARGUMENTS, '-p', 'view:=web')
    address = detector.wait_for_line(r'view: (http://127\.0\.0\.1\S+)')[1]
    publisher = station.publisher(Image, 'image', RELIABLE)
    frames, positions = make_clip()
    with opened_page(address) as page:
        send(station, publisher, frames[:30])
        wait_until_shown(page, frames[29], positions[10:30], 1, tmp_path)
        send(station, publisher, frames[30:], 30)
        wait_until_shown(page, frames[39], positions[20:], 1, tmp_path)
    assert detector.interrupt() == 0
