"""What the strongest path passes as rarely as asked, from the paths behind it."""

import numpy as np
import pytest

from track_before_detect.solvers.clutter.path_tail import path_tail, tail_behind

DRAWS = 400
# A tail of noise in 16 frames, one of a few frames, and of bright clutter above a dim bulk: where
# it begins, and the mean excess there.
FAR, NEAR, BRIGHT = (8.4, 0.2), (4.5, 0.5), (20.0, 5.0)


def statistics(rng, tail, shape, count=62):
    """Draw statistics of which a power is exponential, the largest first."""
    start, excess = tail
    scale = shape * start**(shape - 1) * excess
    return (start**shape + scale * np.sort(rng.exponential(size=count))[::-1])**(1 / shape)


@pytest.mark.parametrize('n_places', [16, 480])
@pytest.mark.parametrize('tail', [FAR, NEAR])
@pytest.mark.parametrize('shape', [1.0, 2.0])
def test_strongest_path_passes_within_twice_as_rarely_or_often_as_asked(n_places, tail, shape):
    asked = np.array([0.05, 0.2])
    passed = share_passing(asked, n_places, tail, shape)
    spread = 3 * np.sqrt(asked / DRAWS)
    assert np.all(passed < 2 * asked)
    assert np.all(passed > asked / 2 - spread)


def share_passing(rates, n_places, tail, shape):
    rng = np.random.default_rng([7, n_places])
    passed = np.zeros(len(rates))
    for _ in range(DRAWS):
        strongest, *others = statistics(rng, tail, shape)
        beyond = path_tail(others, n_places)
        passed += [strongest > beyond.threshold(rate) for rate in rates]
    return passed / DRAWS


def test_threshold_is_in_the_units_of_the_statistics():
    seen = statistics(np.random.default_rng(3), NEAR, 2.0)
    for rate in (0.01, 0.3):
        plain = path_tail(seen, 300).threshold(rate)
        assert path_tail(7 * seen, 300).threshold(rate) == pytest.approx(7 * plain)


def test_clutter_of_many_levels_asks_more_than_noise_that_begins_at_the_same():
    """Where excesses are small, what is exponential makes no difference; where large it does."""
    ratios = []
    for tail in (FAR, BRIGHT):
        thresholds = [np.mean([path_tail(statistics(np.random.default_rng(k), tail, shape),
                                         320).threshold(0.01) for k in range(30)])
                      for shape in (2.0, 0.7)]
        ratios.append(thresholds[1] / thresholds[0])
    assert 1 < ratios[0] < 1.1
    assert ratios[1] > 1.2


def test_smaller_share_of_the_frame_asks_less_and_a_smaller_rate_more():
    tail = path_tail(statistics(np.random.default_rng(5), NEAR, 2.0), 160)
    shares = [tail.threshold(0.05, share) for share in (1.0, 0.3, 0.01)]
    assert shares == sorted(shares, reverse=True)
    assert shares[0] > shares[1]
    assert tail.threshold(0.01) > tail.threshold(0.05) > tail.threshold(0.2)
    # A place so small that hardly any path comes to it: not below what the others begin at.
    assert tail.threshold(0.05, 1e-9) == tail.start


def test_fewer_paths_ask_more_for_what_they_do_not_tell():
    """Every path of the tail tells of its scale; each is asked what one of so many passes."""
    excesses = []
    for count in (2, 5, 10, 20, 40):
        few = [*[4.5] * count, 4.0]
        tail = path_tail(few, 8 * count)
        assert tail.count == count
        excesses.append(tail.threshold(0.05 * (count + 1)) - 4)
    assert excesses == sorted(excesses, reverse=True)
    assert excesses[0] > 2 * excesses[-1]


def test_more_places_reach_further_in_until_clutter_differs():
    seen = np.linspace(20, 1, 61)
    counts = [path_tail(seen, places).count for places in (1, 16, 80, 200, 320, 9000)]
    assert counts == [2, 2, 10, 25, 40, 40]
    assert path_tail(seen[::-1], 80).start == seen[10]


def test_more_paths_of_the_same_tail_ask_more_of_the_strongest():
    few, many = (np.mean([path_tail(statistics(np.random.default_rng([11, k]), NEAR, 2.0, n),
                                    320).threshold(0.05)**2 for k in range(100)])
                 for n in (80, 640))
    scale = 2 * NEAR[0] * NEAR[1]
    assert many - few == pytest.approx(scale * np.log(640 / 80), rel=0.3)


@pytest.mark.parametrize('n_targets', [1, 2, 4, 9])
def test_targets_of_one_strength_do_not_hide_each_other(n_targets):
    rng = np.random.default_rng([13, n_targets])
    hidden = found = 0
    for _ in range(40):
        clutter = statistics(rng, NEAR, 1.0)
        targets = 3 * clutter[0] * rng.uniform(0.9, 1.1, n_targets)
        strongest, *others = np.sort([*targets, *clutter])[::-1]
        found += strongest > tail_behind(others, 320, 0.05).threshold(0.05)
        hidden += strongest <= path_tail(others, 320).threshold(0.05)
    assert found == 40
    assert (hidden > 20) == (n_targets == 9)


@pytest.mark.parametrize('shape', [0.7, 1.0, 2.0])
def test_allowing_for_targets_lets_little_more_pass(shape):
    rng = np.random.default_rng(17)
    passed = np.zeros(2)
    for _ in range(DRAWS):
        strongest, *others = statistics(rng, NEAR, shape)
        passed += [strongest > tail.threshold(0.05)
                   for tail in (path_tail(others, 320), tail_behind(others, 320, 0.05))]
    alone, allowing = passed / DRAWS
    assert alone <= allowing < 1.5 * alone + 0.02


@pytest.mark.parametrize('seen', [[3.0, 2.0, 1.0], [5.0, 0.0, 0.0], [0.0, 0.0, 0.0], [4.0] * 9])
def test_few_or_equal_paths_are_enough(seen):
    threshold = path_tail(seen, 1).threshold(0.01)
    assert np.isfinite(threshold)
    assert threshold >= min(seen)
