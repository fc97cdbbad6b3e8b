"""Comparison with the autopilot's own estimate, in the plots and in one line of figures of the report."""

import math

import numpy as np

from nav_pose_estimator.core.filter.layout import OUT_QUAT
from nav_pose_estimator.core.numerics.rotation import (
    euler_from_quat_many,
    quat_conjugate_many,
    quat_multiply_many,
    quat_normalize_many,
    rotvec_from_quat_many,
)
from nav_pose_estimator.offline.flights.tracks import displacement_enu
from nav_pose_estimator.offline.page.svg import Plot
from nav_pose_estimator.offline.replay.replay import ReplayResult, reference_lever

Array = np.ndarray
_LONGEST = 1.5  # s: longest interval of the autopilot's estimate that is interpolated
STYLE = "d"


def figures(result: ReplayResult) -> dict[str, float | str] | None:
    """Horizontal RMS distances [m] of the opinion from GNSS and from our solution, and RMS angles [deg] to it.

    None where the recording brings no opinion; NaN where there is nothing to compare.
    """
    opinion = result.recording.opinion
    if opinion is None:
        return None
    times, reference = result.fix_times, result.reference
    from_gnss = displacement_enu(_position_at(result, times), reference.at(times))
    ours = result.track.antenna_at(opinion.t, reference_lever(reference, result.parameters))
    from_ours = displacement_enu(opinion.position, ours)
    tilt, heading = _angles(result)
    return {
        "source": opinion.kind,
        "from_gnss_rms_m": _rms(from_gnss[:, :2]),
        "from_gnss_max_m": _max(from_gnss[:, :2]),
        "from_solution_rms_m": _rms(from_ours[:, :2]),
        "inclination_rms_deg": _rms(tilt[:, None]),
        "heading_rms_deg": _rms(heading[:, None]),
    }


def sentence(result: ReplayResult) -> str:
    """The figures in words, empty where there is no opinion."""
    found = figures(result)
    if found is None:
        return ""
    named = (
        ("from_gnss_rms_m", "{:.1f} m RMS from GNSS"),
        ("from_gnss_max_m", "{:.1f} m at most"),
        ("from_solution_rms_m", "{:.1f} m RMS from this solution"),
        ("inclination_rms_deg", "{:.1f} deg RMS from its inclination"),
        ("heading_rms_deg", "{:.1f} deg RMS from its heading"),
    )
    parts = [text.format(found[key]) for key, text in named if math.isfinite(float(found[key]))]
    return f"Second opinion, {found['source']}: {', '.join(parts) or 'nothing to compare'}."


def draw_track(plot: Plot, result: ReplayResult, origin: Array) -> None:
    """The opinion's path into the map."""
    opinion = result.recording.opinion
    if opinion is None or not np.isfinite(opinion.position).any():
        return
    inside = (opinion.t >= 0.0) & (opinion.t <= result.recording.duration)
    enu = displacement_enu(opinion.position[inside], origin)
    step = max(len(enu) // 3000, 1)
    plot.line(enu[::step, 0], enu[::step, 1], STYLE, opinion.kind, thinned=False)


def draw_attitude(plot: Plot, result: ReplayResult) -> None:
    """The opinion's roll, pitch and yaw into the plot of the attitude."""
    opinion = result.recording.opinion
    if opinion is None or opinion.q_nb is None:
        return
    step = max(len(opinion.t) // 4000, 1)
    angles = np.degrees(euler_from_quat_many(opinion.q_nb[::step]))
    angles[1:, 2][np.abs(np.diff(angles[:, 2])) > 180.0] = np.nan  # lift the pen where the angle wraps
    for i in range(3):
        plot.line(opinion.t[::step], angles[:, i], STYLE, opinion.kind if i == 0 else "")


def _position_at(result: ReplayResult, times: Array) -> Array:
    """(M, 3) latitude, longitude, height of the opinion at ``times``, NaN where it has none."""
    opinion = result.recording.opinion
    assert opinion is not None
    good = np.isfinite(opinion.position).all(axis=1)
    t = opinion.t[good]
    if len(t) < 2:
        return np.full((len(times), 3), np.nan)
    after = np.clip(np.searchsorted(t, times), 1, len(t) - 1)
    found = np.stack(
        [np.interp(times, t, opinion.position[good, i], left=np.nan, right=np.nan) for i in range(3)], axis=-1
    )
    found[t[after] - t[after - 1] > _LONGEST] = np.nan
    return found


def _angles(result: ReplayResult) -> tuple[Array, Array]:
    """Inclination (M,) and heading (M,) by which our attitude is turned against the opinion's [deg]."""
    opinion = result.recording.opinion
    assert opinion is not None
    if opinion.q_nb is None or len(result.track) == 0:
        return np.empty(0), np.empty(0)
    rows = result.track.at(opinion.t)
    good = np.isfinite(rows[:, OUT_QUAT]) & np.isfinite(opinion.q_nb).all(axis=1)
    ours = quat_normalize_many(rows[good, OUT_QUAT : OUT_QUAT + 4])
    turned = quat_multiply_many(ours, quat_conjugate_many(opinion.q_nb[good]))
    error = np.degrees(rotvec_from_quat_many(turned))
    return np.linalg.norm(error[:, :2], axis=1), error[:, 2]


def _rms(values: Array) -> float:
    squares = np.sum(values**2, axis=1)
    squares = squares[np.isfinite(squares)]
    return float(np.sqrt(squares.mean())) if len(squares) else math.nan


def _max(values: Array) -> float:
    lengths = np.linalg.norm(values, axis=1)
    lengths = lengths[np.isfinite(lengths)]
    return float(lengths.max()) if len(lengths) else math.nan
