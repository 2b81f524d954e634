"""The file that is recorded to, looked at within every write."""

import os

import pytest

pytest.importorskip('rclpy')
pytest.importorskip('mcap')

from mcap.reader import make_reader  # noqa: E402
from rosbags.rosbag2 import Reader  # noqa: E402

from track_before_detect.ros.recorder.bag_file import BagFile  # noqa: E402

KIND, DEFINITION = 'std_msgs/msg/UInt8MultiArray', 'uint8[] data\n'
# A process that is killed may have written up to some page, but not a part of what is short.
PIECE, SHORT = 2**17, 64


def messages(path):
    with Reader(path) as reader:
        return [bytes(raw) for _, _, raw in reader.messages()]


@pytest.fixture
def bag(tmp_path):
    bag = BagFile(tmp_path / 'a.mcap', 'none', 10**8)
    bag.add_topic('/a', KIND, DEFINITION)
    return bag


def test_the_file_is_whole_at_any_moment_of_any_write(bag, tmp_path, monkeypatch):
    path, write, seen = tmp_path / 'a.mcap', os.pwritev, []
    written = [bytes([k]) * size for k, size in enumerate((10, 100_000, 3_000_000, 7, 2_500_000))]

    def in_pieces(descriptor, parts, at):
        data = b''.join(parts)
        step = PIECE if len(data) > SHORT else SHORT
        for start in range(0, len(data), step):
            write(descriptor, [data[start:start + step]], at + start)
            seen.append(len(messages(path)))
        return len(data)

    monkeypatch.setattr(os, 'pwritev', in_pieces)
    for number, data in enumerate(written):
        assert bag.write('/a', data, number + 1, number + 1)
        bag.commit()
        assert messages(path) == written[:number + 1]
    assert seen == sorted(seen) and len(seen) > 50
    bag.close()
    assert messages(path) == written
    with open(path, 'rb') as file:
        assert make_reader(file).get_summary().statistics.message_count == len(written)


def test_what_cannot_be_written_is_held_up_to_a_bound(bag, tmp_path, monkeypatch):
    bag.write('/a', b'first', 1, 1)
    bag.commit()

    def full(descriptor, parts, at):
        # Part of it still finds room.
        os.pwrite(descriptor, b''.join(parts)[:1000], at)
        return 1000

    bag.write('/a', bytes(60_000_000), 2, 2)
    with monkeypatch.context() as patch:
        patch.setattr(os, 'pwritev', full)
        for _ in range(2):
            with pytest.raises(OSError):
                bag.commit()
            assert messages(tmp_path / 'a.mcap') == [b'first']
    assert not bag.write('/a', bytes(50_000_000), 3, 3)
    bag.close()
    assert [len(message) for message in messages(tmp_path / 'a.mcap')] == [5, 60_000_000]
