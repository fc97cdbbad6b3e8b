"""Thresholds of the gates on the normalised innovation squared, for any number of rows.

Of an honest filter the NIS of m rows is chi-square distributed with m degrees of freedom.
"""

import math


def chi_square_quantile(probability: float, dof: int) -> float:
    """The value that a chi-square variable of ``dof`` degrees of freedom exceeds with 1 - ``probability``.

    By bisection of the tail in closed form (``chi_square_tail``): a few lines instead of a quarter of a second to load
    scipy.special. The result is exact to rounding of 1 - ``probability``.
    """
    tail, low, high = 1.0 - probability, 0.0, 2000.0 + 2.0 * dof
    while True:
        middle = 0.5 * (low + high)
        if not low < middle < high:
            return middle
        if chi_square_tail(middle, dof) > tail:
            low = middle
        else:
            high = middle


def chi_square_tail(x: float, dof: int) -> float:
    """Probability that a chi-square variable of ``dof`` degrees of freedom (1 or more) exceeds ``x`` (0 or more).

    Source: Abramowitz and Stegun, 26.4.4 and 26.4.5, a finite sum over every other number up to ``dof``.
    """
    if dof < 1:
        raise ValueError(f"chi-square has one degree of freedom or more, not {dof}")
    first = 2 - dof % 2
    density = math.exp(-0.5 * x)
    tail = density if first == 2 else math.erfc(math.sqrt(0.5 * x))
    term = density if first == 2 else math.sqrt(2.0 * x / math.pi) * density
    for k in range(first, dof, 2):
        term *= x / k if k > 1 else 1.0
        tail += term
    return tail
