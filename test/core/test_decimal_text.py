"""Tables as text: to the character what Python writes."""

import math

import numpy as np
import pytest

from nav_pose_estimator.core.numerics.decimal_text import decimal_rows

DECIMALS = (4, 9, 1)


def by_python(row: list[float]) -> list[str]:
    return [f"{value:.{count}f}" for value, count in zip(row, DECIMALS, strict=True)]


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e4, 1e9, 1e18])
def test_any_numbers_are_written_as_python_does(scale: float) -> None:
    table = np.random.default_rng(5).normal(0.0, scale, (2000, 3))
    assert decimal_rows(table, DECIMALS, ",") == [",".join(by_python(row)) for row in table.tolist()]


def test_numbers_half_way_between_two_texts_and_special_ones_are_written_as_python_does() -> None:
    """GIVEN numbers next to the middle between two decimals, integers, zeros, infinity and NaN WHEN they are written
    THEN each is rounded as its exact binary value demands."""
    middles = (np.arange(-300, 300) + 0.5) * 1e-4
    near = np.concatenate([middles, np.nextafter(middles, 1.0), np.nextafter(middles, -1.0)])
    special = [0.0, -0.0, 0.25, -0.75, 0.05, 9.99995, -1e-9, 1e15, math.inf, -math.inf, math.nan, 12345.0]
    values = np.concatenate([near, special])
    table = np.column_stack([values, values, values])
    assert decimal_rows(table, DECIMALS, " ") == [" ".join(by_python(row)) for row in table.tolist()]


def test_no_rows_are_no_text() -> None:
    assert decimal_rows(np.empty((0, 3)), DECIMALS, ",") == []
