"""Between messages and arrays: the one file that knows both.

Positions stay in pixels: in markers, paths and points one metre of ROS stands for one pixel, x to
the right, y down, z = 0. Rays are in metres of the optical frame of a camera.
"""

from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
import math
from typing import Any

from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import Point, PoseStamped
from nav_msgs.msg import Path
import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import Image, PointCloud2, PointField
from std_msgs.msg import (
    ColorRGBA,
    Float32MultiArray,
    Header,
    MultiArrayDimension,
    MultiArrayLayout,
)
from visualization_msgs.msg import Marker, MarkerArray

from track_before_detect.errors import DataError
from track_before_detect.recordings.encodings import decode_image, multiarray_to_frame
from track_before_detect.recordings.overlay import colour_of
from track_before_detect.ros.intake.camera import Camera
from track_before_detect.ros.outputs.bearings import with_bearings
from track_before_detect.ros.outputs.head import HeadTarget
from track_before_detect.types import Trajectory

ENCODING_OF_DTYPE = {'uint8': 'mono8', 'uint16': 'mono16', 'float32': '32FC1', 'float64': '64FC1'}

# The double lies at a multiple of its size.
POINT_DTYPE = np.dtype({
    'names': ['x', 'y', 'z', 't', 'id', 'vx', 'vy', 'amplitude', 'snr', 'statistic', 'var_x',
              'cov_xy', 'var_y'],
    'formats': ['<f4', '<f4', '<f4', '<f8', '<i4', *['<f4'] * 8],
    'offsets': [0, 4, 8, 16, 12, *range(24, 56, 4)], 'itemsize': 56})
# Targets of one moment: the same, and what is known of each.
HEAD_DTYPE = np.dtype({
    'names': [*(POINT_DTYPE.names or ()), 'state'],
    'formats': ['<f4', '<f4', '<f4', '<f8', '<i4', *['<f4'] * 8, '<i4'],
    'offsets': [0, 4, 8, 16, 12, *range(24, 60, 4)], 'itemsize': 64})
_POINT_FIELD_TYPES = {
    'f4': PointField.FLOAT32, 'f8': PointField.FLOAT64, 'i4': PointField.INT32}

LINE_WIDTH_PX = 0.75
LABEL_HEIGHT_PX = 5.0
RAY_WIDTH_M = 0.005
LONGEST_LIFETIME_S = 2.0**31 - 1


def seconds_from_time(stamp: Time) -> float:
    """Return a time stamp in seconds (float64: 0.2 microseconds exact in our century)."""
    return stamp.sec + 1e-9 * stamp.nanosec


def time_from_seconds(seconds: float) -> Time:
    """Return the time stamp nearest to ``seconds``."""
    whole = math.floor(seconds)
    # The product of the whole number and 1e9 would not fit the digits of a double.
    carry, nanosec = divmod(round((seconds - whole) * 1e9), 10**9)
    sec = whole + carry
    if not -2**31 <= sec < 2**31:
        raise DataError(f'a time stamp must be within 2^31 s of zero, got {seconds:g} s')
    return Time(sec=sec, nanosec=nanosec)


def frame_from_image(message: Image) -> NDArray:
    """Return the pixels of an image, shape (H, W), colour as luminance."""
    return decode_image(message.data, message.encoding, message.height, message.width,
                        message.step, message.is_bigendian)


def frame_from_multiarray(message: Float32MultiArray,
                          shape: tuple[int, int] | None = None) -> NDArray:
    """Return the frame in a multi-array, shape (H, W): that of its layout, or the one told.

    Parameters
    ----------
    message : Float32MultiArray
        The layout names rows and columns, or nothing.
    shape : tuple of int, optional
        Height and width where the layout names nothing.
    """
    sizes = [dim.size for dim in message.layout.dim]
    strides = [dim.stride for dim in message.layout.dim]
    if not sizes and shape is not None:
        sizes, strides = list(shape), [0, 0]
    return multiarray_to_frame(
        np.frombuffer(message.data, np.float32), sizes, strides, message.layout.data_offset)


def sendable(frame: NDArray) -> NDArray:
    """Return a frame in the smallest type that an image can carry without loss."""
    if np.iscomplexobj(frame):
        raise DataError('complex frames cannot be sent as images; send their magnitude')
    if frame.dtype.name in ENCODING_OF_DTYPE:
        return frame
    for name in ENCODING_OF_DTYPE:
        if np.can_cast(frame.dtype, name):
            return frame.astype(name)
    return frame.astype(np.float64)


