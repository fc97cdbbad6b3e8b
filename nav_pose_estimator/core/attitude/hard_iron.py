"""Hard-iron estimation in flight, from differences of the magnetic field between attitudes.

The Earth's field is constant in n, the hard iron of the vehicle is constant in b. Between two windows at attitudes C1
and C2, with the fields f1 and f2 in n,

    f2 - f1 = (C2 - C1) h + noise

observes the hard iron h in b. Neither the reference field nor the heading is needed, only the rotation between the two
windows, which the gyroscope measures. A Kalman filter over these differences estimates h. It is removed from the field
where it is both large and significant; a smaller one cannot be distinguished from a field that varies from place to
place. Where the differences contradict h, it has changed (a magnet was attached or removed, or the source stands beside
the vehicle), and the estimate is released by a larger process noise.
"""

from nav_pose_estimator.core.attitude.layout import (
    AGE,
    IRON,
    IRON_AXES,
    IRON_COV,
    IRON_FIELD,
    IRON_MISFIT,
    IRON_TIME,
    IRON_USED,
    OFFSET_SUPPORT,
    OFFSET_TIME,
    QUAT,
    RATE,
)
from nav_pose_estimator.core.numerics.jit import inlined, kernel
from nav_pose_estimator.core.numerics.vectors import add_scaled, dot, load3, load4, q_columns, q_rotate, store3

_STEP = 0.5  # s between the windows that are compared
_GAP = 1.5  # s: windows further apart than this are not compared
# Standard deviations relative to the field: noise of a window, variation along the way in 1 s, initial hard iron.
_NOISE, _PLACE, _UNKNOWN = 0.011, 0.045, 0.5
_TIMING = 0.005  # s: standard deviation of the magnetometer's remaining delay
_WALK, _LOST_WALK = 1e-3, 0.3  # 1/sqrt(s): random walk of the hard iron, usual and while it contradicts the field
_MISFIT_TAU, _MISFIT = 2.0, 2.0  # s: smoothing of the NIS per degree of freedom; its limit, above which it contradicts
_GUIDED = 2.0  # s: a heading of the navigator that is older no longer corrects the compass offset
_LARGE, _SURE = 0.1, 100.0  # a hard iron is removed above this size (relative to the field) and squared significance


@kernel
def learn_iron(s, field):
    """Learn from the mean ``field`` (3) in n of the window that ends now, with the hard iron in use removed."""
    elapsed = s[AGE] - s[IRON_TIME]
    if 0.0 <= elapsed < _STEP:
        return
    square = dot(field, field)
    columns, used = q_columns(load4(s, QUAT)), load3(s, IRON_USED)
    if s[IRON_COV] == 0.0:
        for i in range(3):
            s[IRON_COV + 4 * i] = _UNKNOWN * _UNKNOWN * square
    elif 0.0 <= elapsed < _GAP:
        _observe(s, field, columns, square, elapsed)
        _use(s, square)
    s[IRON_TIME] = s[AGE]
    now = load3(s, IRON_USED)
    change = (now[0] - used[0], now[1] - used[1], now[2] - used[2])
    store3(s, IRON_FIELD, add_scaled(field, -1.0, q_rotate(load4(s, QUAT), change)))
    for i in range(3):
        store3(s, IRON_AXES + 3 * i, columns[i])


@inlined
def _observe(s, field, columns, square, elapsed):
    """Kalman update of IRON, covariance IRON_COV (3, 3), by the three components of the difference."""
    P = s[IRON_COV : IRON_COV + 9].reshape(3, 3)
    walk = _LOST_WALK if s[IRON_MISFIT] > _MISFIT else _WALK
    for i in range(3):
        P[i, i] = min(P[i, i] + walk * walk * square * elapsed, _UNKNOWN * _UNKNOWN * square)
    rate = load3(s, RATE)
    noise = 2.0 * _NOISE * _NOISE + _PLACE * _PLACE * elapsed + 2.0 * _TIMING * _TIMING * dot(rate, rate)
    misfit = 0.0
    for i in range(3):
        a = (
            columns[0][i] - s[IRON_AXES + i],
            columns[1][i] - s[IRON_AXES + 3 + i],
            columns[2][i] - s[IRON_AXES + 6 + i],
        )
        residual = field[i] - s[IRON_FIELD + i]
        for j in range(3):
            residual -= a[j] * (s[IRON + j] - s[IRON_USED + j])
        along = (
            P[0, 0] * a[0] + P[0, 1] * a[1] + P[0, 2] * a[2],
            P[1, 0] * a[0] + P[1, 1] * a[1] + P[1, 2] * a[2],
            P[2, 0] * a[0] + P[2, 1] * a[1] + P[2, 2] * a[2],
        )
        spread = dot(a, along) + noise * square
        misfit += residual * residual / (3.0 * spread)
        for j in range(3):
            s[IRON + j] += along[j] / spread * residual
            for k in range(3):
                P[j, k] -= along[j] * along[k] / spread
    s[IRON_MISFIT] += min(1.0, elapsed / _MISFIT_TAU) * (misfit - s[IRON_MISFIT])


@inlined
def _use(s, square):
    """Decide whether the estimated hard iron is removed from the field from now on.

    The compass offset was learned with the present correction. Without the navigator, which it is learned from, the
    correction therefore stays as it is; with it, a change of the correction restarts the learning of the offset.
    """
    if s[OFFSET_SUPPORT] > 0.0 and s[AGE] - s[OFFSET_TIME] > _GUIDED:
        return
    iron, was_used = load3(s, IRON), s[IRON_USED] != 0.0
    known = s[IRON_MISFIT] < _MISFIT and dot(iron, iron) > _LARGE * _LARGE * square
    known = known and _squared_deviations(s, iron) > _SURE
    store3(s, IRON_USED, iron if known else (0.0, 0.0, 0.0))
    if known != was_used:
        s[OFFSET_SUPPORT] = 0.0


@inlined
def _squared_deviations(s, v):
    """v' P^-1 v, by the adjugate of P."""
    P = s[IRON_COV : IRON_COV + 9].reshape(3, 3)
    a = P[1, 1] * P[2, 2] - P[1, 2] * P[2, 1]
    b = P[0, 2] * P[2, 1] - P[0, 1] * P[2, 2]
    c = P[0, 1] * P[1, 2] - P[0, 2] * P[1, 1]
    d = P[0, 0] * P[2, 2] - P[0, 2] * P[2, 0]
    e = P[0, 2] * P[1, 0] - P[0, 0] * P[1, 2]
    f = P[0, 0] * P[1, 1] - P[0, 1] * P[1, 0]
    determinant = P[0, 0] * a + P[1, 0] * b + P[2, 0] * c
    form = v[0] * v[0] * a + v[1] * v[1] * d + v[2] * v[2] * f
    form += 2.0 * (v[0] * v[1] * b + v[0] * v[2] * c + v[1] * v[2] * e)
    return form / max(determinant, 1e-30 * (P[0, 0] + P[1, 1] + P[2, 2]) ** 3)
