"""Targets of a frame as messages of packages that need not be installed.

Each function is handed the module that holds the message classes of its package.
"""

from collections.abc import Sequence
from types import ModuleType
from uuid import UUID, uuid5

from geometry_msgs.msg import Point, Vector3
import numpy as np
from std_msgs.msg import Header

from track_before_detect.recordings.overlay import colour_of
from track_before_detect.ros.outputs.seen_targets import RadarScale, SeenTarget

# Of a PoseWithCovariance (6, 6): xx, xy, yx, yy.
_IN_PLANE = [0, 1, 6, 7]
CLASS_ID = 'target'
# Foxglove's pixel (0, 0) is the corner of the first pixel, ours its centre.
CORNER_TO_CENTRE = 0.5
LINE_PX = 1.0
TEXT_PX = 10.0


def detections_2d(vision_msgs: ModuleType, targets: Sequence[SeenTarget], header: Header,
                  box_px: float) -> object:
    """Return a ``vision_msgs/Detection2DArray``; pixel centres are integers.

    The id is that of the trajectory; the covariance of the position is that of the pose of its
    only result, whose score is one: it has passed the threshold.

    Parameters
    ----------
    vision_msgs : module
        ``vision_msgs.msg``.
    targets : sequence of SeenTarget
        Those of the frame.
    header : Header
        Of the frame.
    box_px : float
        Side of the box around each.
    """
    detections = []
    for target in targets:
        x, y = target.position.tolist()
        result = vision_msgs.ObjectHypothesisWithPose()
        result.hypothesis.class_id, result.hypothesis.score = CLASS_ID, 1.0
        result.pose.pose.position = Point(x=x, y=y, z=0.0)
        covariance = np.zeros(36)
        covariance[_IN_PLANE] = target.covariance.ravel()
        result.pose.covariance = covariance
        detection = vision_msgs.Detection2D(header=header, id=str(target.id), results=[result])
        detection.bbox.center.position.x, detection.bbox.center.position.y = x, y
        detection.bbox.size_x = detection.bbox.size_y = float(box_px)
        detections.append(detection)
    return vision_msgs.Detection2DArray(header=header, detections=detections)


def radar_tracks(radar_msgs: ModuleType, targets: Sequence[SeenTarget], header: Header,
                 scale: RadarScale, still_column: float, period_columns: int,
                 stream: UUID) -> object:
    """Return ``radar_msgs/RadarTracks`` in metres: x ahead, y to the left; NaN: not known.

    Parameters
    ----------
    radar_msgs : module
        ``radar_msgs.msg``.
    targets, header
        As of :func:`detections_2d`.
    scale : RadarScale
        What rows and columns are.
    still_column, period_columns
        As of :meth:`RadarScale.motion`.
    stream : UUID
        Of the run of the node: the ids of its trajectories are unique within.
    """
    tracks = []
    unknown = np.full(6, np.nan, np.float32)
    for target in targets:
        motion = scale.motion(target, still_column, period_columns)
        upper = np.triu_indices(3)
        track = radar_msgs.RadarTrack(
            position=Point(**dict(zip('xyz', motion.position.tolist(), strict=True))),
            velocity=Vector3(**dict(zip('xyz', motion.velocity.tolist(), strict=True))),
            classification=radar_msgs.RadarTrack.DYNAMIC,
            position_covariance=motion.position_covariance[upper].astype(np.float32),
            velocity_covariance=motion.velocity_covariance[upper].astype(np.float32),
            acceleration_covariance=unknown, size_covariance=unknown)
        track.uuid.uuid = np.frombuffer(uuid5(stream, str(target.id)).bytes, np.uint8)
        tracks.append(track)
    return radar_msgs.RadarTracks(header=header, tracks=tracks)


def image_annotations(foxglove_msgs: ModuleType, targets: Sequence[SeenTarget], header: Header,
                      box_px: float) -> object:
    """Return ``foxglove_msgs/ImageAnnotations``: a circle and the id of each target.

    Parameters
    ----------
    foxglove_msgs : module
        ``foxglove_msgs.msg``.
    targets, header, box_px
        As of :func:`detections_2d`; the circle is as wide as the box.
    """
    circles, texts = [], []
    for target in targets:
        x, y = (target.position + CORNER_TO_CENTRE).tolist()
        red, green, blue = (channel / 255 for channel in colour_of(target.id))
        colour = foxglove_msgs.Color(r=red, g=green, b=blue, a=1.0)
        circles.append(foxglove_msgs.CircleAnnotation(
            timestamp=header.stamp, position=foxglove_msgs.Point2(x=x, y=y),
            diameter=float(box_px), thickness=LINE_PX, outline_color=colour))
        texts.append(foxglove_msgs.TextAnnotation(
            timestamp=header.stamp, text=f'{target.id}  SNR {target.snr:.1f}', font_size=TEXT_PX,
            text_color=colour,
            position=foxglove_msgs.Point2(x=x + 0.5 * box_px, y=y - 0.5 * box_px)))
    return foxglove_msgs.ImageAnnotations(circles=circles, texts=texts)
