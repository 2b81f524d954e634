import time

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment, linprog

from track_before_detect.errors import DataError, ParameterError
from track_before_detect.evaluation.metrics.gospa import trajectory_gospa


def distances_of_definition(found, targets, cutoff, order):
    """Return D of the reference for each frame, (T, N + 1, M + 1); the last is nobody."""
    n_frames = (found if len(found) else targets).shape[1]
    table = np.full((n_frames, len(found) + 1, len(targets) + 1), 0.5 * cutoff**order)
    table[:, -1, -1] = 0
    for k in range(n_frames):
        for i in range(len(found) + 1):
            for j in range(len(targets) + 1):
                here = i < len(found) and np.isfinite(found[i, k]).all()
                there = j < len(targets) and np.isfinite(targets[j, k]).all()
                if here and there:
                    distance = np.hypot(*(found[i, k] - targets[j, k]))
                    table[k, i, j] = min(distance, cutoff)**order
                elif not here and not there:
                    table[k, i, j] = 0
    return table


def slow_gospa(found, targets, cutoff, switch, order):
    """Solve the programme of the reference as it is printed, all pairs and frames at once."""
    table = distances_of_definition(found, targets, cutoff, order)
    n_frames, rows, columns = table.shape
    n = table.size
    weight = np.arange(n).reshape(table.shape)
    n_changes = (n_frames - 1) * (rows - 1) * (columns - 1)
    change = n + np.arange(n_changes).reshape(n_frames - 1, rows - 1, columns - 1)
    sums, differences = [], []
    for k in range(n_frames):
        for group in [*weight[k, :-1], *weight[k, :, :-1].T]:
            sums.append(np.isin(np.arange(n + n_changes), group).astype(float))
    for k, i, j in np.ndindex(change.shape):
        for sign in (1, -1):
            row = np.zeros(n + n_changes)
            row[weight[k, i, j]], row[weight[k + 1, i, j]] = sign, -sign
            row[change[k, i, j]] = -1
            differences.append(row)
    cost = np.append(table.ravel(), np.full(n_changes, 0.5 * switch**order))
    no_rows = {'A_ub': np.array(differences), 'b_ub': np.zeros(len(differences))}
    done = linprog(cost, A_eq=np.array(sums), b_eq=np.ones(len(sums)), bounds=(0, None),
                   **(no_rows if differences else {}))
    return done.fun**(1 / order)


def straight(x, y, n_frames=10):
    return np.column_stack([x + np.arange(n_frames), np.full(n_frames, float(y))])


def random_scene(seed, n_found, n_targets, n_frames=5, size=8.0):
    rng = np.random.default_rng(seed)
    sets = []
    for count in (n_found, n_targets):
        steps = rng.normal(0, 1.0, (count, n_frames, 2))
        paths = rng.uniform(0, size, (count, 1, 2)) + np.cumsum(steps, axis=1)
        paths[rng.random((count, n_frames)) < 0.2] = np.nan
        sets.append(paths)
    return sets


@pytest.mark.parametrize('order', [1.0, 2.0])
@pytest.mark.parametrize('switch', [0.0, 1.0, 4.0])
@pytest.mark.parametrize('seed', range(4))
def test_equals_the_programme_of_the_definition(seed, switch, order):
    found, targets = random_scene(seed, 3, 4)
    ours = trajectory_gospa(found, targets, cutoff_px=5.0, switch_px=switch, order=order)
    expected = slow_gospa(found, targets, 5.0, switch, order)
    assert ours.distance == pytest.approx(expected, rel=1e-7)
    parts = ours.localisation + ours.missed + ours.false + ours.switching
    assert ours.distance**order == pytest.approx(parts)


@pytest.mark.parametrize('seed', range(3))
def test_without_a_price_on_changes_it_is_gospa_frame_by_frame(seed):
    found, targets = random_scene(10 + seed, 6, 5, n_frames=8)
    total = 0.0
    for frame in distances_of_definition(found, targets, 4.0, 2.0):
        here, there = frame[:-1, -1] > 0, frame[-1, :-1] > 0
        pairs = frame[:-1, :-1][np.ix_(here, there)]
        taken = linear_sum_assignment(pairs)
        total += pairs[taken].sum() + 8.0 * (here.sum() + there.sum() - 2 * len(taken[0]))
    ours = trajectory_gospa(found, targets, cutoff_px=4.0, switch_px=0.0)
    assert ours.distance**2 == pytest.approx(total, rel=1e-7)
    assert ours.switching == 0


def test_parts_of_a_hand_example():
    # One pair 3 px apart in 8 of 10 frames, one target missed, one trajectory of 4 frames false.
    found = [straight(0, 3), straight(0, 50)]
    found[0][8:] = np.nan
    found[1][4:] = np.nan
    targets = [straight(0, 0), straight(0, 100)]
    ours = trajectory_gospa(found, targets, cutoff_px=6.0, switch_px=2.0)
    assert (ours.localisation, ours.missed, ours.false, ours.switching) == (
        8 * 9, (2 + 10) * 18, 4 * 18, 0)
    assert ours.distance == pytest.approx(np.sqrt(72 + 216 + 72))


