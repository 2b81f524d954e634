"""The scenes are what the text describes, and the table is what was found in them."""

import csv

import numpy as np
import pytest

from canned import Canned
from track_before_detect.evaluation.engine.report import write_suite_result
from track_before_detect.evaluation.studies.patent.figures import CONTINUATION, FIGURES, GREEDY
from track_before_detect.evaluation.studies.patent.scenes import (
    CROSSING_PX,
    MAX_ACCELERATION_PX,
    MAX_SPEED_PX,
    PARALLEL_PX,
)
from track_before_detect.evaluation.studies.patent.suite import METHODS, run_patent
from track_before_detect.models.measurement.psf import GaussianPsf

BY_NUMBER = {figure.number: figure for figure in FIGURES}


def scene(number, seed=0):
    return BY_NUMBER[number].make(np.random.default_rng(seed))


def met(number, of_scene, found):
    """Return the labels that a set of positions (K, T) meets."""
    found = np.asarray(found, float).reshape(-1, of_scene.positions.shape[1])
    return {criterion.label for criterion in BY_NUMBER[number].criteria
            if criterion.met(of_scene, found)}


@pytest.fixture(scope='module')
def result():
    return run_patent(2, 3, Canned(any_threshold=7.1))


@pytest.mark.parametrize('number', [figure.number for figure in FIGURES])
def test_scene_holds_its_targets_and_unit_noise(number):
    of_scene = scene(number, 4)
    n_frames, width = of_scene.received.shape
    assert of_scene.measured.shape == (n_frames, 1, width)
    assert len(of_scene.positions) == len(of_scene.snrs)
    noise = of_scene.measured[:, 0] - of_scene.received
    assert abs(noise.std() - 1) < 5 / np.sqrt(2 * noise.size)
    # Each target keeps its whole stamp inside, so the energies add up where none overlap.
    sigma = BY_NUMBER[number].options['psf_sigma_px']
    assert of_scene.positions.min() > 4 * sigma
    assert of_scene.positions.max() < width - 1 - 4 * sigma
    if number in (2, 5):
        assert np.sum(of_scene.received**2, axis=1) == pytest.approx(np.sum(of_scene.snrs**2))
    again = scene(number, 4)
    assert np.array_equal(again.measured, of_scene.measured)
    assert not np.array_equal(scene(number, 5).measured, of_scene.measured)


def test_stamp_is_that_of_the_detector():
    of_scene = scene(2)
    x = of_scene.positions[0, 0]
    pixel = int(np.rint(x))
    taps = of_scene.snrs[0] * GaussianPsf(3.0).taps(x - pixel)
    around = of_scene.received[0, pixel - 12:pixel + 13]
    assert around == pytest.approx(taps, abs=2e-3)


@pytest.mark.parametrize('seed', range(5))
def test_targets_move_within_the_one_motion_model(seed):
    for number in (5, 6, 7):
        positions = scene(number, seed).positions
        assert np.abs(np.diff(positions, axis=1)).max() <= MAX_SPEED_PX
        assert np.abs(np.diff(positions, 2, axis=1)).max() <= MAX_ACCELERATION_PX + 1e-9
    options = [BY_NUMBER[number].options for number in (5, 6, 7)]
    assert options[0] == options[1] == options[2]
    parallel, crossing = scene(6, seed).positions, scene(7, seed).positions
    assert np.diff(parallel, axis=0) == pytest.approx(PARALLEL_PX)
    apart = crossing[0] - crossing[1]
    assert np.diff(apart) == pytest.approx(CROSSING_PX) and apart.mean() == pytest.approx(0)


def test_truth_meets_what_is_wanted_and_nothing_meets_what_is_not():
    assert met(2, scene(2), scene(2).positions[:3]) == {'the three brightest and nothing else'}
    assert not met(2, scene(2), scene(2).positions)
    merged = np.concatenate([scene(3).positions[:4], scene(3).positions[4:].mean(0)[None]])
    assert met(3, scene(3), merged) == {
        '2 detections at 9 px', '2 detections at 6 px', '1 detection at 3 px',
        '2, 2 and 1 detections'}
    assert met(3, scene(3), []) == set()
    assert met(4, scene(4), [[29], [32], [35], [96], [160]]) == {
        'more than 2 detections at SNR 30', '1 detection at SNR 12', '1 detection at SNR 6'}
    assert len(met(5, scene(5), scene(5).positions)) == 5
    assert met(6, scene(6), scene(6).positions) == {'both found and distinct', 'nothing else'}
    assert met(6, scene(6), scene(6).positions.mean(0)) == set()
    assert met(7, scene(7), scene(7).positions) == {
        'both found and not swapped', 'nothing else'}


def test_bounce_in_the_middle_counts_as_swapped():
    one, other = scene(7).positions
    bounced = [np.maximum(one, other), np.minimum(one, other)]
    assert met(7, scene(7), bounced) == {'swapped'}


def test_second_trajectory_of_a_target_is_something_else():
    for number in (5, 6, 7):
        positions = scene(number).positions
        labels = met(number, scene(number), [*positions, positions[0] + 0.5])
        assert not any(label.startswith('nothing else') for label in labels)


def test_every_method_searches_the_same_scenes(result):
    assert len(result.rows) == 2 * len(FIGURES) * len(METHODS)
    for figure in FIGURES:
        seeds = [{row['seed'] for row in result.rows
                  if row['figure'] == figure.number and row['method'] == method}
                 for method in METHODS]
        assert all(len(of_method) == 2 and of_method == seeds[0] for of_method in seeds)
    assert {row['threshold'] for row in result.rows if row['figure'] <= 4} == {5.0}


def test_table_counts_the_rows(result):
    quantities = {quantity.name: quantity for quantity in result.quantities}
    for figure in FIGURES:
        for criterion in figure.criteria:
            for method in METHODS:
                quantity = quantities[f'Fig. {figure.number}, {criterion.label}: {method}']
                shown = sum(criterion.label in row['met'].split('; ') for row in result.rows
                            if (row['figure'], row['method']) == (figure.number, method))
                assert (quantity.value, quantity.trials) == (shown / 2, 2)
                assert 0 <= quantity.low <= quantity.value <= quantity.high <= 1


def test_bright_targets_are_found_and_bright_pairs_tripled_by_greedy(result):
    quantities = {quantity.name: quantity.value for quantity in result.quantities}
    for method in METHODS:
        assert quantities[f'Fig. 5, target of SNR 4 found: {method}'] == 1
    assert quantities[f'Fig. 4, 2 detections at SNR 30: {CONTINUATION}'] == 1
    assert quantities[f'Fig. 4, more than 2 detections at SNR 30: {GREEDY}'] == 1
    assert quantities[f'Fig. 6, both found and distinct: {CONTINUATION}'] == 1


def test_there_is_a_picture_of_each_figure_and_one_of_the_table(result, tmp_path):
    pytest.importorskip('matplotlib')
    image = pytest.importorskip('matplotlib.image')
    write_suite_result(tmp_path, 'patent', result, 'tbd evaluate patent')
    pictures = ['patent', *(f'patent_figure_{number}' for number in range(2, 8))]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        ['patent.csv', 'report.md', 'summary.json', *(f'{name}.png' for name in pictures)])
    report = (tmp_path / 'report.md').read_text()
    for name in pictures:
        assert f'({name}.png)' in report
        assert image.imread(tmp_path / f'{name}.png').std() > 0
    with open(tmp_path / 'patent.csv', newline='') as file:
        assert len(list(csv.DictReader(file))) == len(result.rows)
