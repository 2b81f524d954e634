"""What is known of the camera whose frames are searched, as its ``CameraInfo`` tells."""

from collections.abc import Callable

import numpy as np
from sensor_msgs.msg import CameraInfo

from track_before_detect.errors import DataError
from track_before_detect.ros.intake.camera import Camera
from track_before_detect.ros.parameters import NodeParameter

CAMERA_PARAMETERS = [
    NodeParameter(
        'camera_info', '', 'Topic of the sensor_msgs/CameraInfo of the frames, of which the '
        'newest counts: trajectories are then also given as rays and angles of its optical frame. '
        'Empty is none.', 'text'),
    NodeParameter(
        'camera_rectified', False, 'Whether frames are rectified, so that P of the camera info '
        'tells what they show; otherwise K and the distortion do.', 'boolean'),
]
# Of which every ray is not known.
UNKNOWN = Camera((0, 0), '', np.full((3, 3), np.nan), np.eye(3))


def camera_of(info: CameraInfo, rectified: bool) -> Camera:
    """Return the camera that a message tells of.

    Parameters
    ----------
    info : CameraInfo
        K and P are those of the whole sensor, also where frames are binned or a part of it.
    rectified : bool
        Whether frames are what P describes.

    Raises
    ------
    DataError
        The camera is not calibrated, or its distortion is not known.
    """
    binning = (info.binning_x or 1, info.binning_y or 1)
    shape = ((info.roi.height or info.height) // binning[1],
             (info.roi.width or info.width) // binning[0])
    window = (shape, info.header.frame_id)
    within = ((info.roi.x_offset, info.roi.y_offset), binning)
    if rectified:
        projection = np.reshape(info.p, (3, 4))[:, :3]
        return Camera(*window, projection, np.eye(3), 'plumb_bob', (), *within)
    # Left out by cameras that are alone.
    rotation = np.reshape(info.r, (3, 3)) if np.any(info.r) else np.eye(3)
    return Camera(*window, np.reshape(info.k, (3, 3)), rotation,
                  info.distortion_model or 'plumb_bob', info.d, *within)


class CameraInput:
    """Keeps what the newest message says of the camera.

    Parameters
    ----------
    topic : str
        Of the messages.
    rectified : bool
        As of :func:`camera_of`.
    warn : callable
        Takes a kind, for throttling, and a sentence.
    """

    def __init__(self, topic: str, rectified: bool, warn: Callable[[str, str], None]) -> None:
        self._topic = topic
        self._rectified = rectified
        self._warn = warn
        self._camera: Camera | None = None
        # A kind of its own, so that what comes at last is said at once.
        self._missing = 'no camera', f'nothing has come on {topic} yet'

    @property
    def frame_id(self) -> str:
        """The optical frame, empty while it is not known."""
        return self._camera.frame_id if self._camera is not None else ''

    def take(self, message: CameraInfo) -> None:
        """Take a message; what cannot be used is said where rays are asked for."""
        try:
            self._camera = camera_of(message, self._rectified)
        except DataError as error:
            self._camera = None
            self._missing = 'camera', f'{self._topic} cannot be used: {error}'

    def camera(self, shape: tuple[int, int], frame_id: str) -> Camera:
        """Return the camera of frames (H, W), one that knows nothing where it is another's."""
        camera = self._camera
        if camera is None:
            kind, missing = self._missing
        elif camera.shape != shape:
            kind, missing = 'camera size', (
                f'{self._topic} tells of frames of {camera.shape[0]} x {camera.shape[1]} '
                f'(height x width), found {shape[0]} x {shape[1]}')
        else:
            if frame_id != camera.frame_id:
                self._warn('camera frame', f'frames are of {frame_id!r}, and {self._topic} of '
                           f'{camera.frame_id!r}: rays are those of the camera that it tells of')
            return camera
        self._warn(kind, f'{missing}: no rays')
        return UNKNOWN
