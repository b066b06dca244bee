import math

import pytest
from scipy import stats

from pcs_racing import InputError
from pcs_racing_agents.tournament.statistics.student_t import critical_value, noncentral_power, two_sided_p

DFS = (1, 2, 4, 19, 200, 1000)


@pytest.mark.parametrize("df", DFS)
def test_tails_are_those_of_scipy_even_far_out(df):
    for t in (0.0, 1e-6, 0.5, 1.0, 2.0, 5.0, 12.0, 40.0):
        assert two_sided_p(t, df) == pytest.approx(2.0 * stats.t.sf(t, df), rel=1e-9)
        assert two_sided_p(-t, df) == two_sided_p(t, df)


@pytest.mark.parametrize("df", DFS)
def test_critical_values_are_those_of_scipy(df):
    for level in (0.5, 0.9, 0.95, 0.999):
        assert critical_value(level, df) == pytest.approx(stats.t.ppf(0.5 + 0.5 * level, df), rel=1e-10)


@pytest.mark.parametrize("df", DFS)
def test_power_is_that_of_the_noncentral_t(df):
    limit = stats.t.ppf(0.975, df)
    for shift in (0.0, 1.0, 2.8):
        expected = stats.nct.sf(limit, df, shift) + stats.nct.cdf(-limit, df, shift)
        assert noncentral_power(shift, df) == pytest.approx(expected, abs=1e-8)


def test_the_ends():
    assert two_sided_p(math.inf, 3) == two_sided_p(-math.inf, 1) == 0.0
    assert two_sided_p(0.0, 3) == pytest.approx(1.0)
    assert noncentral_power(0.0, 19, 0.9) == pytest.approx(0.1)
    assert noncentral_power(1e3, 19) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: two_sided_p(math.nan, 3), "t is nan"),
        (lambda: two_sided_p(1.0, 0), "df is 0"),
        (lambda: critical_value(1.0, 3), "level is 1.0"),
        (lambda: critical_value(0.95, 0), "df is 0"),
        (lambda: noncentral_power(1.0, 3, 95), "level is 95"),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(InputError, match=message):
        call()
