"""Smoothed velocity for controllers: corrections of the estimate enter it with a bounded rate of change.

The last published velocity, propagated with the IMU, is compared with the estimate in the body frame, where the twist
is given and corrections of the attitude also cause steps. The difference is an offset that rotates with the body and
decreases by ``slew`` [m/s^2]. An ordinary correction of a few cm/s is complete by the next message. The estimate itself
is not changed.
"""

import math

import numpy as np

from nav_pose_estimator.core.filter.layout import OUT_FORCE, OUT_QUAT, OUT_RATE, OUT_VEL, SOLUTION_SIZE
from nav_pose_estimator.core.numerics.jit import kernel
from nav_pose_estimator.core.numerics.units import STANDARD_GRAVITY
from nav_pose_estimator.core.numerics.vectors import add, add_scaled, dot, load3, load4, q_exp, q_rotate_back, store3
from nav_pose_estimator.engine.solutions import NavSolution

_PAUSE = 1.0  # s without a solution after which there is no continuity to preserve
_VELOCITY, _OFFSET, _MEMORY = 0, 3, 6  # layout of the kernel's memory, and its size


@kernel
def follow(memory, solution, dt, most):
    """Carry ``memory`` [last velocity in b (3), offset in b (3)] over ``dt`` [s] to ``solution`` (SOLUTION_SIZE,).

    ``most`` [m/s] is the decrease of the offset. Standard gravity is sufficient: its error, the Coriolis acceleration
    and the sampling of the IMU amount to some mm/s^2, a thousandth of the usual rate of decrease.
    """
    q = load4(solution, OUT_QUAT)
    turn = q_exp(add_scaled((0.0, 0.0, 0.0), dt, load3(solution, OUT_RATE)))
    push = add(load3(solution, OUT_FORCE), q_rotate_back(q, (0.0, 0.0, -STANDARD_GRAVITY)))
    velocity = q_rotate_back(q, load3(solution, OUT_VEL))
    # difference of the last published velocity, propagated by the motion, from the estimate
    published = q_rotate_back(turn, add(load3(memory, _VELOCITY), load3(memory, _OFFSET)))
    offset = add_scaled(add_scaled(published, dt, push), -1.0, velocity)
    length = math.sqrt(dot(offset, offset))
    left = max(length - most, 0.0) / max(length, most, 1e-300)
    store3(memory, _VELOCITY, velocity)
    store3(memory, _OFFSET, (left * offset[0], left * offset[1], left * offset[2]))


class SteadyTwist:
    """Offset of the published velocity from the estimate, which decreases by ``slew`` [m/s^2]; 0: no offset."""

    def __init__(self, slew: float) -> None:
        self._slew, self._memory = slew, np.zeros(_MEMORY)
        self._last_ns: int | None = None

    @property
    def offset(self) -> np.ndarray:
        """Offset (3,) [m/s] in b at the last solution."""
        return self._memory[_OFFSET:]

    def take(self, solution: NavSolution) -> None:
        """Update the offset. Must be called with every solution, also those not published: it integrates the motion."""
        if self._slew == 0.0:
            return
        last, self._last_ns = self._last_ns, solution.stamp_ns
        dt = math.inf if last is None else 1e-9 * (solution.stamp_ns - last)
        if 0.0 < dt < _PAUSE:
            follow(self._memory, solution.values, dt, self._slew * dt)
        else:  # this leaves no offset, whatever the memory contains
            follow(self._memory, solution.values, 0.0, math.inf)


def warm_up() -> None:
    """Call the kernel once, so that it is compiled."""
    follow(np.zeros(_MEMORY), np.zeros(SOLUTION_SIZE), 0.01, 0.01)
