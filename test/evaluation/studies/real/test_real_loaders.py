"""Recordings with truth in the layouts in which they are published, and noise added to them."""

import av
import numpy as np
from PIL import Image
import pytest

from track_before_detect.errors import DataError
from track_before_detect.evaluation.studies.real.added_noise import (
    contrasts,
    NoisyFrames,
    sigma_for,
)
from track_before_detect.evaluation.studies.real.labelled import find_recordings

SHAPE = (24, 32)


def opened(folder, name):
    return find_recordings(folder)[name].open()


def write_video(path, frames):
    with av.open(str(path), 'w') as container:
        stream = container.add_stream('ffv1', rate=25)
        stream.height, stream.width = frames.shape[1:]
        stream.pix_fmt = 'gray'
        for pixels in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, format='gray')))
        container.mux(stream.encode())


def write_image(path, pixels):
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path)


def mask_of(*boxes):
    """Return a mask with boxes (x, y, width, height), x and y of the first pixel."""
    mask = np.zeros(SHAPE, np.uint8)
    for x, y, width, height in boxes:
        mask[y:y + height, x:x + width] = 255
    return mask


def test_an_archive_with_truth(tmp_path):
    truth = np.array([[0, 3, 5.5, 7], [2, 3, 6.5, 8]], np.float32)
    np.savez(tmp_path / 'a.npz', frames=np.zeros((4, *SHAPE), np.uint8), truth=truth, fps=25.0)
    np.savez(tmp_path / 'none.npz', frames=np.zeros((4, *SHAPE)), truth=np.zeros((0, 4)))
    np.savez(tmp_path / 'untold.npz', frames=np.zeros((4, *SHAPE)))
    assert list(find_recordings(tmp_path)) == ['a']
    made = opened(tmp_path, 'a')
    with made.recording as recording:
        assert (len(recording), recording.shape, recording.stamps_known) == (4, SHAPE, True)
    np.testing.assert_array_equal(
        made.truth.labels, [[0, 3, 5.5, 7, 0, 0], [2, 3, 6.5, 8, 0, 0]])
    assert made.truth.known.tolist() == [True, False, True, False]


def test_a_video_with_boxes_in_a_subfolder(tmp_path):
    folder = tmp_path / 'video'
    folder.mkdir()
    write_video(folder / 'clip.mkv', np.zeros((3, *SHAPE), np.uint8))
    write_video(folder / 'unlabelled.mkv', np.zeros((3, *SHAPE), np.uint8))
    (folder / 'clip.csv').write_text(
        'frame,id,x_px,y_px,width_px,height_px\n0,0,10.5,12,4,3\n2,0,11.5,12,4,3\n')
    assert list(find_recordings(tmp_path)) == ['clip']
    made = opened(tmp_path, 'clip')
    with made.recording as recording:
        assert (len(recording), recording.shape) == (3, SHAPE)
    np.testing.assert_array_equal(
        made.truth.labels, [[0, 0, 10.5, 12, 4, 3], [2, 0, 11.5, 12, 4, 3]])
    assert made.truth.known.tolist() == [True, False, True]


@pytest.mark.parametrize('table, message', [
    ('', 'must have the columns frame, .*, found nothing'),
    ('frame,id,x,y\n', 'must have the columns .*, found frame, id, x, y'),
    ('frame,id,x_px,y_px,width_px,height_px\n0,0,1,2\n', 'six numbers in each row'),
    ('frame,id,x_px,y_px,width_px,height_px\n0,0,1,2,3,wide\n', 'six numbers in each row'),
    ('frame,id,x_px,y_px,width_px,height_px\n3,0,1,2,3,4\n', r'frames 3 to 3, but .* 0 to 2')])
def test_tables_that_cannot_be_used(tmp_path, table, message):
    write_video(tmp_path / 'clip.mkv', np.zeros((3, *SHAPE), np.uint8))
    (tmp_path / 'clip.csv').write_text(table)
    with pytest.raises(DataError, match=message):
        opened(tmp_path, 'clip')


def test_a_folder_without_recordings(tmp_path):
    with pytest.raises(DataError, match='holds no recording with truth'):
        find_recordings(tmp_path)
    with pytest.raises(DataError, match='is no folder'):
        find_recordings(tmp_path / 'absent')


