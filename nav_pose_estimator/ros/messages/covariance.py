"""What a covariance field of a message says: known, unknown or absent.

ROS messages have no field for "I do not know". Drivers write zeros (unknown), -1 in the first element (no such
measurement, or unknown again), NaN, or numbers that cannot be a covariance. One reading of all of them is here.
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
    """Whether the sender knows its error."""

    KNOWN = "known"
    UNKNOWN = "unknown"
    ABSENT = "absent"  # first element -1: the measurement itself is missing, or (MAVROS) its error is unknown


@dataclass(frozen=True, slots=True)
class Reading:
    """``matrix`` (n, n) is None unless known; ``flaw`` names what is wrong with an unusable one, else empty."""

    knowledge: Knowledge
    matrix: np.ndarray | None = None
    flaw: str = ""


def read(field: Sequence[float] | np.ndarray, size: int, block: int | None = None) -> Reading:
    """Read a row-major ``size`` x ``size`` field; with ``block`` only its upper left ``block`` x ``block`` part.

    A flawed matrix is as good as unknown: the caller uses its own default and reports the flaw.
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
    """A single variance (None if unknown) and the flaw of an unusable one."""
    value = float(value)
    if value in (0.0, -1.0):
        return None, ""
    if not math.isfinite(value):
        return None, "not_finite"
    if value < 0.0:
        return None, "negative"
    return (None, "too_large") if value > _LARGEST else (value, "")


def _is_plain(values: list[float], part: int) -> bool:
    """Whether it is diagonal and without flaw: as most drivers fill it, and seen at once."""
    variances = values[:: part + 1]
    return values.count(0.0) == len(values) - part and all(0.0 < value <= _LARGEST for value in variances)


def _flaw(matrix: np.ndarray) -> str:
    """One word for why ``matrix`` is not the covariance of a measured vector; empty if it is one."""
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
