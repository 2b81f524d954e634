"""Several sensors live: the detector as a process, fed on a topic for each."""

import numpy as np
import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from rclpy.qos import QoSProfile, QoSReliabilityPolicy  # noqa: E402
from sensor_msgs.msg import Image, PointCloud2  # noqa: E402
from std_msgs.msg import Float32MultiArray, Header  # noqa: E402

from track_before_detect import detect_sensors, Sensor  # noqa: E402
from track_before_detect.ros import conversions  # noqa: E402

RATE_HZ, LATER_S = 20.0, 0.02
COMPILES_S = 240.0
OPTIONS = {'threshold': 11.0, 'batch_length': 12, 'hop': 6, 'max_speed_px_s': 20.0}
NAMES, SHAPES, SIGMAS, NOISES = ('left', 'right'), ((24, 30), (30, 26)), (1.0, 1.3), (1.0, 20.0)
# The second sensor is turned by a right angle and sees other places as well.
MAPS = (None, [[0.0, -1.0, 31.0], [1.0, 0.0, 2.0]])
RELIABLE = QoSProfile(depth=100, reliability=QoSReliabilityPolicy.RELIABLE)


def place(stamps):
    """Return where the target is on the plane, (T, 2)."""
    return np.array([9.0, 8.0]) + np.outer(stamps, [11.0, 7.0])


def recorded(n_frames):
    """Return what both sensors see of one target."""
    rng = np.random.default_rng(1)
    sensors = []
    for number, (shape, sigma, noise) in enumerate(zip(SHAPES, SIGMAS, NOISES, strict=True)):
        stamps = np.arange(n_frames) / RATE_HZ + number * LATER_S
        frames = rng.standard_normal((n_frames, *shape))
        rows, columns = np.mgrid[:shape[0], :shape[1]]
        for frame, (x, y) in zip(frames, place(stamps), strict=True):
            if number:
                x, y = y - 2.0, 31.0 - x
            picture = np.exp(-0.5 * ((columns - x)**2 + (rows - y)**2) / sigma**2)
            frame += 5.0 * picture / np.linalg.norm(picture)
        sensors.append(Sensor((noise * frames).astype(np.float32), stamps, MAPS[number], sigma,
                              noise_sigma=noise))
    return sensors


@pytest.fixture
def detector(launch, station):
    """Start a detector for both sensors, the second of which may send arrays."""
    def start(*arguments, message='image'):
        station.listen(PointCloud2, 'trajectories/points')
        station.listen(DiagnosticArray, '/diagnostics')
        told = {**OPTIONS, 'sensors': list(NAMES), 'reliable': 'true', 'queue_length': 200,
                'sensors.right.map': np.ravel(MAPS[1]).tolist(), 'sensors.right.message': message}
        for number, name in enumerate(NAMES):
            told |= dict(zip(
                (f'sensors.{name}.{key}' for key in (
                    'height', 'width', 'psf_sigma_px', 'noise_sigma')),
                (*SHAPES[number], SIGMAS[number], NOISES[number]), strict=True))
            topic = f'{name}/{message if number else "image"}'
            told[f'qos_overrides./{topic}.subscription.depth'] = 100
        given = [item for name, value in told.items() for item in ('-p', f'{name}:={value}')]
        process = launch('detector', *given, *arguments)
        # Its loops may have to be compiled first.
        station.wait_until(lambda: station.diagnostics().get('state') == 'ready', 'readiness',
                           COMPILES_S)
        return process
    return start


def image(frame, stamp_s, frame_id):
    return conversions.image_from_frame(frame, Header(
        stamp=conversions.time_from_seconds(100.0 + stamp_s), frame_id=frame_id))


