"""Joint test of position and velocity at the return of GNSS: whether the navigator's own drift explains both.

After an outage the filter's sigma may be hundreds of metres, and a position 300 m off lies within it. But errors of
position and velocity have the same causes: an inertial navigator that is 300 m off after a minute is also metres per
second off. A return whose velocity agrees with the navigator's while its position does not is therefore far less likely
than its position alone suggests.

The filter may also be overconfident. This is allowed for as far as the velocity shows it: its covariance is first
enlarged until the velocity agrees.

On three recorded flights, after 60 s without GNSS, this distance was 0.5 to 3.1 for true returns (medians of a flight)
and 5.8 to 10 for returns 300 m off. By position alone, most of the latter were within 3 sigma.
"""

import math

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.filter.kalman import innovation

Array = NDArray[np.float64]


def unexplained(z: Array, H: Array, P: Array, R: Array, position_rows: int = 3) -> float:
    """Mahalanobis distance of a fix and its velocity, after the covariance is enlarged until the velocity agrees.

    Args:
        z: innovation (m,), first ``position_rows`` of position [m], then of velocity [m/s].
        H, P, R: (m, n), (n, n), (m, m), as for a correction of the filter.

    Infinite where the distance is undefined: not finite, or an invalid covariance.
    """
    velocity = slice(position_rows, None)
    apart = distance(z[velocity], H[velocity], P, R[velocity, velocity])
    stretch = max(apart**2 / max(len(z) - position_rows, 1), 1.0)
    return distance(z, H, stretch * P, R)


def distance(z: Array, H: Array, P: Array, R: Array) -> float:
    """Mahalanobis distance of an innovation; arguments as of ``unexplained``, infinite in the same cases."""
    return math.sqrt(innovation(P, z, H, np.ascontiguousarray(R)))
