"""What the strongest path passes as rarely as asked, from the paths behind it."""

import numpy as np
import pytest

from track_before_detect.solvers.clutter.path_tail import path_tail, PathTail

DRAWS = 4000


@pytest.mark.parametrize('rate', [0.01, 0.05, 0.2])
@pytest.mark.parametrize('n_places', [16, 80, 480])
def test_strongest_of_exponential_paths_passes_as_rarely_as_asked(rate, n_places):
    rng = np.random.default_rng([7, n_places])
    passed = 0
    for _ in range(DRAWS):
        strongest, *others = np.sqrt(np.sort(25 + 8 * rng.exponential(size=62))[::-1])
        passed += strongest > path_tail(others, n_places).threshold(rate)
    spread = np.sqrt(rate * (1 - rate) / DRAWS)
    # Three deviations of the count; the formula is exact to a tenth.
    assert abs(passed / DRAWS - rate) < 3 * spread + 0.1 * rate


def test_rate_does_not_depend_on_level_and_size_of_the_statistics():
    squares = np.random.default_rng(3).exponential(size=62)
    for rate in (0.01, 0.3):
        plain = path_tail(np.sqrt(squares), 300).threshold(rate)**2
        other = path_tail(np.sqrt(40 + 9 * squares), 300).threshold(rate)**2
        assert other == pytest.approx(40 + 9 * plain)


def test_smaller_share_of_the_frame_asks_less_and_a_smaller_rate_more():
    tail = PathTail(5.0, 1.0, 20)
    shares = [tail.threshold(0.05, share) for share in (1.0, 0.3, 0.01)]
    assert shares == sorted(shares, reverse=True)
    assert shares[0] > shares[1]
    assert tail.threshold(0.01) > tail.threshold(0.05) > tail.threshold(0.2)
    # A place so small that hardly any path comes to it: not below what the others begin at.
    assert tail.threshold(0.05, 1e-9) == pytest.approx(np.sqrt(tail.start))


def test_fewer_paths_ask_more_for_what_they_do_not_tell():
    excesses = [PathTail(0.0, 1.0, count).threshold(0.05)**2 - np.log(count + 1)
                for count in (2, 5, 10, 20, 40)]
    assert excesses == sorted(excesses, reverse=True)
    assert excesses[0] > 2 * excesses[-1]
    assert excesses[-1] > -np.log(0.05)


def test_more_places_reach_further_in_until_clutter_differs():
    statistics = np.linspace(20, 1, 61)
    counts = [path_tail(statistics, places).count for places in (1, 16, 80, 200, 320, 9000)]
    assert counts == [2, 2, 10, 25, 40, 40]
    tail = path_tail(statistics[::-1], 80)
    squares = statistics**2
    assert tail.start == pytest.approx(squares[10])
    assert tail.scale == pytest.approx(np.mean(squares[:10] - squares[10]))


def test_more_paths_of_the_same_tail_ask_more_of_the_strongest():
    rng = np.random.default_rng(11)
    few, many = (np.mean([path_tail(np.sqrt(rng.exponential(size=n)), 320).threshold(0.05)**2
                          for _ in range(300)]) for n in (80, 640))
    assert many - few == pytest.approx(np.log(640 / 80), abs=0.2)


def test_three_paths_are_enough():
    assert np.isfinite(path_tail([3.0, 2.0, 1.0], 1).threshold(0.01))
