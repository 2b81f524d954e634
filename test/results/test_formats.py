import csv
import json

import numpy as np
import pytest

from track_before_detect.errors import ParameterError
from track_before_detect.recordings.result_files import CSV_COLUMNS
from track_before_detect.results.formats import FORMATS, formats_named


def written(name, found, folder):
    path = folder / FORMATS[name].file
    FORMATS[name].write(path, found)
    return path


def test_a_line_of_json_is_a_feature_over_the_frames_of_presence(found, tmp_path):
    lines = [json.loads(line) for line in written('json', found, tmp_path).read_text().split('\n')
             if line]
    assert [line['id'] for line in lines] == [7, 2]
    assert {line['type'] for line in lines} == {'Feature'}
    lost, once = lines
    assert lost['geometry'] == {'type': 'LineString', 'coordinates': [[3.25, 4.5], [5.5, 6.0]]}
    assert once['geometry'] == {'type': 'Point', 'coordinates': [10.0, 0.0]}
    properties = lost['properties']
    assert (properties['frames'], properties['stamps_s']) == ([2, 4], [0.5, 1.0])
    assert (properties['snr'], properties['statistic'], properties['threshold']) == (4.25, 12, 8)
    assert properties['input'] == 'a.npz'
    # Not known, which JSON has no number for.
    assert properties['covariance_px2'] == [[[None, None], [None, None]]] * 2


def test_boxes_of_mot_lie_around_the_target_and_count_from_one(found, tmp_path):
    rows = [[float(value) for value in line.split(',')]
            for line in written('mot', found, tmp_path).read_text().splitlines()]
    # Four standard deviations wide; the centre of the first pixel is at (1.5, 1.5).
    side = 4 * 1.5
    expected = [(3, 7, 3.25, 4.5), (5, 7, 5.5, 6.0), (6, 2, 10.0, 0.0)]
    for row, (frame, number, x, y) in zip(rows, expected, strict=True):
        np.testing.assert_allclose(row, [frame, number, x + 1.5 - side / 2, y + 1.5 - side / 2,
                                         side, side, 12 / 8, -1, -1, -1])


def test_boxes_of_coco_lie_around_the_target_and_count_from_zero(found, tmp_path):
    boxes = json.loads(written('coco', found, tmp_path).read_text())
    assert [(box['image_id'], box['track_id']) for box in boxes] == [(2, 7), (4, 7), (5, 2)]
    left, top, width, height = boxes[0]['bbox']
    assert (left + width / 2, top + height / 2) == (3.25 + 0.5, 4.5 + 0.5)
    assert {box['category_id'] for box in boxes} == {1}
    assert {box['score'] for box in boxes} == {12 / 8}


def test_parquet_holds_the_columns_of_the_csv_unrounded(found, tmp_path):
    parquet = pytest.importorskip('pyarrow.parquet', reason='the extra [parquet] is missing')
    found.result.trajectories[0].positions[0, 0] = 1 / 3
    table = parquet.read_table(written('parquet', found, tmp_path))
    assert tuple(table.column_names) == CSV_COLUMNS
    assert table['x_px'].to_pylist() == [1 / 3, 5.5, 10.0]
    assert table['trajectory_id'].to_pylist() == [7, 7, 2]
    assert table['var_x_px2'].to_pylist() == [None] * 3
    with open(written('csv', found, tmp_path), newline='') as file:
        assert [int(row['frame']) for row in csv.DictReader(file)] == table['frame'].to_pylist()


@pytest.mark.parametrize('name', FORMATS)
def test_nothing_found_is_an_empty_file_of_its_kind(name, found, tmp_path):
    if name == 'parquet':
        pytest.importorskip('pyarrow', reason='the extra [parquet] is missing')
    found.result.trajectories.clear()
    path = written(name, found, tmp_path)
    if name == 'parquet':
        from pyarrow import parquet
        assert parquet.read_table(path).num_rows == 0
    else:
        empty = {'csv': ','.join(CSV_COLUMNS) + '\n', 'coco': '[]\n'}
        assert path.read_text() == empty.get(name, '')


def test_the_csv_is_always_among_the_formats_and_each_is_named_once():
    assert [one.file for one in formats_named(' mot, coco,mot')] == [
        'trajectories.csv', 'mot.txt', 'coco.json']
    with pytest.raises(ParameterError, match="unknown format 'moot'; did you mean mot"):
        formats_named('moot')
