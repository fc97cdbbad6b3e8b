"""Interpretation of the covariance fields of messages: known, unknown or absent.

ROS messages have no field that marks a covariance as unknown. Drivers write zeros (unknown), -1 in the first element
(no such measurement, or unknown), NaN, or numbers that are not a covariance. This module interprets all of them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

_LARGEST = 1e12  # a variance above this is a placeholder such as 1.8e308, not a measurement
_ASYMMETRY = 1e-6  # relative: single-precision drivers round the two halves differently
_TOLERANCE = -1e-9  # relative: smallest eigenvalue of a matrix that is semi-definite but for rounding


class Knowledge(Enum):
    """Whether the sender knows the covariance of its error."""

    KNOWN = "known"
    UNKNOWN = "unknown"
    ABSENT = "absent"  # first element -1: the measurement itself is missing, or (MAVROS) its error is unknown


@dataclass(frozen=True, slots=True)
class Reading:
    """Interpreted field: ``matrix`` (n, n), None unless known; ``flaw`` names the defect of an unusable one."""

    knowledge: Knowledge
    matrix: np.ndarray | None = None
    flaw: str = ""


def read(field: Sequence[float] | np.ndarray, size: int, block: int | None = None) -> Reading:
    """Read a row-major ``size`` x ``size`` field; with ``block`` only its upper left ``block`` x ``block`` part.

    A defective matrix counts as unknown: the caller uses its own default and reports the ``flaw``.
    """
    part = block or size
    values = [float(field[size * row + column]) for row in range(part) for column in range(part)]
    if values[0] == -1.0:
        return Reading(Knowledge.ABSENT)
    if not any(values):
        return Reading(Knowledge.UNKNOWN)
    matrix = np.array(values).reshape(part, part)
    if _is_plain(values, part):
        return Reading(Knowledge.KNOWN, matrix)
    flaw = _flaw(matrix)
    return Reading(Knowledge.UNKNOWN, flaw=flaw) if flaw else Reading(Knowledge.KNOWN, 0.5 * (matrix + matrix.T))


def read_variance(value: float) -> tuple[float | None, str]:
    """Read a single variance: its value, None if unknown, and the name of its defect, empty without one."""
    value = float(value)
    if value in (0.0, -1.0):
        return None, ""
    if not math.isfinite(value):
        return None, "not_finite"
    if value < 0.0:
        return None, "negative"
    return (None, "too_large") if value > _LARGEST else (value, "")


def _is_plain(values: list[float], part: int) -> bool:
    """Whether the matrix is diagonal and without a defect, the most frequent case, which is quick to recognise."""
    variances = values[:: part + 1]
    return values.count(0.0) == len(values) - part and all(0.0 < value <= _LARGEST for value in variances)


def _flaw(matrix: np.ndarray) -> str:
    """Name of the defect because of which ``matrix`` cannot be a covariance; empty without one."""
    if not np.isfinite(matrix).all():
        return "not_finite"
    variances = np.diag(matrix)
    if variances.min() < 0.0:
        return "negative"
    if np.abs(matrix).max() > _LARGEST:
        return "too_large"
    if variances.min() == 0.0:
        return "zero_variance"
    spread = np.sqrt(variances)
    correlation = matrix / np.outer(spread, spread)
    if np.abs(correlation - correlation.T).max() > _ASYMMETRY:
        return "asymmetric"
    return "indefinite" if np.linalg.eigvalsh(correlation)[0] < _TOLERANCE else ""
