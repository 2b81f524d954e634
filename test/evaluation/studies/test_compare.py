import numpy as np
import pytest

from canned import Canned
from track_before_detect.evaluation.engine.report import write_suite_result
from track_before_detect.evaluation.studies.compare import runs as compare_runs
from track_before_detect.evaluation.studies.compare.details import reasons, Standing
from track_before_detect.evaluation.studies.compare.scenes import (
    largest_speed_px,
    n_targets,
    SCENES,
    shape_of,
)
from track_before_detect.evaluation.studies.compare.suite import run_compare, SUITE
from track_before_detect.options import DETECTORS
from track_before_detect.runs.runner import as_text


@pytest.mark.parametrize('scene', SCENES)
def test_scenes_stay_inside_and_have_their_targets(scene):
    n_frames, height, width = shape_of(scene)
    for seed in range(20):
        paths = SCENES[scene](np.random.default_rng(seed))
        assert paths.shape == (n_targets(scene), n_frames, 2)
        assert np.nanmin(paths) >= 0 and np.nanmax(paths) <= min(height, width) - 1


def test_scenes_are_what_they_are_called():
    rng = np.random.default_rng(5)
    one, other = SCENES['two parallel'](rng)
    np.testing.assert_allclose(np.linalg.norm(one - other, axis=1), 5)
    one, other = SCENES['two crossing'](rng)
    apart = np.linalg.norm(one - other, axis=1)
    assert apart[9:11].max() < 0.6 and apart[[0, -1]].min() > 8
    [arc] = SCENES['arc'](rng)
    bend = np.linalg.norm(np.diff(arc, 2, axis=0), axis=1)
    speed = np.linalg.norm(np.diff(arc, axis=0), axis=1)
    np.testing.assert_allclose(bend, speed[0]**2 / 20, rtol=1e-3)
    assert np.isnan(SCENES['enters'](rng)[0, :8]).all()
    assert np.isfinite(SCENES['leaves'](rng)[0, :12]).all()


@pytest.mark.parametrize('scene', SCENES)
def test_no_target_is_faster_than_methods_are_told(scene):
    paths = np.concatenate([SCENES[scene](np.random.default_rng(seed)) for seed in range(20)])
    steps = np.diff(paths, axis=1)
    assert np.nanmax(np.linalg.norm(steps, axis=2)) <= largest_speed_px(scene) + 1e-9
    assert np.nanmax(np.abs(steps)) <= 1 + 1e-9


def test_bright_targets_of_a_scene_are_found_by_ours():
    methods = {'convex': {'detector': 'convex', 'threshold': 12.0}}
    item = {'scene': 'two crossing', 'snr': 10.0, 'seed': 3, 'methods': methods}
    done = compare_runs.search(item)['convex']
    assert (done['found'], done['false']) == (2, 0)
    assert done['gospa'] < 5.0
    assert 1.8 < done['purity'] <= 2 and 1.8 < done['completeness'] <= 2
    empty = compare_runs.search({**item, 'scene': 'noise', 'snr': 0.0})['convex']
    assert empty == {'found': 0, 'false': 0, 'gospa': 0.0, 'purity': 0.0, 'completeness': 0.0}


def test_statistics_are_told_apart_by_whether_they_are_of_a_target():
    methods = {'greedy': {'detector': 'greedy', 'threshold': 12.0}}
    done = compare_runs.statistics({'scene': 'line', 'snr': 8.0, 'seed': 3, 'methods': methods})
    assert len(done['greedy']['right']) == 1 and done['greedy']['right'][0] > 25
    noise = compare_runs.statistics({'scene': 'noise six', 'snr': 0.0, 'seed': 3, 'methods': {
        'greedy': {'detector': 'greedy', 'threshold': 4.0}}})['greedy']
    assert not noise['right'] and min(noise['false']) > 4


def search(item):
    """Let ours find everything but crossing targets, greedy those, and the rest every third."""
    count = n_targets(item['scene'])
    results = {}
    for name in item['methods']:
        best = {'convex': 'crossing' not in item['scene'],
                'greedy': 'crossing' in item['scene']}.get(name, item['seed'] % 3 == 0)
        results[name] = {'found': count * best, 'false': int(name == 'mt_dp'),
                         'gospa': 0.0 if best else 7.0, 'purity': 0.9 * count * best,
                         'completeness': 0.8 * count * best}
    return results


def statistics(item):
    noise = item['scene'] == 'noise'
    return {name: {'right': [] if noise else [7.0],
                   'false': [6.0] if noise and item['seed'] % 5 == 0 else []}
            for name in item['methods']}


