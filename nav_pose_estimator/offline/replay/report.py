"""The page report.html of a replay: modes, events, drift in outages, errors and innovations."""

import math
from collections.abc import Iterator
from html import escape
from pathlib import Path

import numpy as np

from nav_pose_estimator.core.numerics.rotation import euler_from_quat_many
from nav_pose_estimator.core.numerics.units import STANDARD_GRAVITY
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import flatten
from nav_pose_estimator.engine.solutions import Level, Mode
from nav_pose_estimator.offline.flights.tracks import displacement_enu
from nav_pose_estimator.offline.page import page
from nav_pose_estimator.offline.page.svg import Plot
from nav_pose_estimator.offline.replay import outage_figures, second_opinion
from nav_pose_estimator.offline.replay.replay import ReplayResult, reference_lever

_MODE_STYLE = {
    Mode.AIDED: "mode-good",
    Mode.COASTING: "mode-mid",
    Mode.REACQUIRING: "mode-mid",
    Mode.DEAD_RECKONING: "mode-bad",
    Mode.EXPIRED: "mode-bad",
}
MAX_EVENTS = 200


def write_report(path: Path, result: ReplayResult) -> None:
    """Write the page, which is self-contained."""
    page.write(path, f"{result.recording.name} · replay", _body(result))


def outage_rows(result: ReplayResult) -> list[list[str]]:
    """Table of the outages as texts, one row each."""
    return [
        [
            f"{e.start_s:.1f}",
            f"{e.length_s:g}",
            *(_metres(v) for v in (e.end_error_m, e.rms_error_m, e.max_error_m, e.end_vertical_m, e.end_sigma_m)),
            _metres(e.travelled_m),
            e.status,
        ]
        for e in result.errors
    ]


OUTAGE_HEADER = ["start s", "length s", "end m", "rms m", "max m", "vertical m", "sigma m", "travelled m", "status"]


def mode_spans(result: ReplayResult) -> list[tuple[float, float, Mode]]:
    """Intervals (start [s], end [s], mode) over the whole replay."""
    modes = result.record.modes
    if not modes:
        return [(0.0, result.recording.duration, result.status.mode)]
    first = [(0.0, modes[0][0], Mode.ALIGNING)] if modes[0][0] > 0.0 else []
    ends = [start for start, _ in modes[1:]] + [result.recording.duration]
    return first + [(start, end, mode) for (start, mode), end in zip(modes, ends, strict=True)]