def test_they_give_what_the_python_call_gives_on_the_same_frames(detector, station):
    detector()
    overlays = station.listen(Image, 'overlay')
    sensors = recorded(12)
    publishers = [station.publisher(Image, f'{name}/image', RELIABLE) for name in NAMES]
    # As they may come: the second sensor is behind by two frames.
    for k in range(14):
        for sensor, publisher, name, row in zip(sensors, publishers, NAMES, (k, k - 2)):
            if 0 <= row < 12:
                publisher.publish(image(sensor.frames[row], sensor.stamps[row], name))
                station.spin_for(0.005)
    found = station.wait_for_diagnostics(batches=3, frames_used=24)
    assert found['frames_refused'] == found['failures'] == found['right.frames_late'] == '0'
    clouds = station.received['trajectories/points']
    station.wait_until(lambda: len(clouds) == 3 and overlays, 'three clouds and an overlay')
    assert {cloud.header.frame_id for cloud in clouds} == {'left'}
    batches = [conversions.points_to_array(cloud) for cloud in clouds]
    # A call of one batch, and one of all three, whose parts are joined.
    [alone] = detect_sensors([Sensor(
        one.frames[:6], 100.0 + one.stamps[:6], one.affine, one.psf_sigma_px,
        noise_sigma=one.noise_sigma) for one in sensors], **OPTIONS).trajectories
    np.testing.assert_allclose(batches[0]['t'], alone.stamps, atol=1e-6)
    for name, values in (('x', alone.positions[:, 0]), ('y', alone.positions[:, 1]),
                         ('vx', alone.velocity[:, 0]), ('amplitude', alone.amplitudes)):
        np.testing.assert_allclose(batches[0][name], values, rtol=1e-4, atol=1e-4)
    assert batches[0]['statistic'] == pytest.approx(alone.statistic, rel=1e-5)
    [joined] = detect_sensors([Sensor(
        one.frames, 100.0 + one.stamps, one.affine, one.psf_sigma_px,
        noise_sigma=one.noise_sigma) for one in sensors], **OPTIONS).trajectories
    live = np.concatenate(batches)
    assert len(set(live['id'])) == 1
    for stamp, (x, y) in zip(joined.stamps, joined.positions, strict=True):
        same = live[np.abs(live['t'] - stamp) < 1e-6]
        assert np.hypot(same['x'] - x, same['y'] - y).min() < 1e-3
    assert (overlays[-1].height, overlays[-1].width) == SHAPES[1]


def test_one_that_stops_or_is_late_or_wrong_does_not_stop_the_other(detector, station):
    process = detector()
    [left, right] = recorded(24)
    publishers = [station.publisher(Image, f'{name}/image', RELIABLE) for name in NAMES]

    def send(sensor, rows, frame=None):
        for row in rows:
            one = (left, right)[sensor]
            publishers[sensor].publish(image(
                one.frames[row] if frame is None else frame, one.stamps[row], NAMES[sensor]))
            station.spin_for(0.005)

    for k in range(7):
        send(0, [k])
        send(1, [k])
    # The last batch holds no frame of the second sensor.
    send(0, range(7, 23))
    station.wait_for_diagnostics(batches=4, frames_used=30)
    found = station.wait_until(
        lambda: float(station.diagnostics()['right.silent_s']) > 0 and station.diagnostics(),
        'silence')
    assert found['left.frames_received'] == '23' and found['right.frames_received'] == '7'
    assert found['failures'] == '0'
    process.wait_for_line('sensor right has sent nothing for .* the others are searched without')
    send(0, [23])
    send(1, [10])
    found = station.wait_for_diagnostics(frames_refused=1)
    assert found['right.frames_late'] == '1'
    send(1, [23], frame=np.ones((4, 4), np.float32))
    station.wait_for_diagnostics(frames_refused=2)
    assert 'sensor right: expected frames of 30 x 26 (height x width), found 4 x 4' in str(
        station.received['/diagnostics'])
    clouds = station.received['trajectories/points']
    points = np.concatenate([conversions.points_to_array(cloud) for cloud in clouds])
    assert len(set(points['id'])) == 1 and points['t'].max() == pytest.approx(101.1)


def test_stamped_arrays_of_one_go_with_images_of_another(detector, station):
    detector(message='frame')
    publishers = [station.publisher(kind, topic, RELIABLE) for kind, topic in (
        (Image, 'left/image'), (Float32MultiArray, 'right/frame'))]
    sensors = recorded(6)
    for k in range(6):
        first, second = (image(one.frames[k], one.stamps[k], 'left') for one in sensors)
        publishers[0].publish(first)
        publishers[1].publish(conversions.multiarray_from_frame(
            sensors[1].frames[k], second.header))
        station.spin_for(0.005)
    station.wait_for_diagnostics(batches=1, frames_used=12)
    clouds = station.received['trajectories/points']
    station.wait_until(lambda: clouds, 'a cloud')
    stamps = np.sort(np.concatenate([one.stamps for one in sensors]))
    np.testing.assert_allclose(conversions.points_to_array(clouds[0])['t'], 100.0 + stamps,
                               atol=1e-6)


def test_what_several_cannot_honour_is_one_sentence_and_exit_code_2(launch):
    told = ['sensors:=[left]', 'sensors.left.height:=24', 'sensors.left.width:=30',
            'preset:=eoir_moving']
    detector = launch('detector', *(item for one in told for item in ('-p', one)))
    assert detector.wait() == 2
    assert 'several sensors cannot honour registration=auto' in detector.output
    assert detector.output.count('\n') == 1