def test_swapped_identities_cost_one_change_each():
    targets = np.array([straight(0, 0), straight(0, 4)])
    swapped = targets.copy()
    swapped[:, 5:] = targets[::-1, 5:]
    ours = trajectory_gospa(swapped, targets, cutoff_px=10.0, switch_px=3.0)
    assert ours.switching == pytest.approx(2 * 3.0**2)
    assert ours.localisation == pytest.approx(0, abs=1e-9)
    # When changing is dearer than being off, nothing changes.
    stays = trajectory_gospa(swapped, targets, cutoff_px=10.0, switch_px=30.0)
    assert stays.switching == 0
    assert stays.localisation == pytest.approx(2 * 5 * 16)


@pytest.mark.parametrize('seed', range(6))
@pytest.mark.parametrize('switch', [0.5, 2.0])
def test_long_meetings_equal_the_programme_of_the_definition(seed, switch):
    # Runs of frames in which some pairs compete and others do not, and some are absent.
    rng = np.random.default_rng([seed, 20])
    frames = np.arange(16.0)[:, None]
    targets = rng.uniform(0, 9, (4, 1, 2)) + rng.uniform(-0.7, 0.7, (4, 1, 2)) * frames
    found = targets + rng.normal(0, 0.6, targets.shape)
    for frame in (5, 9, 12):
        found[:, frame:] = found[rng.permutation(4), frame:]
    found[1, 3:7] = np.nan
    targets[2, :4] = np.nan
    ours = trajectory_gospa(found, targets, cutoff_px=3.0, switch_px=switch)
    expected = slow_gospa(found, targets, 3.0, switch, 2.0)
    assert ours.distance == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize('seed', range(3))
def test_is_a_metric(seed):
    def distance(one, other):
        return trajectory_gospa(one, other, cutoff_px=4.0, switch_px=2.0).distance

    first, second = random_scene(seed, 3, 3)
    third, _ = random_scene(50 + seed, 4, 1)
    assert distance(first, first) == 0
    assert distance(first, second) == pytest.approx(distance(second, first))
    assert distance(first, third) <= distance(first, second) + distance(second, third) + 1e-9


def test_nothing_against_something_and_nothing():
    targets = [straight(0, 0)]
    assert trajectory_gospa([], targets, cutoff_px=2, switch_px=1).missed == 10 * 2
    assert trajectory_gospa(targets, [], cutoff_px=2, switch_px=1).false == 10 * 2
    assert trajectory_gospa([], [], cutoff_px=2, switch_px=1).distance == 0


@pytest.mark.parametrize('n_swaps', [10, 60])
def test_two_hundred_targets_in_two_hundred_frames_take_less_than_a_second(n_swaps):
    rng = np.random.default_rng(3)
    heading, speed = rng.uniform(0, 2 * np.pi, 200), rng.uniform(0, 1, 200)
    velocity = speed * np.array([np.cos(heading), np.sin(heading)])
    targets = (rng.uniform(0, 512, (200, 1, 2))
               + np.arange(200)[:, None] * velocity.T[:, None])
    found = targets + rng.normal(0, 0.5, targets.shape)
    # Some meet and go on under the name of the other, some are not found.
    apart = np.linalg.norm(targets[:, None] - targets[None], axis=3)
    meetings = np.argwhere(apart < 3)
    meetings = meetings[meetings[:, 0] < meetings[:, 1]]
    # Each two once.
    _, first = np.unique(meetings[:, :2], axis=0, return_index=True)
    for one, other, frame in rng.permutation(meetings[first])[:n_swaps]:
        found[[one, other], frame:] = found[[other, one], frame:]
    seconds = []
    for _ in range(3):
        began = time.process_time()
        ours = trajectory_gospa(found[:190], targets, cutoff_px=5.0, switch_px=5.0)
        seconds.append(time.process_time() - began)
    # The least, since whatever else the machine does adds to the others.
    assert min(seconds) < 1.0
    assert ours.missed >= 10 * 200 * 12.5
    assert ours.switching > 0


@pytest.mark.parametrize(
    ('options', 'message'),
    [({'cutoff_px': 0.0}, 'cutoff_px must be above 0'),
     ({'switch_px': -1.0}, 'switch_px at least 0'),
     ({'order': 0.5}, 'order at least 1')])
def test_bad_option_is_refused(options, message):
    with pytest.raises(ParameterError, match=message):
        trajectory_gospa([], [], **{'cutoff_px': 1.0, 'switch_px': 1.0, **options})


@pytest.mark.parametrize(
    ('found', 'message'),
    [([np.zeros((4, 2))], 'same frames, got 4 and 10'),
     ([np.zeros((10, 2)), np.zeros((9, 2))], 'found must be trajectories of one shape')])
def test_trajectories_of_other_frames_are_refused(found, message):
    with pytest.raises(DataError, match=message):
        trajectory_gospa(found, [straight(0, 0)], cutoff_px=1.0, switch_px=1.0)
