import io
from pathlib import Path
import struct
import tempfile
import zlib

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from track_before_detect.errors import DataError
from track_before_detect.recordings.open_recording import open_recording

pytest.importorskip('rosbags')
from rosbags.rosbag2 import StoragePlugin, Writer  # noqa: E402
from rosbags.typesys import get_typestore, Stores  # noqa: E402

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = STORE.types
IMAGE = 'sensor_msgs/msg/Image'
ARRAY = 'std_msgs/msg/Float32MultiArray'
COMPRESSED = 'sensor_msgs/msg/CompressedImage'
STORAGES = [StoragePlugin.SQLITE3, StoragePlugin.MCAP]
FRAMES = np.random.default_rng(3).integers(0, 65535, (6, 5, 4)).astype(np.uint16)


def image(frame, stamp_ns, encoding='mono16', big=False, padding=0, frame_id='camera'):
    rows = frame.astype(frame.dtype.newbyteorder('>' if big else '<')).view(np.uint8)
    rows = np.pad(rows.reshape(len(frame), -1), ((0, 0), (0, padding)))
    header = TYPES['std_msgs/msg/Header'](
        TYPES['builtin_interfaces/msg/Time'](*divmod(stamp_ns, 10**9)), frame_id)
    return TYPES[IMAGE](header, frame.shape[0], frame.shape[1], encoding, int(big),
                        rows.shape[1], rows.ravel())


def multiarray(frame, label='rows'):
    dimension = TYPES['std_msgs/msg/MultiArrayDimension']
    layout = TYPES['std_msgs/msg/MultiArrayLayout'](
        [dimension(label, frame.shape[0], frame.size),
         dimension('columns', frame.shape[1], frame.shape[1])], 0)
    return TYPES[ARRAY](layout, frame.astype(np.float32).ravel())


def write_bag(path, topics, storage=StoragePlugin.SQLITE3):
    """Write {topic: (type, [(receive time in ns, message), ...])}."""
    with Writer(path, version=9, storage_plugin=storage) as writer:
        for topic, (kind, messages) in topics.items():
            connection = writer.add_connection(topic, kind, typestore=STORE)
            for time, message in messages:
                writer.write(connection, time, STORE.serialize_cdr(message, kind))


def images(frames, **kwargs):
    return [(7_000_000_000 + 10**8 * k, image(frame, 10**9 + 4 * 10**7 * k, **kwargs))
            for k, frame in enumerate(frames)]


def all_frames(recording):
    return np.stack([recording[k] for k in range(len(recording))])


@pytest.mark.parametrize('storage', STORAGES)
@pytest.mark.parametrize('single_file', [False, True])
def test_image_bag_gives_back_its_frames(tmp_path, storage, single_file):
    path = tmp_path / 'bag'
    write_bag(path, {'/image': (IMAGE, images(FRAMES, big=True, padding=3))}, storage)
    opened = next(path.glob('*.[dm][bc]*')) if single_file else path
    with open_recording(opened) as recording:
        assert recording.dtype == np.uint16 and recording.frame_id == 'camera'
        np.testing.assert_array_equal(all_frames(recording), FRAMES)
        np.testing.assert_allclose(recording.stamps, 1 + 0.04 * np.arange(6), rtol=0, atol=1e-9)
        assert recording.stamps_known


