from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy import stats

from track_before_detect.errors import ParameterError
from track_before_detect.evaluation.metrics.confidence import (
    bootstrap_interval,
    poisson_interval,
    wilson_interval,
)


@st.composite
def proportions(draw):
    trials = draw(st.integers(1, 5000))
    return draw(st.integers(0, trials)), trials


@given(proportions())
def test_ends_of_the_wilson_interval_are_1_96_deviations_from_the_share(proportion):
    successes, trials = proportion
    ends = wilson_interval(successes, trials)
    for end, sure in zip(ends, (successes == 0, successes == trials), strict=True):
        if sure:
            assert end == successes / trials
        else:
            deviations = (successes / trials - end) / np.sqrt(end * (1 - end) / trials)
            assert abs(deviations) == pytest.approx(stats.norm.ppf(0.975), rel=1e-6)
    assert ends[0] <= successes / trials <= ends[1]


@given(st.integers(0, 200), st.floats(0.1, 1000.0))
def test_poisson_interval_leaves_half_of_the_rest_on_either_side(count, exposure):
    low, high = poisson_interval(count, exposure)
    assert stats.poisson.cdf(count, high * exposure) == pytest.approx(0.025, abs=1e-9)
    if count:
        assert stats.poisson.sf(count - 1, low * exposure) == pytest.approx(0.025, abs=1e-9)
    else:
        assert low == 0.0


def test_bootstrap_interval_of_a_mean_is_near_the_normal_one():
    values = np.random.default_rng(0).normal(3.0, 2.0, 400)
    low, high = bootstrap_interval(values, lambda drawn: float(drawn.mean()))
    half = 1.96 * values.std() / 20
    assert low == pytest.approx(values.mean() - half, abs=0.2 * half)
    assert high == pytest.approx(values.mean() + half, abs=0.2 * half)


def test_bootstrap_keeps_the_numbers_of_a_run_together_and_repeats():
    runs = np.column_stack([np.arange(1.0, 21.0), 2 * np.arange(1.0, 21.0)])
    ends = bootstrap_interval(runs, lambda drawn: float(drawn[:, 1].sum() / drawn[:, 0].sum()))
    assert ends == pytest.approx((2.0, 2.0))
    assert bootstrap_interval(runs, np.mean) == bootstrap_interval(runs, np.mean)


def test_bootstrap_of_one_run_has_no_width():
    assert bootstrap_interval([[3.0, 5.0]], np.mean) == (4.0, 4.0)


@pytest.mark.parametrize(
    ('call', 'said'),
    [(lambda: wilson_interval(1, 0), 'got 1 of 0'),
     (lambda: wilson_interval(5, 4), 'got 5 of 4'),
     (lambda: poisson_interval(-1), 'got -1'),
     (lambda: poisson_interval(1, 0.0), 'exposure above 0'),
     (lambda: bootstrap_interval([], np.mean), 'at least 1 run')])
def test_what_has_no_interval_is_refused(call, said):
    with pytest.raises(ParameterError, match=said):
        call()
