"""Does the navigator's own drift explain where GNSS comes back?

After an outage the filter's sigma may be hundreds of metres, and a position 300 m off lies within it. But errors of
position and velocity have grown from the same causes: an inertial navigator that is 300 m off after a minute is metres
per second off as well. A receiver whose velocity agrees with the navigator's while its position does not is therefore
far less likely than its position alone says.

A filter may also be overconfident. That is allowed for as far as the velocity shows it: the filter's covariance is
first widened until the velocity fits.

On three recorded flights, after 60 s without GNSS, true returns were 0.5 to 3.1 off by this measure (medians of a
flight), returns 300 m off 5.8 to 10; by position alone, most of the latter lay within 3 sigma.
"""

import math

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.filter.kalman import innovation

Array = NDArray[np.float64]


def unexplained(z: Array, H: Array, P: Array, R: Array, position_rows: int = 3) -> float:
    """What of a fix with its velocity no drift of the filter explains, as a Mahalanobis distance.

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
    """Mahalanobis distance of an innovation; arguments as for ``unexplained``, infinite in the same cases."""
    return math.sqrt(innovation(P, z, H, np.ascontiguousarray(R)))
