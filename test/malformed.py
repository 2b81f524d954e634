"""Messages that are wrong in one way or another, beside some that only look so."""

import numpy as np
from sensor_msgs.msg import Image
from std_msgs.msg import Float32MultiArray, Header, MultiArrayDimension

from track_before_detect.recordings.encodings import ENCODINGS

LARGEST = 2**32 - 1
STRANGE = ['', 'nv12', '64FC3', 'mono8 ', 'ü', 'x' * 300]
VALUES = [0.0, 1.0, -1e38, 1e38, np.nan, np.inf, -np.inf, 1e-45]
LABELS = ['', 'rows', 'stamp=', 'stamp=1', 'stamp=9999999999.000000000', 'stamp=-1.000000000',
          'stamp=100.000000001 frame_id=', 'stamp=nan', 'stamp=5.5 frame_id=a b', 'ü' * 300]


def wild(rng, shape):
    """Return a message of frames, of ``shape`` at times, that may be anything."""
    return (_image, _array)[rng.integers(2)](rng, shape)


def _image(rng, shape):
    encoding = str(rng.choice([*ENCODINGS, *STRANGE]))
    height, width = shape if rng.random() < 0.3 else _sizes(rng, 2)
    message = Image(
        header=_header(rng), height=height, width=width, encoding=encoding,
        step=int(rng.choice([width, 4 * width, 8 * width, *_sizes(rng, 2)]) & LARGEST),
        is_bigendian=int(rng.integers(256)))
    # Of the right size, or not, and of values that no camera has.
    n_bytes = int(rng.choice([min(message.step * height, 10**5), rng.integers(1000)]))
    message.data = rng.choice([rng.bytes(n_bytes), np.full(
        n_bytes // 4 + 1, rng.choice(VALUES), np.float32).tobytes()[:n_bytes]])
    return message


def _array(rng, shape):
    message = Float32MultiArray()
    sizes = list(shape) if rng.random() < 0.3 else _sizes(rng, rng.integers(5))
    message.layout.data_offset = int(rng.choice([0, 0, 3, LARGEST]))
    message.layout.dim = [MultiArrayDimension(
        label=str(rng.choice(LABELS)), size=size, stride=int(rng.choice([0, size, *shape])))
        for size in sizes]
    n_items = int(rng.choice([np.prod(shape), rng.integers(2000)]))
    message.data = np.full(n_items, rng.choice(VALUES), np.float32).tolist()
    return message


def malformed(rng, shape):
    """Return an image that cannot be a frame."""
    message = _image(rng, shape)
    flaw = rng.integers(5)
    if flaw == 0:
        message.encoding = str(rng.choice(STRANGE))
    elif flaw == 1:
        message.step = 0
    elif flaw == 2:
        message.data = b''
    elif flaw == 3:
        message.height, message.width = [0, message.width][::rng.choice([1, -1])]
    else:
        message.header.stamp.nanosec = int(rng.integers(10**9, LARGEST))
    return message


def _sizes(rng, count):
    return [int(size) for size in rng.choice([0, 1, 3, 17, 40, 200, 65535, LARGEST], count)]


def _header(rng):
    header = Header(frame_id=str(rng.choice(['camera', *STRANGE])))
    header.stamp.sec = int(rng.choice([0, 100, 101, -1, -2**31, 2**31 - 1]))
    header.stamp.nanosec = int(rng.choice([0, 1, 10**9 - 1, 10**9, LARGEST]))
    return header
