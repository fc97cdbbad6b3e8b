"""Fletcher-Reeves conjugate gradient with a strong-Wolfe line search and an optional metric.

    p_0 = -M^-1 g_0,    x_{k+1} = x_k + alpha_k p_k,    p_{k+1} = -M^-1 g_{k+1} + beta_k p_k
    beta_k = (g_{k+1}' M^-1 g_{k+1}) / (g_k' M^-1 g_k)                   Fletcher & Reeves 1964

The step satisfies the strong Wolfe conditions with c2 < 1/2, so that every direction is one of descent, g' p < 0
(Al-Baali 1985). The metric M is constant between restarts: the method is Fletcher-Reeves in other coordinates. It
restarts after ``period`` steps, when consecutive gradients are far from orthogonal (Powell 1977), and when rounding
errors leave no descent.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

Objective = Callable[[np.ndarray], tuple[float, np.ndarray]]
"""x (n,) -> value, gradient (n,)."""
Metric = Callable[[np.ndarray], Callable[[np.ndarray], np.ndarray]]
"""x (n,) -> the function g -> M^-1 g for a positive definite M that suits x."""
Curvature = Callable[[np.ndarray, np.ndarray], float]
"""x (n,), direction p (n,) -> approximate second derivative of the objective along p, for the first trial step."""


@dataclass(frozen=True)
class Iterate:
    """One accepted step: ``slope`` g' p at its start (negative), ``restarted`` why p is steepest descent, or ""."""

    x: np.ndarray
    value: float
    gradient: np.ndarray
    step: float
    slope: float
    restarted: str


@dataclass(frozen=True)
class Point:
    """A point of a line search: ``step`` along the direction, ``slope`` the derivative along it."""

    step: float
    value: float
    slope: float
    x: np.ndarray
    gradient: np.ndarray


def fletcher_reeves(
    objective: Objective,
    start: np.ndarray,
    metric: Metric | None = None,
    curvature: Curvature | None = None,
    *,
    c1: float = 1e-4,
    c2: float = 0.4,
    period: int = 0,
    powell: float = 0.5,
) -> Iterator[Iterate]:
    """Yield iterates of decreasing value until no step along steepest descent improves. ``period`` 0: len(start).

    ``metric`` and ``curvature`` are optional approximations of second derivatives. With a good curvature the first
    trial of most line searches is accepted.
    """
    x = np.asarray(start, float)
    value, gradient = objective(x)
    period = period or len(x)
    step, reason = 1.0, "start"
    while True:
        if reason:
            precondition = metric(x) if metric else _identity
            scaled = precondition(gradient)
            direction, square, age = -scaled, float(gradient @ scaled), 0
        slope = float(gradient @ direction)
        if not slope < 0.0:
            return
        bend = curvature(x, direction) if curvature else 0.0
        origin = Point(0.0, value, slope, x, gradient)
        point = strong_wolfe(objective, origin, direction, -slope / bend if bend > 0.0 else step, c1, c2)
        if point is None:
            if age == 0:
                return
            step, reason = 1.0, "line search"
            continue
        yield Iterate(point.x, point.value, point.gradient, point.step, slope, reason)
        previous, previous_square = gradient, square
        x, value, gradient, age = point.x, point.value, point.gradient, age + 1
        scaled = precondition(gradient)
        square = float(gradient @ scaled)
        direction = square / previous_square * direction - scaled
        next_slope = float(gradient @ direction)
        step = point.step * min(10.0, slope / next_slope) if next_slope < 0.0 else 1.0
        reason = _restart_reason(next_slope, bool(abs(previous @ scaled) >= powell * square), age >= period)


def _identity(gradient: np.ndarray) -> np.ndarray:
    return gradient


def _restart_reason(slope: float, overlap: bool, old: bool) -> str:
    if not slope < 0.0:
        return "no descent"
    if overlap:
        return "not orthogonal"
    return "period" if old else ""


def strong_wolfe(
    objective: Objective, origin: Point, direction: np.ndarray, step: float, c1: float, c2: float, limit: int = 20
) -> Point | None:
    """A step with value <= f0 + c1 step f0' and |f'| <= c2 |f0'|, first tried at ``step``.

    Bracketing, then sectioning (Nocedal & Wright 2006, algorithms 3.5 and 3.6). After ``limit`` evaluations the best
    point with the first property is returned, or None where there is none, because rounding hides any descent.
    """
    low, high = origin, None
    for _ in range(limit):
        x = origin.x + step * direction
        value, gradient = objective(x)
        trial = Point(step, value, float(gradient @ direction), x, gradient)
        if not (value <= origin.value + c1 * step * origin.slope and (low is origin or value < low.value)):
            high = trial
        elif abs(trial.slope) <= -c2 * origin.slope:
            return trial
        elif high is None and trial.slope < 0.0:
            low, step = trial, 4.0 * step
            continue
        else:
            if high is None or trial.slope * (high.step - low.step) >= 0.0:
                high = low
            low = trial
        step = _between(low, high)
        if abs(high.step - low.step) <= 1e-10 * step:
            break
    return None if low is origin else low


def _between(low: Point, high: Point) -> float:
    """Minimum of the cubic through two points (Nocedal & Wright 2006 eq. 3.59), kept away from both ends."""
    width = high.step - low.step
    fraction = 0.5
    if np.isfinite(high.value) and np.isfinite(high.slope):
        d1 = low.slope + high.slope - 3.0 * (high.value - low.value) / width
        square = d1 * d1 - low.slope * high.slope
        if square >= 0.0:
            d2 = np.copysign(np.sqrt(square), width)
            denominator = high.slope - low.slope + 2.0 * d2
            if denominator != 0.0:
                fraction = 1.0 - (high.slope + d2 - d1) / denominator
    return low.step + width * min(max(fraction, 0.1), 0.9)
