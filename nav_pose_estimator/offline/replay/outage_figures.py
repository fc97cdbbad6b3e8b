"""Figures of the outages in a replay: the path in space, the network's prediction, and the reliability of sigma."""

from collections.abc import Iterator
from statistics import NormalDist

import numpy as np

from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.offline.flights.tracks import Reference, Track, displacement_enu
from nav_pose_estimator.offline.page import live, page
from nav_pose_estimator.offline.page.svg import Plot
from nav_pose_estimator.offline.replay.replay import ReplayResult, reference_lever

Array = np.ndarray
_FEW = 20  # smallest number of fixes in outages for a figure of the reliability
_PROBABILITIES = np.linspace(0.02, 0.98, 49)
_GAP = 1.0  # s between predictions: another outage


def of_outages(result: ReplayResult) -> Iterator[str]:
    """The figures for which there is something to show."""
    plot = prediction(result)
    if plot is not None:
        yield "<h2>Predictions of the network</h2>" + page.figure(
            plot,
            "Velocity over ground in the outages, as the network has it from attitude, IMU and the wind it knows,"
            " beside the withheld one.",
        )
    plot = reliability(result)
    if plot is not None:
        yield "<h2>Is sigma honest?</h2>" + page.figure(
            plot,
            "Share of the errors in the outages that lie within the interval of each probability. Below the diagonal"
            " sigma is too small. Errors of one outage are not independent, and the reference errs, too.",
        )


def track(result: ReplayResult) -> live.Track:
    """Reference and estimate in space, East, North, Up [m] from the origin; outages in bold."""
    flown, reference = result.drawn, result.drawn_reference
    origin = np.array(result.origin or flown.position[0])
    estimate = displacement_enu(flown.position, origin)
    paths = [(flown.t, estimate, "a", "b", "estimate")]
    if len(reference):
        paths.insert(0, (reference.t, displacement_enu(reference.position, origin), "f", "f", reference.kind))
    lines = []
    for t, enu, style, outage_style, label in paths:
        lines.append((enu[:: max(len(enu) // live.POINTS, 1)], style, label))
        for outage in result.outages:
            inside = enu[outage.contains(t)]
            if len(inside):
                lines.append((inside[:: max(len(inside) // 500, 1)], f"{outage_style} thick", ""))
    step = max(len(estimate) // live.POINTS, 1)
    return live.Track(lines, flown.t[::step], estimate[::step])


def prediction(result: ReplayResult) -> Plot | None:
    """The network's velocity in the outages beside that of the reference; None where either is missing."""
    predictions = result.record.predictions
    flown = _flown(result.drawn_reference)
    if not predictions or flown is None:
        return None
    t = np.array([(s.stamp_ns - result.recording.epoch_ns) * 1e-9 for s in predictions]) - me.PERIOD / 2.0
    velocity = result.track.velocity_at(t) - np.array([s.dv_n for s in predictions])
    velocity[np.diff(t, prepend=t[0]) > _GAP] = np.nan  # lift the pen between outages
    plot = Plot("s since the first stamp", "velocity over ground, m/s", time=True, height=300)
    for outage in result.outages:
        plot.span(outage.start, outage.end)
    for i, name in enumerate(("East", "North")):
        plot.line(*_inside(result, flown[0], flown[1][:, i]), "f" if i == 0 else "f dash", f"{name}, flown")
        plot.line(t, velocity[:, i], "ab"[i], f"{name}, predicted")
    return plot


def coverage(result: ReplayResult) -> dict[str, Array]:
    """Shares (49,) of the errors in outages within the interval of each of ``_PROBABILITIES``, by axis."""
    t, lever = result.fix_times, reference_lever(result.reference, result.parameters)
    inside = np.zeros(len(t), bool)
    for outage in result.outages:
        inside |= outage.contains(t)
    t = t[inside]
    errors = displacement_enu(result.track.antenna_at(t, lever), result.reference.at(t))
    ratio = np.abs(errors) / Track(t, result.track.at(t)).sd("position")
    ratio = ratio[np.isfinite(ratio).all(axis=1)]
    if len(ratio) < _FEW:
        return {}
    factors = np.array([NormalDist().inv_cdf(0.5 + p / 2.0) for p in _PROBABILITIES])
    axes = {"East and North": ratio[:, :2].ravel(), "Up": ratio[:, 2]}
    return {name: (values[:, None] <= factors).mean(axis=0) for name, values in axes.items()}


def reliability(result: ReplayResult) -> Plot | None:
    """Stated probability and the share of errors; None where too little was flown without GNSS."""
    shares = coverage(result)
    if not shares:
        return None
    plot = Plot("stated probability", "share of errors", height=320, y_range=(0.0, 1.0))
    plot.line(np.array([0.0, 1.0]), np.array([0.0, 1.0]), "f dash", "honest")
    for style, (name, share) in zip("ac", shares.items(), strict=True):
        plot.line(_PROBABILITIES, share, style, name)
    return plot


def _flown(reference: Reference) -> tuple[Array, Array] | None:
    """Times (N,) and velocities (N, 3) of the reference, by differences where it has none; None without reference."""
    if len(reference) < 2:
        return None
    if reference.velocity is not None and np.isfinite(reference.velocity).any():
        return reference.t, reference.velocity
    step = np.diff(reference.t)
    moved = displacement_enu(reference.position[1:], reference.position[:-1])
    return (reference.t[1:] + reference.t[:-1]) / 2.0, moved / np.maximum(step, 1e-3)[:, None]


def _inside(result: ReplayResult, t: Array, values: Array) -> tuple[Array, Array]:
    """``values`` with NaN outside of the outages."""
    chosen = np.zeros(len(t), bool)
    for outage in result.outages:
        chosen |= outage.contains(t)
    return t, np.where(chosen, values, np.nan)