def errors_enu(result: ReplayResult) -> tuple[np.ndarray, np.ndarray]:
    """Times (M,) of the fixes, else of the reference, and the estimate's errors (M, 3) there."""
    times = result.fix_times if len(result.fix_times) else result.reference.t[:: max(len(result.reference) // 5000, 1)]
    estimate = result.track.antenna_at(times, reference_lever(result.reference, result.parameters))
    return times, displacement_enu(estimate, result.reference.at(times))


def _body(result: ReplayResult) -> Iterator[str]:
    recording = result.recording
    yield f"<h1>{escape(recording.name)}</h1>"
    judged = "nothing to judge against" if len(result.reference) == 0 else f"judged against {result.reference.kind}"
    yield f'<p class="soft">{recording.duration:.0f} s, {recording.imu_count} IMU samples, {judged}</p>'
    yield page.tiles(_tiles(result))
    notes = [*recording.notices, second_opinion.sentence(result)]
    yield "".join(f'<p class="soft">{escape(text)}</p>' for text in notes if text)
    if result.errors:
        yield "<h2>Outages</h2>" + page.table(OUTAGE_HEADER, outage_rows(result), text_columns=())
        yield '<p class="soft"><small>End: horizontal error, mean over the fixes in the last 1.05 s. '
        yield "Sigma: the filter's own horizontal deviation at that moment (one sigma).</small></p>"
    if len(result.track):
        yield "<h2>Track</h2>" + page.figure(_map(result), "East and north of the origin; outages in bold.")
        yield page.figure(outage_figures.track(result), "The same in space; where it is flat, heights are stretched.")
        yield "<h2>Errors</h2>" + page.figure(_horizontal_error(result)) + page.figure(_vertical_error(result))
        yield from outage_figures.of_outages(result)
        yield "<h2>Innovations</h2>" + "".join(map(page.figure, _innovations(result)))
        yield "<h2>Attitude</h2>" + page.figure(_attitude(result))
        yield "<h2>Velocity</h2>" + page.figure(_velocity(result))
    if result.record.biases:
        yield "<h2>Sensor biases</h2>" + "".join(map(page.figure, _biases(result)))
    yield "<h2>Modes and events</h2>" + page.figure(_modes(result)) + _events(result)
    yield "<h2>Counters</h2>" + _counters(result)
    yield "<h2>Parameters</h2>" + _parameters(result.parameters)


def _tiles(result: ReplayResult) -> list[tuple[str, str]]:
    ends = [e.end_error_m for e in result.errors if math.isfinite(e.end_error_m)]
    aided = sum(end - start for start, end, mode in mode_spans(result) if mode is Mode.AIDED)
    tiles = [(f"{len(result.outages)}", "outages")]
    if ends:
        tiles += [(f"{np.median(ends):.1f} m", "median end error"), (f"{max(ends):.1f} m", "worst end error")]
    tiles.append((f"{100.0 * aided / max(result.recording.duration, 1e-9):.0f} %", "of the time aided"))
    tiles.append((f"{result.parameters.gnss.delay:.3f} s", "GNSS latency"))
    tiles.append((f"{result.recording.duration / max(result.seconds, 1e-9):.0f} ×", "real time (estimator)"))
    return tiles


def _plot(result: ReplayResult, y_label: str, **options) -> Plot:
    plot = Plot("s since the first stamp", y_label, time=True, **options)
    for outage in result.outages:
        plot.span(outage.start, outage.end)
    return plot


def _map(result: ReplayResult) -> Plot:
    track, reference = result.drawn, result.drawn_reference
    origin = np.array(result.origin or track.position[0])
    plot = Plot("East, m", "North, m", height=560, equal=True)
    truth = displacement_enu(reference.position, origin) if len(reference) else np.empty((0, 3))
    estimate = displacement_enu(track.position, origin)
    _thin_line(plot, truth, "f", f"{result.reference.kind}")
    second_opinion.draw_track(plot, result, origin)
    _thin_line(plot, estimate, "a", "estimate")
    for outage in result.outages:
        for enu, t, style in ((truth, reference.t, "f"), (estimate, track.t, "b")):
            inside = outage.contains(t)
            _thin_line(plot, enu[inside], f"{style} thick")
    plot.mark(float(estimate[0, 0]), float(estimate[0, 1]), "dot", "start")
    return plot


def _thin_line(plot: Plot, enu: np.ndarray, style: str, label: str = "") -> None:
    step = max(len(enu) // 3000, 1)
    if len(enu):
        plot.line(enu[::step, 0], enu[::step, 1], style, label, thinned=False)


def _horizontal_error(result: ReplayResult) -> Plot:
    plot = _plot(result, f"horizontal error against {result.reference.kind}, m", log=True, height=300)
    times, errors = errors_enu(result)
    three_sigma = 3.0 * result.drawn.horizontal_sd
    plot.band(result.drawn.t, np.full(len(three_sigma), 0.05), three_sigma, "f", "3 sigma")
    plot.line(times, np.linalg.norm(errors[:, :2], axis=1), "a", "error")
    return plot


def _vertical_error(result: ReplayResult) -> Plot:
    plot = _plot(result, "height error, m")
    times, errors = errors_enu(result)
    three_sigma = 3.0 * result.drawn.sd("position")[:, 2]
    plot.band(result.drawn.t, -three_sigma, three_sigma, "f", "3 sigma")
    plot.line(times, errors[:, 2], "c", "error")
    return plot


def _innovations(result: ReplayResult) -> Iterator[Plot]:
    fixes = result.recording.receiver(result.parameters.gnss.delay)
    if len(fixes) == 0:
        return
    position = result.track.antenna_at(fixes.t, np.array(result.parameters.gnss.lever_arm))
    plot = _plot(result, "fix minus prediction while aided, m")
    innovation = -displacement_enu(position, fixes.position)
    _three(plot, fixes.t, _outside(result, fixes.t, innovation), ("East", "North", "Up"))
    yield plot
    if fixes.velocity is not None:
        plot = _plot(result, "GNSS velocity minus prediction while aided, m/s")
        difference = fixes.velocity - result.track.velocity_at(fixes.t)
        _three(plot, fixes.t, _outside(result, fixes.t, difference), ("East", "North", "Up"))
        yield plot


def _outside(result: ReplayResult, times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """``values`` with NaN where the filter was not AIDED: fixes under test at a return would hide all the others."""
    values = values.copy()
    aided = np.zeros(len(times), bool)
    for start, end, mode in mode_spans(result):
        aided |= (mode is Mode.AIDED) & (times >= start) & (times < end)
    for outage in result.outages:
        # the first fixes after a return correct what the outage left behind
        aided &= (times < outage.start) | (times >= outage.end + 2.0)
    values[~aided] = np.nan
    return values


def _three(plot: Plot, t: np.ndarray, values: np.ndarray, names: tuple[str, ...]) -> None:
    for i, name in enumerate(names):
        plot.line(t, values[:, i], page.LINES[i], name)


def _attitude(result: ReplayResult) -> Plot:
    step = max(len(result.drawn) // 4000, 1)
    t, q = result.drawn.t[::step], result.drawn.q_nb[::step]
    angles = np.degrees(euler_from_quat_many(q))
    yaw = angles[:, 2].copy()
    yaw[1:][np.abs(np.diff(angles[:, 2])) > 180.0] = np.nan  # lift the pen where the angle wraps
    plot = _plot(result, "roll, pitch, yaw (counter-clockwise from East), deg", height=280)
    second_opinion.draw_attitude(plot, result)
    _three(plot, t, np.column_stack([angles[:, :2], yaw]), ("roll", "pitch", "yaw"))
    return plot


def _velocity(result: ReplayResult) -> Plot:
    plot = _plot(result, "velocity, m/s")
    _three(plot, result.drawn.t, result.drawn.velocity, ("East", "North", "Up"))
    return plot


def _biases(result: ReplayResult) -> Iterator[Plot]:
    history = result.record.bias_history
    units = ("gyroscope bias, deg/s", math.degrees(1.0)), ("accelerometer bias, mg", 1e3 / STANDARD_GRAVITY)
    for sensor, (unit, factor) in enumerate(units):
        plot = _plot(result, unit)
        values, spread = (factor * rows for rows in history.of(sensor))
        for i in range(3):
            plot.band(history.t, values[:, i] - spread[:, i], values[:, i] + spread[:, i], page.LINES[i])
        _three(plot, history.t, values, ("x forward", "y left", "z up"))
        yield plot


def _modes(result: ReplayResult) -> str:
    end = max(result.recording.duration, 1e-9)
    parts = ['<svg viewBox="0 0 920 34" role="img" aria-label="modes">']
    for start, stop, mode in mode_spans(result):
        x, width = 900.0 * start / end + 10, 900.0 * (stop - start) / end
        style = _MODE_STYLE.get(mode, "mode-wait")
        title = f"{mode.value} {start:.1f} to {stop:.1f} s"
        parts.append(f'<rect class="{style}" x="{x:.1f}" y="4" width="{max(width, 1):.1f}" height="14">')
        parts.append(f"<title>{title}</title></rect>")
    texts = (("mode-good", "AIDED"), ("mode-mid", "COASTING, REACQUIRING"), ("mode-bad", "DEAD_RECKONING, EXPIRED"))
    x = 10
    for style, text in texts:
        parts.append(f'<rect class="{style}" x="{x}" y="24" width="9" height="9"/>')
        parts.append(f'<text class="tick" x="{x + 13}" y="33">{text}</text>')
        x += 40 + 7 * len(text)
    return "".join([*parts, "</svg>"])


def _events(result: ReplayResult) -> str:
    shown = [event for event in result.record.events if event.level is not Level.DEBUG]
    rows = [
        [f"{(e.stamp_ns - result.recording.epoch_ns) * 1e-9:.2f}", e.level.name, e.text, e.name]
        for e in shown[:MAX_EVENTS]
    ]
    left = f"<p class=soft>{len(shown) - MAX_EVENTS} more are not shown.</p>" if len(shown) > MAX_EVENTS else ""
    return page.table(["s", "", "event", "name"], rows, text_columns=(1, 2, 3)) + left


def _counters(result: ReplayResult) -> str:
    counters = {**result.status.counters, **result.recording.counters}
    rows = [[name, str(count)] for name, count in sorted(counters.items())]
    return page.table(["counter", "times"], rows) if rows else "<p>Nothing to count.</p>"


def _parameters(parameters: Parameters) -> str:
    defaults = flatten(Parameters())
    values = flatten(parameters)
    changed = [[key, str(value), str(defaults[key])] for key, value in values.items() if value != defaults[key]]
    own = page.table(["parameter", "value", "default"], changed) if changed else "<p>All at their defaults.</p>"
    rest = page.table(["parameter", "value"], [[key, str(value)] for key, value in values.items()])
    return f"{own}<details><summary>all {len(values)} parameters</summary>{rest}</details>"


def _metres(value: float) -> str:
    return f"{value:.1f}" if math.isfinite(value) else "–"
