"""Chi-square quantiles against printed tables."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hsvaos.nav.chi_square import chi_square_cdf, chi_square_quantile, mean_bounds


@pytest.mark.parametrize(
    ("probability", "dof", "expected"),
    [
        (0.95, 1, 3.841459),
        (0.95, 3, 7.814728),
        (0.99, 2, 9.210340),
        (0.999, 3, 16.266236),
        (0.5, 10, 9.341818),
        (0.025, 100, 74.221927),
        (0.975, 100, 129.561197),
    ],
)
def test_quantiles_of_the_tables(probability, dof, expected):
    assert chi_square_quantile(probability, dof) == pytest.approx(expected, abs=1e-5)


@given(st.floats(1e-4, 1.0 - 1e-4), st.integers(1, 3000))
def test_quantile_undoes_the_distribution(probability, dof):
    assert chi_square_cdf(chi_square_quantile(probability, dof), dof) == pytest.approx(
        probability, abs=1e-8
    )


def test_bounds_of_a_mean_close_in_on_the_expectation():
    wide, narrow = mean_bounds(0.95, 9.0, 20), mean_bounds(0.95, 9.0, 2000)
    assert wide[0] < narrow[0] < 9.0 < narrow[1] < wide[1]
    assert narrow[1] - narrow[0] == pytest.approx(2 * 1.96 * (18.0 / 2000) ** 0.5, rel=0.01)


@pytest.mark.parametrize(("probability", "dof"), [(0.0, 1), (1.0, 1), (0.5, 0)])
def test_arguments_out_of_range_are_refused(probability, dof):
    with pytest.raises(ValueError, match="expected a probability"):
        chi_square_quantile(probability, dof)
