"""Thresholds for any number of rows, against scipy."""

import pytest
from scipy.stats import chi2

from nav_pose_estimator.core.filter.gate import chi_square_quantile, chi_square_tail


@pytest.mark.parametrize("dof", [1, 2, 3, 4, 5, 6, 7, 8, 15, 16, 100])
@pytest.mark.parametrize("probability", [0.5, 0.9, 0.99, 0.999, 0.999999999])
def test_quantiles_are_those_of_scipy(dof: int, probability: float) -> None:
    assert chi_square_quantile(probability, dof) == pytest.approx(chi2.isf(1.0 - probability, dof), rel=1e-10)


def test_four_rows_have_a_threshold_of_their_own() -> None:
    assert chi_square_quantile(0.99, 4) == pytest.approx(13.2767, abs=1e-4)


def test_a_number_of_rows_below_one_is_an_error() -> None:
    with pytest.raises(ValueError, match="one degree"):
        chi_square_tail(1.0, 0)