def image_from_frame(frame: NDArray, header: Header) -> Image:
    """Return an image of mono8, mono16, 32FC1 or 64FC1, by the type of the pixels.

    Parameters
    ----------
    frame : array, shape (H, W)
        uint8, uint16, float32 or float64; see :func:`sendable`.
    header : Header
        Stamp and coordinate frame.
    """
    height, width = frame.shape
    stored = np.ascontiguousarray(frame, frame.dtype.newbyteorder('<'))
    message = Image(header=header, height=height, width=width,
                    encoding=ENCODING_OF_DTYPE[frame.dtype.name], is_bigendian=0,
                    step=width * frame.dtype.itemsize)
    message.data = _octets(stored)
    return message


def image_from_colours(pixels: NDArray[np.uint8], header: Header) -> Image:
    """Return an rgb8 image of pixels, shape (H, W, 3)."""
    height, width, _ = pixels.shape
    message = Image(header=header, height=height, width=width, encoding='rgb8', is_bigendian=0,
                    step=3 * width)
    message.data = _octets(pixels)
    return message


def multiarray_from_frame(frame: NDArray, header: Header | None = None) -> Float32MultiArray:
    """Return a multi-array with rows and columns named in its layout.

    Parameters
    ----------
    frame : array, shape (H, W)
        Real numbers.
    header : Header, optional
        Stamp and coordinate frame, which take the place of the name of the rows.
    """
    height, width = frame.shape
    data = array('f')
    data.frombytes(np.ascontiguousarray(frame, np.float32).tobytes())
    layout = MultiArrayLayout(data_offset=0, dim=[
        MultiArrayDimension(label='rows' if header is None else stamp_label(header), size=height,
                            stride=height * width),
        MultiArrayDimension(label='columns', size=width, stride=width)])
    message = Float32MultiArray(layout=layout)
    message.data = data
    return message


def stamp_label(header: Header) -> str:
    """Return the label of a dimension of an array that stamps it; see :func:`multiarray_stamp`."""
    named = f' frame_id={header.frame_id}' if header.frame_id else ''
    return f'stamp={header.stamp.sec}.{header.stamp.nanosec:09d}{named}'


def paths_from_trajectories(
        trajectories: Iterable[Trajectory], header: Header,
        stamps: Mapping[int, Time] | None = None) -> list[Path]:
    """Return one path per trajectory, with a stamped pose for each frame it is present in.

    Parameters
    ----------
    trajectories : iterable of Trajectory
        What was found.
    header : Header
        Of the newest frame.
    stamps : mapping from frame index to Time, optional
        The frames' own stamps; a frame that is missing gets the nearest nanosecond.
    """
    return [
        Path(header=header, poses=[
            _pose(position, _stamp(trajectory, row, stamps), header.frame_id)
            for row, position in _present(trajectory)])
        for trajectory in trajectories]


def path_from_positions(positions: NDArray, stamps_s: Iterable[float], header: Header) -> Path:
    """Return a path through positions (T, 2) at the given seconds."""
    return Path(header=header, poses=[
        _pose(position, time_from_seconds(second), header.frame_id)
        for position, second in zip(positions, stamps_s, strict=True)])


def points_from_trajectories(trajectories: Iterable[Trajectory], header: Header,
                             camera: Camera | None = None) -> PointCloud2:
    """Return one point per trajectory and frame it is present in.

    Fields: x and y in pixels, z = 0, t in seconds since the epoch of the stamps (float64), id, vx
    and vy in pixels per second, amplitude (the magnitude), snr and statistic (of the whole
    trajectory), var_x, cov_xy and var_y in pixels squared (NaN where not known). With a camera
    also those of :func:`with_bearings`.
    """
    rows = [
        (*position, 0.0, trajectory.stamps[row], trajectory.id, *trajectory.velocity[row],
         abs(trajectory.amplitudes[row]), trajectory.snr, trajectory.statistic,
         *trajectory.covariance[row][np.triu_indices(2)])
        for trajectory in trajectories for row, position in _present(trajectory)]
    return _cloud(with_bearings(np.array(rows, POINT_DTYPE), camera), header)