def write_nudt(root):
    """Write a miniature of NUDT-MIRSDT: three sequences, of which one is for training."""
    listed = {'train': ['Sequence1'], 'test': ['Sequence47', 'Sequence85']}
    for split, sequences in listed.items():
        root.mkdir(exist_ok=True)
        (root / f'{split}.txt').write_text(''.join(
            f'{sequence}/Mix/{frame:05d}.mat\n' for sequence in sequences
            for frame in range(1, 4)))
        for sequence in sequences:
            for frame in range(1, 4):
                image = np.full(SHAPE, 100 + frame, np.uint8)
                write_image(root / sequence / 'images' / f'{frame:05d}.png', image)
                write_image(root / sequence / 'masks' / f'{frame:05d}.png',
                            mask_of((4 + frame, 6, 3, 2), (20, 10 + frame, 1, 1)))


def test_nudt_mirsdt(tmp_path):
    write_nudt(tmp_path / 'NUDT-MIRSDT')
    found = find_recordings(tmp_path / 'NUDT-MIRSDT')
    # Tables are made of the test split, in two groups.
    assert {name: source.group for name, source in found.items()} == {
        'Sequence47': 'NUDT-MIRSDT, SNR at most 3', 'Sequence85': 'NUDT-MIRSDT, SNR above 3'}
    made = found['Sequence85'].open()
    with made.recording as recording:
        assert [int(recording[k][0, 0]) for k in range(3)] == [101, 102, 103]
        assert not recording.stamps_known
    assert made.truth.known.all()
    # Two targets, each with its own number throughout: the 3 x 2 box and the pixel.
    labels = made.truth.labels[np.lexsort((made.truth.labels[:, 0], made.truth.labels[:, 4]))]
    np.testing.assert_array_equal(labels[:, [0, 2, 3, 4, 5]], [
        [0, 20, 11, 1, 1], [1, 20, 12, 1, 1], [2, 20, 13, 1, 1],
        [0, 6, 6.5, 3, 2], [1, 7, 6.5, 3, 2], [2, 8, 6.5, 3, 2]])
    assert len(set(labels[:3, 1])) == len(set(labels[3:, 1])) == 1
    assert labels[0, 1] != labels[3, 1]
    assert len(made.truth.pixels) == 3 * 7


def write_leo(root):
    """Write a miniature of IRSatVideo-LEO."""
    for name in ('EastAfrica-0', 'AfricaWest-1_38', 'Training-2'):
        (root / 'img_idx').mkdir(parents=True, exist_ok=True)
        (root / 'img_idx' / f'{name}.txt').write_text('0000\n0001\n0002\n')
        for frame in range(3):
            write_image(root / 'images' / name / f'{frame:04d}.png',
                        np.full(SHAPE, 1000 * (frame + 1), np.uint16))
            boxes = [(10, 5, 2, 2)] if frame != 1 else []
            write_image(root / 'masks' / name / f'{frame:04d}.png', mask_of(*boxes))
    (root / 'video_idx').mkdir()
    for split, names in {
            'train_IRSatVideo-LEO': ['Training-2'],
            'test_IRSatVideo-LEO': ['EastAfrica-0', 'AfricaWest-1_38'],
            'test_IRSatVideo-LEO-easy': ['EastAfrica-0'],
            'test_IRSatVideo-LEO-hard': ['AfricaWest-1_38']}.items():
        (root / 'video_idx' / f'{split}.txt').write_text('\n'.join(names) + '\n')


def test_irsatvideo_leo(tmp_path):
    write_leo(tmp_path / 'IRSatVideo-LEO')
    # It may be a folder among others.
    found = find_recordings(tmp_path)
    assert {name: source.group for name, source in found.items()} == {
        'EastAfrica-0': 'IRSatVideo-LEO, easy', 'AfricaWest-1_38': 'IRSatVideo-LEO, hard'}
    made = found['EastAfrica-0'].open()
    with made.recording as recording:
        assert recording[2][0, 0] == 3000
    # The frame in the middle is known to hold no target; afterwards it is the same target.
    assert made.truth.known.tolist() == [True, True, True]
    np.testing.assert_array_equal(
        made.truth.labels, [[0, 0, 10.5, 5.5, 2, 2], [2, 0, 10.5, 5.5, 2, 2]])


def test_frames_without_a_mask_are_unknown(tmp_path):
    write_nudt(tmp_path / 'NUDT-MIRSDT')
    (tmp_path / 'NUDT-MIRSDT' / 'Sequence85' / 'masks' / '00002.png').unlink()
    made = opened(tmp_path / 'NUDT-MIRSDT', 'Sequence85')
    assert made.truth.known.tolist() == [True, False, True]


