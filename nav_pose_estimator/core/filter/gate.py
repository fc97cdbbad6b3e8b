"""Chi-square quantiles: thresholds of the gates on the normalised innovation squared (NIS).

The NIS of an m-dimensional observation of a consistent filter is chi-square distributed with m degrees of freedom.
"""

import math


def chi_square_quantile(probability: float, dof: int) -> float:
    """Quantile of the chi-square distribution with ``dof`` degrees of freedom at ``probability``.

    It is found by bisection of the closed-form tail (``chi_square_tail``), which saves the quarter of a second that
    importing scipy.special takes. The result is exact to the rounding of 1 - ``probability``.
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
    """Probability that a chi-square variable with ``dof`` >= 1 degrees of freedom exceeds ``x`` >= 0.

    Source: Abramowitz and Stegun, 26.4.4 and 26.4.5, a finite sum over every second number up to ``dof``.
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
