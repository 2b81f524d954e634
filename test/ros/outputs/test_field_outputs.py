"""The detector publishes messages of the field where their package can be found, over DDS."""

import math
from uuid import UUID

import numpy as np
import pytest

pytest.importorskip('rclpy')

from rclpy.qos import QoSProfile, QoSReliabilityPolicy  # noqa: E402
from sensor_msgs.msg import Image, PointCloud2  # noqa: E402
from std_msgs.msg import Header  # noqa: E402

from track_before_detect.ros import conversions  # noqa: E402

RELIABLE = QoSProfile(depth=100, reliability=QoSReliabilityPolicy.RELIABLE)
N_FRAMES, SHAPE, ROW, RATE_HZ = 20, (32, 40), 15.3, 25.0


def stamp_s(message):
    return conversions.seconds_from_time(message.header.stamp)


def test_radar_tracks_come_once_for_each_frame_in_metres(sent_radar_msgs, launch, station):
    tracks = station.listen(sent_radar_msgs.RadarTracks, 'trajectories/radar_tracks')
    points = station.listen(PointCloud2, 'trajectories/points')
    options = {'threshold': 12.0, 'batch_length': 10, 'hop': 5, 'max_speed_px_s': 25.0,
               'frame_height': SHAPE[0], 'frame_width': SHAPE[1], 'frame_rate_hz': RATE_HZ,
               'reliable': 'true', 'range_m_per_row': 2.0, 'range_of_first_row_m': 100.0,
               'bearing_rad_per_column': 0.01}
    detector = launch('detector', *(word for name, value in options.items()
                                    for word in ('-p', f'{name}:={value}')))
    detector.wait_for_line('ready: .*threshold')
    station.wait_until(lambda: all(map(station.node.count_publishers, station.received)),
                       'the outputs of the detector')
    publisher = station.publisher(Image, 'image', RELIABLE)
    y, x = np.mgrid[:SHAPE[0], :SHAPE[1]]
    noise = np.random.default_rng(1).standard_normal((N_FRAMES, *SHAPE))
    stamps = 50.0 + np.arange(N_FRAMES) / RATE_HZ
    columns = 8.2 + 0.6 * np.arange(N_FRAMES)
    for stamp, column, pixels in zip(stamps, columns, noise, strict=True):
        seen = pixels + 12 * np.exp(-0.5 * ((x - column)**2 + (y - ROW)**2))
        header = Header(stamp=conversions.time_from_seconds(stamp), frame_id='radar')
        publisher.publish(conversions.image_from_frame(seen.astype(np.float32), header))
    station.wait_until(lambda: len(tracks) >= N_FRAMES and len(points) >= 3, 'all tracks')
    station.spin_for(0.2)
    np.testing.assert_allclose([stamp_s(message) for message in tracks], stamps, atol=1e-6)
    assert {message.header.frame_id for message in tracks} == {'radar'}
    assert len({UUID(bytes=bytes(one.uuid.uuid)) for message in tracks
                for one in message.tracks}) == 1
    for message, column in zip(tracks, columns, strict=True):
        [one] = message.tracks
        assert math.atan2(one.position.y, one.position.x) == pytest.approx(
            0.01 * column, abs=0.005)
        assert math.hypot(one.position.x, one.position.y) == pytest.approx(
            100 + 2 * ROW, abs=1.0)
        assert 0 < one.position_covariance[0] < 1