def test_a_sequence_that_is_listed_and_missing(tmp_path):
    write_nudt(tmp_path / 'NUDT-MIRSDT')
    with open(tmp_path / 'NUDT-MIRSDT' / 'test.txt', 'a', encoding='utf-8') as file:
        file.write('Sequence99/Mix/00001.mat\n')
    with pytest.raises(DataError, match='Sequence99'):
        opened(tmp_path / 'NUDT-MIRSDT', 'Sequence99')


def test_a_mask_of_another_size(tmp_path):
    write_nudt(tmp_path / 'NUDT-MIRSDT')
    path = tmp_path / 'NUDT-MIRSDT' / 'Sequence85' / 'masks' / '00002.png'
    write_image(path, np.zeros((5, 5), np.uint8))
    with pytest.raises(DataError, match='00002.png must be 24 x 32 like its frame, got 5 x 5'):
        opened(tmp_path / 'NUDT-MIRSDT', 'Sequence85')


def checkered(n_frames, contrast, amplitude=2.0):
    """Return frames whose deviation is known, with a bright pixel at (30, 20)."""
    row, column = np.indices((40, 60))
    frames = np.tile(100 + amplitude * (-1.0) ** (row + column), (n_frames, 1, 1))
    frames[:, 20, 30] = 100 + contrast
    return frames


def test_contrast_is_that_of_the_peak_to_its_surroundings(tmp_path):
    frames = checkered(3, 50)
    np.savez(tmp_path / 'a.npz', frames=frames, truth=[[k, 0, 31, 20] for k in range(3)])
    found = contrasts(opened(tmp_path, 'a'))
    np.testing.assert_allclose(found.peaks, 50, atol=2.1)
    np.testing.assert_allclose(found.deviations, 2, rtol=0.01)
    np.testing.assert_allclose(found.snr(), 25, rtol=0.05)


def test_dark_targets_have_contrast(tmp_path):
    frames = checkered(3, -50)
    np.savez(tmp_path / 'a.npz', frames=frames, truth=[[k, 0, 30, 20] for k in range(3)])
    np.testing.assert_allclose(contrasts(opened(tmp_path, 'a')).peaks, 50, atol=2.1)


def test_the_peak_of_a_box_is_looked_for_in_all_of_it(tmp_path):
    folder = tmp_path
    frames = checkered(2, 50).astype(np.uint8)
    write_video(folder / 'clip.mkv', frames)
    (folder / 'clip.csv').write_text(
        'frame,id,x_px,y_px,width_px,height_px\n0,0,24,20,14,4\n1,0,24,20,14,4\n')
    np.testing.assert_allclose(contrasts(opened(folder, 'clip')).peaks, 50, atol=2.1)


def test_added_noise_brings_the_snr_down(tmp_path):
    np.savez(tmp_path / 'a.npz', frames=checkered(5, 60),
             truth=[[k, 0, 30, 20] for k in range(5)])
    found = contrasts(opened(tmp_path, 'a'))
    # sqrt(2^2 + sigma^2) = 60 / 4, but for half a level of the local median.
    assert sigma_for(found, 4.0) == pytest.approx(np.sqrt(15**2 - 2**2), rel=0.05)
    assert sigma_for(found, 1.5) == pytest.approx(np.sqrt(40**2 - 2**2), rel=0.05)
    assert sigma_for(found, 40.0) == 0


def test_noisy_frames_are_the_same_in_any_order_and_of_the_deviation(tmp_path):
    np.savez(tmp_path / 'a.npz', frames=np.zeros((4, 100, 100), np.uint8), fps=10.0,
             truth=[[0, 0, 1, 1]])
    with opened(tmp_path, 'a').recording as recording:
        noisy = NoisyFrames(recording, 3.0, seed=5)
        frames = np.stack([noisy[k] for k in range(len(noisy))])
        assert frames.dtype == np.float32
        assert frames.std() == pytest.approx(3, rel=0.05)
        np.testing.assert_array_equal(noisy[2], frames[2])
        assert np.abs(np.corrcoef(frames.reshape(4, -1))[np.triu_indices(4, 1)]).max() < 0.05
        np.testing.assert_array_equal(noisy.stamps, recording.stamps)
        assert not np.array_equal(NoisyFrames(recording, 3.0, seed=6)[0], frames[0])