def test_report_names_the_best_method_of_each_scene(tmp_path):
    pytest.importorskip('matplotlib')
    result = run_compare(12, 1, Canned(answers={'search': search, 'statistics': statistics}))
    values = {quantity.name: quantity for quantity in result.quantities}
    assert values['line, SNR 1.5: best method'].note == 'convex'
    assert values['two crossing, SNR 2: best method'].note == 'greedy'
    behind = values['two crossing, SNR 2: convex minus the best other']
    assert behind.value == -1.0 and behind.note == 'best other: greedy; convex is behind'
    untold = values['two crossing, SNR 2: convex-untold minus the best']
    assert -1 < untold.value < 0 and untold.note == 'goal: at least -3 %'
    ahead = values['arc, SNR 3: convex minus the best other']
    assert ahead.value > 0 and ahead.note.endswith('convex is best')
    assert values['noise of 6 x 50 x 50 with a trajectory: mt_dp'].value == 1.0
    assert len(result.rows) == (8 * 3 * 12 + 2 * 24) * (len(DETECTORS) + 4)
    # Ours is the one told that targets may enter, and is as good as any there but "convex".
    entering = values['enters, SNR 2: convex-partial minus the best other']
    assert entering.value == 0 and entering.note.endswith('convex-partial is best')
    write_suite_result(tmp_path, 'compare', result, 'the command')
    report = (tmp_path / 'report.md').read_text()
    assert '| arc | 3 | **100** |' in report and '| arc | 3 | 80 |' in report
    assert '| arc | 3 | 90 |' in report
    assert '- two crossing, SNR 2: nothing that greedy is told explains it.' in report
    assert '- arc' not in report and '- enters' not in report
    assert '| mt_dp | 100.0 (75.8 to 100.0) |' in report
    assert (tmp_path / 'compare_scenes.png').exists() and (tmp_path / 'compare_roc.png').exists()


def test_methods_are_added_to_a_report_without_searching_again_by_those_in_it():
    def searched(*methods):
        items = []

        def noted(answer):
            return lambda item: items.append(item) or answer(item)

        result = SUITE.run(2, 1, Canned(answers={
            'search': noted(search), 'statistics': noted(statistics)}), methods=methods)
        return result, {as_text(item): list(item['methods']) for item in items}

    few, first = searched('greedy', 'velocity_filter')
    more, then = searched('convex-untold', 'greedy', 'convex', 'velocity_filter')
    # What is kept of runs goes by these texts.
    assert all(text in then for text in first)
    assert {name for text, [name] in then.items() if text not in first} == {
        'convex', 'convex-untold'}
    names = [quantity.name for quantity in few.quantities]
    assert 'line, SNR 2: best method' in names and not any('minus' in name for name in names)
    names = [quantity.name for quantity in more.quantities]
    # In the scene that a target enters ours would be "convex-partial".
    assert 'line, SNR 2: convex minus the best other' in names
    assert 'enters, SNR 2: convex-untold minus the best' in names
    assert not any(name.startswith('enters') and name.endswith('best other') for name in names)
    assert few.description.endswith('Compared here: greedy; velocity_filter.')
    assert 'behind' not in few.details + more.details
    assert '| scene | SNR | convex-untold | greedy | convex | velocity_filter |' in more.details


def standing(gain, high, scene='line', ours='convex', rival='velocity_filter', **found):
    found = {'convex': 0.7, 'convex-straight': 0.8, 'convex-fluctuating': 0.5,
             'convex-partial': 0.4, rival: 0.8, **found}
    return Standing(scene, 1.5, ours, rival, gain, -0.2, high, found)


@pytest.mark.parametrize(('gain', 'high', 'said'), [
    (0.0, 0.1, 'best'), (-0.02, 0.0, 'within 2 points'), (-0.1, 0.01, 'within chance'),
    (-0.1, -0.01, 'behind')])
def test_verdicts(gain, high, said):
    assert standing(gain, high).verdict.endswith(said)


def test_reasons_are_given_where_ours_is_behind_and_follow_the_numbers():
    assert reasons([standing(-0.02, 0.0)]).endswith('Nowhere.')
    text = reasons([standing(-0.1, -0.01), standing(0.1, 0.2, 'arc')])
    assert 'Told the same, it finds 80.0 % (+0.0 points to velocity_filter), so motion' in text
    assert 'arc' not in text
    text = reasons([standing(-0.1, -0.01, **{'convex-straight': 0.75})])
    assert '(-5.0 points to velocity_filter), so the freedom to turn is not all of it.' in text
    text = reasons([standing(-0.4, -0.01, 'enters', 'convex-partial', 'pc_dp')])
    assert 'it finds' not in text
    assert 'finds 70.0 %, told that they may enter and leave 40.0 %' in text