def points_from_head(targets: Iterable[HeadTarget], header: Header,
                     camera: Camera | None = None) -> PointCloud2:
    """Return one point per target at one moment.

    Fields are those of :func:`points_from_trajectories` and ``state``, see :class:`State`.
    """
    rows = [(*target.position, 0.0, target.stamp_s, target.id, *target.velocity, target.amplitude,
             target.snr, target.statistic, *target.covariance[np.triu_indices(2)], target.state)
            for target in targets]
    return _cloud(with_bearings(np.array(rows, HEAD_DTYPE), camera), header)


def _cloud(points: NDArray, header: Header) -> PointCloud2:
    """Return a cloud of structured points, shape (N,), of the names and types of their fields."""
    dtype = points.dtype
    fields = []
    offsets: Mapping[str, Any] = dtype.fields or {}
    for name in dtype.names or ():
        kind, offset = offsets[name][:2]
        fields.append(PointField(name=name, offset=offset, count=1,
                                 datatype=_POINT_FIELD_TYPES[kind.str[1:]]))
    message = PointCloud2(
        header=header, height=1, width=len(points), fields=fields, is_bigendian=False,
        point_step=dtype.itemsize, row_step=dtype.itemsize * len(points), is_dense=True)
    message.data = _octets(points)
    return message


def points_to_array(message: PointCloud2) -> NDArray:
    """Return the points of a cloud as a structured array, whatever its fields.

    Parameters
    ----------
    message : PointCloud2
        With fields of one 32- or 64-bit number each, as ``trajectories/points`` has.

    Raises
    ------
    DataError
        A field is of another type, or the data do not hold what the message says.
    """
    order = '>' if message.is_bigendian else '<'
    codes = {code: kind for kind, code in _POINT_FIELD_TYPES.items()}
    for field in message.fields:
        if field.datatype not in codes or field.count != 1:
            raise DataError(f'field {field.name!r} of the cloud is of type {field.datatype} x '
                            f'{field.count}, expected a float32, float64 or int32')
    n_points = message.width * message.height
    if message.point_step * n_points > len(message.data):
        raise DataError(f'a cloud of {message.width} x {message.height} points of '
                        f'{message.point_step} bytes each holds {len(message.data)} bytes')
    try:
        dtype = np.dtype({
            'names': [field.name for field in message.fields],
            'formats': [order + codes[field.datatype] for field in message.fields],
            'offsets': [field.offset for field in message.fields],
            'itemsize': message.point_step})
    except ValueError as error:
        raise DataError(f'the fields of a cloud with points of {message.point_step} bytes do not '
                        f'fit: {error}') from error
    return np.frombuffer(message.data, dtype, count=n_points).copy()


def trajectories_from_points(message: PointCloud2) -> list[Trajectory]:
    """Return the trajectories in a cloud of :func:`points_from_trajectories`.

    Frames in which a target is absent are left out; numbers of frames are not in the cloud, so
    that those of each trajectory begin at 0.

    Raises
    ------
    DataError
        The cloud has other fields, or places and times that are none.
    """
    points = points_to_array(message)
    needed = [name for name in POINT_DTYPE.names or () if name != 'z']
    missing = [name for name in needed if name not in (points.dtype.names or ())]
    if missing:
        raise DataError(f'a cloud of trajectories must have the fields {", ".join(needed)}; '
                        f'missing: {", ".join(missing)}')
    known = np.isfinite(points['x']) & np.isfinite(points['y']) & (np.abs(points['t']) < 2**31)
    if not known.all():
        x, y, t = (points[name][~known][0] for name in ('x', 'y', 't'))
        raise DataError('a point of a trajectory must have finite x and y, and t within 2^31 s of '
                        f'zero, got x {x:g}, y {y:g}, t {t:g}')
    found = []
    for number in dict.fromkeys(points['id'].tolist()):
        own = points[points['id'] == number]

        def columns(*names: str, own: NDArray = own) -> NDArray[np.float64]:
            return np.stack([own[name].astype(float) for name in names], axis=-1)

        found.append(Trajectory(
            number, columns('x', 'y'), own['amplitude'].astype(float), columns('vx', 'vy'),
            own['t'].astype(float), np.arange(len(own)), float(own['statistic'][0]),
            float(own['snr'][0]), covariance=columns(
                'var_x', 'cov_xy', 'cov_xy', 'var_y').reshape(-1, 2, 2)))
    return found