@settings(deadline=None, max_examples=15)
@given(st.permutations(range(6)), st.sampled_from(STORAGES), st.integers(1, 3))
def test_frames_may_be_read_in_any_order(order, storage, per_time):
    messages = [(10**9 * (k // per_time), message)
                for k, (_, message) in enumerate(images(FRAMES))]
    with tempfile.TemporaryDirectory() as folder:
        write_bag(Path(folder) / 'bag', {'/image': (IMAGE, messages)}, storage)
        with open_recording(Path(folder) / 'bag') as recording:
            for k in order:
                np.testing.assert_array_equal(recording[k], FRAMES[k])


@pytest.mark.parametrize('storage', STORAGES)
def test_multiarray_bag_has_stamps_of_receipt(tmp_path, storage):
    frames = np.random.default_rng(1).normal(size=(4, 3, 5)).astype(np.float32)
    messages = [(10**9 + 5 * 10**8 * k, multiarray(frame)) for k, frame in enumerate(frames)]
    write_bag(tmp_path / 'bag', {'/frame': (ARRAY, messages)}, storage)
    with open_recording(tmp_path / 'bag') as recording:
        assert recording.dtype == np.float32 and recording.frame_id == ''
        np.testing.assert_array_equal(all_frames(recording), frames)
        np.testing.assert_allclose(recording.stamps, [1, 1.5, 2, 2.5])


def test_multiarrays_have_the_stamps_of_their_labels(tmp_path):
    labels = [f'stamp={100 + k}.250000000 frame_id=radar' for k in range(4)]
    messages = [(10**9, multiarray(frame, label)) for frame, label in zip(FRAMES, labels)]
    write_bag(tmp_path / 'bag', {'/frame': (ARRAY, messages)})
    with open_recording(tmp_path / 'bag') as recording:
        np.testing.assert_array_equal(recording.stamps, 100.25 + np.arange(4))
        assert recording.frame_id == 'radar'
    messages[2] = (10**9, multiarray(FRAMES[2], 'stamp=soon'))
    write_bag(tmp_path / 'bad', {'/frame': (ARRAY, messages)})
    with pytest.raises(DataError, match='message 2 of .*: a label with a stamp must be'):
        open_recording(tmp_path / 'bad')


def test_images_without_header_stamps_have_those_of_receipt(tmp_path):
    messages = [(10**9 * (k + 1), image(frame, 0)) for k, frame in enumerate(FRAMES)]
    write_bag(tmp_path / 'bag', {'/image': (IMAGE, messages)})
    with open_recording(tmp_path / 'bag') as recording:
        np.testing.assert_allclose(recording.stamps, np.arange(1, 7))


def test_topic_is_chosen_by_name_or_because_it_is_the_only_one(tmp_path):
    text = [(1, TYPES['std_msgs/msg/String']('hello'))]
    write_bag(tmp_path / 'one', {'/image': (IMAGE, images(FRAMES)),
                                 '/chat': ('std_msgs/msg/String', text), '/empty': (IMAGE, [])})
    write_bag(tmp_path / 'two', {'/left': (IMAGE, images(FRAMES)),
                                 '/right': (IMAGE, images(FRAMES[:3]))})
    with open_recording(tmp_path / 'one') as recording:
        assert len(recording) == 6
    with open_recording(tmp_path / 'two', topic='right') as recording:
        assert len(recording) == 3
    for name, topic, message in [
            ('two', None, 'must be named; found: /left, /right'),
            ('two', '/up', 'no topic /up; suitable topics: /left, /right'),
            ('one', '/chat', 'got std_msgs/msg/String; suitable topics: /image'),
            ('one', '/empty', 'has no messages')]:
        with pytest.raises(DataError, match=message):
            open_recording(tmp_path / name, topic)


@pytest.mark.parametrize(
    ('messages', 'message'),
    [([(1, image(FRAMES[0], 1, encoding='nv12'))], "message 0 .*'nv12'"),
     ([(1, image(FRAMES[0], 1)), (2, image(FRAMES[1].T.copy(), 2))], 'must be like the first'),
     ([], 'found: none')],
    ids=['encoding', 'size change', 'no messages'])
def test_bad_messages_are_refused(tmp_path, messages, message):
    write_bag(tmp_path / 'bag', {'/image': (IMAGE, messages)})
    with pytest.raises(DataError, match=message):
        with open_recording(tmp_path / 'bag') as recording:
            all_frames(recording)


@pytest.mark.filterwarnings('ignore')
@pytest.mark.parametrize('storage', STORAGES)
def test_truncated_bag_is_refused(tmp_path, storage):
    path = tmp_path / 'bag'
    frames = np.random.default_rng(3).integers(0, 65535, (6, 50, 40)).astype(np.uint16)
    write_bag(path, {'/image': (IMAGE, images(frames))}, storage)
    file = next(path.glob('*.[dm][bc]*'))
    data = file.read_bytes()
    for length in (0, 20, len(data) // 2):
        file.write_bytes(data[:length])
        for opened in (file, path):
            with pytest.raises(DataError, match='bag') as caught:
                with open_recording(opened) as recording:
                    all_frames(recording)
            assert '\n' not in str(caught.value)


def test_folder_without_metadata_is_read_through_its_only_file(tmp_path):
    path = tmp_path / 'bag'
    write_bag(path, {'/image': (IMAGE, images(FRAMES))}, StoragePlugin.MCAP)
    (path / 'metadata.yaml').unlink()
    with open_recording(path) as recording:
        assert len(recording) == 6
    (path / 'second.mcap').write_bytes(next(path.glob('*.mcap')).read_bytes())
    with pytest.raises(DataError, match='no metadata.yaml and 2 storage files'):
        open_recording(path)


def test_damaged_metadata_is_refused(tmp_path):
    path = tmp_path / 'bag'
    write_bag(path, {'/image': (IMAGE, images(FRAMES))})
    for text in ('', 'rosbag2_bagfile_information: 3', '{', 'a: b'):
        (path / 'metadata.yaml').write_text(text)
        with pytest.raises(DataError, match='cannot be opened') as caught:
            open_recording(path)
        assert '\n' not in str(caught.value)


def compressed(frame, stamp_ns, suffix='png'):
    image_module = pytest.importorskip('PIL.Image')
    data = io.BytesIO()
    image_module.fromarray(frame).save(data, suffix)
    return TYPES[COMPRESSED](image(FRAMES[0], stamp_ns).header, f'mono16; {suffix} compressed ',
                             np.frombuffer(data.getvalue(), np.uint8))


def test_a_bag_of_compressed_images_alone_is_read(tmp_path):
    messages = [(10**9 * k, compressed(frame, 10**9 + 4 * 10**7 * k))
                for k, frame in enumerate(FRAMES)]
    write_bag(tmp_path / 'bag', {'/camera/compressed': (COMPRESSED, messages)})
    with open_recording(tmp_path / 'bag') as recording:
        np.testing.assert_array_equal(all_frames(recording), FRAMES)
        np.testing.assert_allclose(recording.stamps, 1 + 0.04 * np.arange(6), rtol=0, atol=1e-9)
    write_bag(tmp_path / 'both', {'/camera/compressed': (COMPRESSED, messages),
                                  '/camera': (IMAGE, images(FRAMES[:3]))})
    with open_recording(tmp_path / 'both') as recording:
        assert len(recording) == 3
    with open_recording(tmp_path / 'both', '/camera/compressed') as recording:
        assert len(recording) == 6


def test_compressed_image_that_is_none_is_refused(tmp_path):
    message = TYPES[COMPRESSED](image(FRAMES[0], 0).header, 'h264', np.zeros(9, np.uint8))
    write_bag(tmp_path / 'bag', {'/video': (COMPRESSED, [(1, message)])})
    with pytest.raises(DataError, match='message 0 of .*: its h264 cannot be read: it is no PNG'):
        open_recording(tmp_path / 'bag')


def chunks_in(data):
    """Return offset and length of each chunk of an MCAP file, behind the head of its record."""
    places, offset = [], 8
    while offset + 9 <= len(data):
        kind, length = struct.unpack_from('<BQ', data, offset)
        if kind == 6:
            places.append((offset + 9, length))
        offset += 9 + length
    return places


@pytest.mark.parametrize('damaged', [[0], [1], [2], [0, 2]])
@pytest.mark.parametrize('single_file', [False, True])
def test_damaged_chunks_are_left_out_and_counted(tmp_path, damaged, single_file):
    frames = np.random.default_rng(4).integers(0, 65535, (6, 512, 600)).astype(np.uint16)
    path = tmp_path / 'bag'
    write_bag(path, {'/image': (IMAGE, images(frames))}, StoragePlugin.MCAP)
    [file] = path.glob('*.mcap')
    data = bytearray(file.read_bytes())
    chunks = chunks_in(data)
    assert len(chunks) == 3
    for number, (offset, length) in enumerate(chunks):
        messages = offset + 40
        assert struct.unpack_from('<I', data, offset + 28) == (0,)
        struct.pack_into('<I', data, offset + 24, zlib.crc32(data[messages:offset + length]))
        if number in damaged:
            data[messages + 200_000] ^= 16
    file.write_bytes(data)
    kept = [k for k in range(6) if k // 2 not in damaged]
    with open_recording(file if single_file else path) as recording:
        np.testing.assert_array_equal(all_frames(recording), frames[kept])
        np.testing.assert_array_equal(recording[1], frames[kept[1]])
        np.testing.assert_allclose(recording.stamps, 1 + 0.04 * np.array(kept), atol=1e-9)
        [remark] = recording.remarks
    assert f'{6 - len(kept)} of 6 messages of' in remark
    assert f'left out: {len(damaged)} of its chunks are damaged' in remark


def write_ros1_bag(path, frames):
    from rosbags.rosbag1 import Writer as Writer1
    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer1(path) as writer:
        connection = writer.add_connection('/image', IMAGE, typestore=store)
        for k, (time, message) in enumerate(images(frames)):
            header = store.types['std_msgs/msg/Header'](k, message.header.stamp, 'camera')
            old = store.types[IMAGE](header, message.height, message.width, message.encoding, 0,
                                     message.step, message.data)
            writer.write(connection, time, store.serialize_ros1(old, IMAGE))


@pytest.mark.parametrize('in_folder', [False, True])
def test_ros1_bag_gives_back_its_frames(tmp_path, in_folder):
    path = tmp_path / 'old.bag'
    write_ros1_bag(path, FRAMES)
    with open_recording(tmp_path if in_folder else path) as recording:
        assert recording.frame_id == 'camera'
        np.testing.assert_array_equal(all_frames(recording), FRAMES)
        np.testing.assert_array_equal(recording[4], FRAMES[4])
        np.testing.assert_allclose(recording.stamps, 1 + 0.04 * np.arange(6), rtol=0, atol=1e-9)
    data = path.read_bytes()
    path.write_bytes(data[:len(data) // 2])
    with pytest.raises(DataError, match='old.bag cannot be'):
        open_recording(path)


def test_packed_bag_names_what_unpacks_it(tmp_path):
    folder = tmp_path / 'bag'
    folder.mkdir()
    (folder / 'bag_0.db3.zstd').write_bytes(b'something')
    with pytest.raises(DataError, match='is packed; zstd -d .*bag_0.db3.zstd unpacks it'):
        open_recording(folder / 'bag_0.db3.zstd')
    with pytest.raises(DataError, match='no metadata.yaml.*; zstd -d .*bag_0.db3.zstd unpacks'):
        open_recording(folder)
