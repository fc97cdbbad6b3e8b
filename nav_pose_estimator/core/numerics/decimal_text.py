"""Tables of numbers as text with fixed decimals, digit by digit in compiled code, where this is certain to be exact."""

from collections.abc import Sequence

import numpy as np

from nav_pose_estimator.core.numerics.jit import COMPILED, kernel

Array = np.ndarray
_LONGEST = 20  # characters of the longest number that the kernel writes, its separator included
_LARGEST = 1e15  # numbers with more digits are left to Python
_ROUNDING = 1e-15  # bound of the relative rounding error of a number times a power of ten, with a factor of 9 in hand


def decimal_rows(table: Array, decimals: Sequence[int], separator: str) -> list[str]:
    """Text of each row of ``table`` (N, K), as of ``"%.4f"`` with the ``decimals`` (K,) > 0 of each column."""
    form = separator.join(f"%.{count}f" for count in decimals)
    if not COMPILED:
        return [form % tuple(row) for row in table.tolist()]
    out = np.empty(table.size * _LONGEST, np.uint8)
    scales, places = 10.0 ** np.array(decimals), np.array(decimals)
    rows: list[str] = []
    while len(rows) < len(table):
        end, length = _write(table, scales, places, ord(separator), len(rows), out)
        rows += out[:length].tobytes().decode("ascii").split("\n")[:-1]
        if end < len(table):
            rows.append(form % tuple(table[end].tolist()))
    return rows


@kernel
def _write(table, scales, places, separator, begin, out):
    """Write rows from ``begin`` on to ``out``, up to one with a number that is too large or whose rounding is unclear.

    Returns the number of that row, or N, and the number of characters.
    """
    n = 0
    for row in range(begin, table.shape[0]):
        start = n
        for column in range(table.shape[1]):
            scaled = abs(table[row, column]) * scales[column]
            if not scaled < _LARGEST:  # true for NaN
                return row, start
            whole = np.floor(scaled)
            above_half = scaled - whole - 0.5
            if abs(above_half) <= _ROUNDING * scaled:
                return row, start
            if np.signbit(table[row, column]):
                out[n] = 45  # minus
                n += 1
            n = _write_digits(int(whole) + (1 if above_half > 0.0 else 0), places[column], out, n)
            out[n] = separator if column + 1 < table.shape[1] else 10
            n += 1
    return table.shape[0], n


@kernel
def _write_digits(digits, places, out, n):
    """Write an integer with the decimal point in front of its last ``places`` digits; return the position after it."""
    count, limit = 1, 10 ** (places + 1)
    while digits >= limit:
        count, limit = count + 1, limit * 10
    end = n + count + 1 + places
    for i in range(end - 1, n - 1, -1):
        if i == n + count:
            out[i] = 46  # point
        else:
            out[i] = 48 + digits % 10
            digits //= 10
    return end
