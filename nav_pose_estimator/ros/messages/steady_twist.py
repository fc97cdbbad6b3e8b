"""A velocity for controllers: what corrects the estimate at once enters it at a bounded rate.

What IMU and last velocity lead to is compared with the estimate, in the body, where the twist is given: a correction
of the attitude steps it, too. The difference is an offset that turns with the body and shrinks by ``slew`` m/s every
second. So ordinary corrections by fixes, of a few cm/s, are gone with the next message. The estimate stays as it is.
"""

import math

import numpy as np

from nav_pose_estimator.core.alignment.levelling import STANDARD_GRAVITY
from nav_pose_estimator.core.filter.layout import OUT_FORCE, OUT_QUAT, OUT_RATE, OUT_VEL, SOLUTION_SIZE
from nav_pose_estimator.core.numerics.jit import kernel
from nav_pose_estimator.core.numerics.vectors import add, add_scaled, dot, load3, load4, q_exp, q_rotate_back, store3
from nav_pose_estimator.engine.solutions import NavSolution

_PAUSE = 1.0  # s without a solution: whoever listens has to begin anew anyway
_VELOCITY, _OFFSET, _MEMORY = 0, 3, 6


@kernel
def follow(memory, solution, dt, most):
    """Carry ``memory`` [last velocity in b (3), offset in b (3)] over ``dt`` [s] to ``solution`` (SOLUTION_SIZE,).

    ``most`` [m/s] is what the offset loses. Gravity is the standard one: its error, the Coriolis force, and how the IMU
    samples its interval are some mm/s^2, a thousandth of what an offset loses.
    """
    q = load4(solution, OUT_QUAT)
    turn = q_exp(add_scaled((0.0, 0.0, 0.0), dt, load3(solution, OUT_RATE)))
    push = add(load3(solution, OUT_FORCE), q_rotate_back(q, (0.0, 0.0, -STANDARD_GRAVITY)))
    velocity = q_rotate_back(q, load3(solution, OUT_VEL))
    # the published velocity of before, where the motion alone has led it, against the estimate
    published = q_rotate_back(turn, add(load3(memory, _VELOCITY), load3(memory, _OFFSET)))
    offset = add_scaled(add_scaled(published, dt, push), -1.0, velocity)
    length = math.sqrt(dot(offset, offset))
    left = max(length - most, 0.0) / max(length, most, 1e-300)
    store3(memory, _VELOCITY, velocity)
    store3(memory, _OFFSET, (left * offset[0], left * offset[1], left * offset[2]))


class SteadyTwist:
    """The offset of the published velocity from the estimate. Without ``slew`` [m/s^2] there is none."""

    def __init__(self, slew: float) -> None:
        self._slew, self._memory = slew, np.zeros(_MEMORY)
        self._last_ns: int | None = None

    @property
    def offset(self) -> np.ndarray:
        """(3,) m/s in b at the last solution."""
        return self._memory[_OFFSET:]

    def take(self, solution: NavSolution) -> None:
        """Every solution, also those that are not published: the motion in between is integrated."""
        if self._slew == 0.0:
            return
        last, self._last_ns = self._last_ns, solution.stamp_ns
        dt = math.inf if last is None else 1e-9 * (solution.stamp_ns - last)
        if 0.0 < dt < _PAUSE:
            follow(self._memory, solution.values, dt, self._slew * dt)
        else:  # whatever the memory holds, this leaves no offset
            follow(self._memory, solution.values, 0.0, math.inf)


def warm_up() -> None:
    """Call the kernel once."""
    follow(np.zeros(_MEMORY), np.zeros(SOLUTION_SIZE), 0.01, 0.01)