def markers_from_trajectories(
        trajectories: Iterable[Trajectory], header: Header, lifetime_s: float,
        ended: Iterable[int] = ()) -> MarkerArray:
    """Return a line and a label per trajectory, and the removal of those that ended.

    Parameters
    ----------
    trajectories : iterable of Trajectory
        What is there; ids of markers are theirs.
    header : Header
        Of the newest frame.
    lifetime_s : float
        After which a viewer drops a marker that was not renewed.
    ended : iterable of int
        Ids of trajectories shown before that are no more.
    """
    lifetime = _lifetime(lifetime_s)
    markers = []
    for trajectory in trajectories:
        points = [_point(position) for _, position in _present(trajectory)]
        if not points:
            continue
        # A line of a single point is not drawn.
        points = points if len(points) > 1 else points * 2
        colour = _colour(trajectory.id)
        line = Marker(header=header, ns='trajectory', id=trajectory.id, type=Marker.LINE_STRIP,
                      action=Marker.ADD, points=points, color=colour, lifetime=lifetime)
        line.scale.x = LINE_WIDTH_PX
        line.pose.orientation.w = 1.0
        label = Marker(header=header, ns='label', id=trajectory.id,
                       type=Marker.TEXT_VIEW_FACING, action=Marker.ADD, color=colour,
                       lifetime=lifetime, text=f'{trajectory.id}  SNR {trajectory.snr:.1f}')
        label.scale.z = LABEL_HEIGHT_PX
        label.pose.position = _point((points[-1].x, points[-1].y - LABEL_HEIGHT_PX))
        label.pose.orientation.w = 1.0
        markers += [line, label]
    return MarkerArray(markers=markers + _deleted(ended, header, ('trajectory', 'label')))


def rays_from_trajectories(
        trajectories: Iterable[Trajectory], header: Header, camera: Camera, lifetime_s: float,
        ended: Iterable[int] = ()) -> MarkerArray:
    """Return a ray of one metre per trajectory, from the camera to where it was seen last.

    Parameters
    ----------
    camera : Camera
        Whose frame that of the header is.
    trajectories, header, lifetime_s, ended
        As of :func:`markers_from_trajectories`.
    """
    markers = []
    for trajectory in trajectories:
        seen = [position for _, position in _present(trajectory)]
        [ray] = camera.rays(seen[-1]) if seen else [np.full(3, np.nan)]
        if not np.isfinite(ray).all():
            continue
        marker = Marker(header=header, ns='ray', id=trajectory.id, type=Marker.LINE_STRIP,
                        action=Marker.ADD, color=_colour(trajectory.id),
                        lifetime=_lifetime(lifetime_s))
        marker.points = [Point(), Point(**dict(zip('xyz', ray.tolist(), strict=True)))]
        marker.scale.x = RAY_WIDTH_M
        marker.pose.orientation.w = 1.0
        markers.append(marker)
    return MarkerArray(markers=markers + _deleted(ended, header, ('ray',)))


def _lifetime(seconds: float) -> Duration:
    # A duration of ROS holds no more.
    seconds = min(seconds, LONGEST_LIFETIME_S)
    return Duration(sec=int(seconds), nanosec=int(seconds % 1.0 * 1e9))


def _deleted(identities: Iterable[int], header: Header, namespaces: Sequence[str],
             ) -> list[Marker]:
    return [Marker(header=header, ns=ns, id=identity, action=Marker.DELETE)
            for identity in identities for ns in namespaces]


def _octets(values: NDArray) -> array:
    # rclpy checks other types item by item, and in the constructor even this one.
    octets = array('B')
    octets.frombytes(values.tobytes())
    return octets


def _present(trajectory: Trajectory) -> Iterator[tuple[int, NDArray]]:
    """Yield row number and position of every frame the target is present in."""
    for row, position in enumerate(trajectory.positions):
        if np.isfinite(position).all():
            yield row, position


def _stamp(trajectory: Trajectory, row: int, stamps: Mapping[int, Time] | None) -> Time:
    index = int(trajectory.frame_indices[row])
    if stamps is not None and index in stamps:
        return stamps[index]
    return time_from_seconds(float(trajectory.stamps[row]))


def _point(position: Sequence[float] | NDArray) -> Point:
    return Point(x=float(position[0]), y=float(position[1]), z=0.0)


def _pose(position: NDArray, stamp: Time, frame_id: str) -> PoseStamped:
    pose = PoseStamped(header=Header(stamp=stamp, frame_id=frame_id))
    pose.pose.position = _point(position)
    pose.pose.orientation.w = 1.0
    return pose


def _colour(identity: int) -> ColorRGBA:
    red, green, blue = (channel / 255 for channel in colour_of(identity))
    return ColorRGBA(r=red, g=green, b=blue, a=1.0)
