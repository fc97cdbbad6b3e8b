"""Does the navigator's own drift explain where GNSS comes back?

After an outage the filter's sigma may be hundreds of metres, and a position 300 m off lies within it. But errors of
position and velocity have grown from the same causes: an inertial navigator that is 300 m off after a minute is metres
per second off as well. A receiver whose velocity agrees with the navigator's while its position does not is therefore
far less likely than its position alone says.

On four recorded flights the joint distance of true returns after 60 s without GNSS was 0.5 to 8.3 (medians), that of
returns 300 m off 6.4 to 13; by position alone, most of the latter lay within 3 sigma. The first range is wide because
a filter may be too sure of itself. ``unexplained`` forgives that as far as the velocity shows it: true returns 0.5 to
3.1, returns 300 m off 5.8 to 10.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Evidence:
    """Mahalanobis distances of a fix with its velocity from the filter's prediction.

    ``joint`` takes the filter's covariance as it is. ``unexplained`` widens it first until the velocity fits: what is
    left cannot be explained by a filter that drifted more than it knows.
    """

    joint: float
    unexplained: float


def weigh(z: Array, H: Array, P: Array, R: Array, position_rows: int = 3) -> Evidence:
    """Weigh one fix.

    Args:
        z: innovation (m,), first ``position_rows`` of position [m], then of velocity [m/s].
        H, P, R: (m, n), (n, n), (m, m), as for a correction of the filter.

    Numbers without a distance (not finite, a covariance that is none) speak for nothing: both are infinite then.
    """
    spread, velocity = H @ P @ H.T, slice(position_rows, None)
    apart = _distance(z[velocity], spread[velocity, velocity] + R[velocity, velocity])
    stretch = max(apart**2 / max(len(z) - position_rows, 1), 1.0)
    return Evidence(_distance(z, spread + R), _distance(z, stretch * spread + R))


def _distance(z: Array, S: Array) -> float:
    try:
        square = float(z @ np.linalg.solve(S, z))
    except np.linalg.LinAlgError:
        return math.inf
    return math.sqrt(square) if 0.0 <= square < math.inf else math.inf
