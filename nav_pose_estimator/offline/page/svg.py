"""Line plots as small SVG texts, without a plotting library, in the colours of the page's style sheet."""

import math
from dataclasses import dataclass, field
from html import escape
from typing import Any

import numpy as np

from nav_pose_estimator.offline.page import live

Array = np.ndarray
MAX_POINTS = 1200  # largest number of points of a line, about the pixels of a screen
_LEFT, _RIGHT, _TOP, _BOTTOM = 58, 14, 26, 30


def thin(x: Array, *ys: Array, points: int = MAX_POINTS) -> tuple[Array, ...]:
    """``x`` and ``ys`` decimated to about ``points`` entries, with the extremes of the first of ``ys``."""
    if len(x) <= points:
        return (x, *ys)
    size = math.ceil(2 * len(x) / points)
    whole = len(x) // size * size
    groups = np.where(np.isfinite(ys[0][:whole]), ys[0][:whole], 0.0).reshape(-1, size)
    starts = np.arange(0, whole, size)
    picked = np.concatenate([starts + groups.argmin(1), starts + groups.argmax(1), [len(x) - 1]])
    picked = np.unique(picked)
    return (x[picked], *(y[picked] for y in ys))


def ticks(low: float, high: float, about: int = 6) -> list[float]:
    """Round numbers between ``low`` and ``high``."""
    if not high > low:
        return [low]
    raw = (high - low) / about
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(m * power for m in (1.0, 2.0, 2.5, 5.0, 10.0) if m * power >= raw * 0.999)
    first = math.ceil(low / step - 1e-9)
    return [i * step for i in range(first, math.floor(high / step + 1e-9) + 1)]


def number(value: float) -> str:
    """A tick label: short, no exponent for everyday sizes."""
    if value == 0.0 or 1e-3 <= abs(value) < 1e5:
        return f"{value:.6g}"
    return f"{value:.1e}"


@dataclass
class Plot:
    """One set of axes. Add bands, spans and lines, then :meth:`render`."""

    x_label: str
    y_label: str
    width: int = 920
    height: int = 240
    log: bool = False  # logarithmic y
    equal: bool = False  # one metre is as long upwards as sideways (maps)
    time: bool = False  # x is the time of the recording, which such plots show together
    y_range: tuple[float, float] | None = None
    _layers: list[tuple[str, tuple[Array, ...], str, bool, str]] = field(default_factory=list)
    _spans: list[tuple[float, float, str]] = field(default_factory=list)
    _legend: list[tuple[str, str]] = field(default_factory=list)
    _marks: list[tuple[float, float, str, str]] = field(default_factory=list)

    def line(self, x: Array, y: Array, style: str, label: str = "", thinned: bool = True) -> None:
        """A line of class ``style``; it is interrupted where ``y`` is NaN."""
        self._layers.append(("line", (np.asarray(x, float), np.asarray(y, float)), style, thinned, label))
        self._name(label, style)

    def band(self, x: Array, low: Array, high: Array, style: str, label: str = "") -> None:
        """The area between ``low`` and ``high``."""
        data = np.asarray(x, float), np.asarray(high, float), np.asarray(low, float)
        self._layers.append(("band", data, style, True, label))
        self._name(label, style)

    def span(self, start: float, end: float, style: str = "outage") -> None:
        """A shaded time interval."""
        self._spans.append((start, end, style))

    def mark(self, x: float, y: float, style: str, text: str = "") -> None:
        """A dot with an optional text."""
        self._marks.append((x, y, style, text))

    def _name(self, label: str, style: str) -> None:
        if label:
            self._legend.append((label, style))

    def render(self) -> str:
        """The plot as an ``<svg>`` element."""
        scale_x, scale_y = self._scales()
        parts = [f'<svg viewBox="0 0 {self.width} {self.height}" role="img" aria-label="{escape(self.y_label)}">']
        parts += [self._span(scale_x, *span) for span in self._spans]
        parts += self._axes(scale_x, scale_y)
        for kind, data, style, thinned, _ in self._layers:
            draw = _line if kind == "line" else _band
            parts.append(draw(scale_x, scale_y, thin(*data) if thinned else data, style))
        for x, y, style, text in self._marks:
            px, py = scale_x(x), scale_y(y)
            parts.append(f'<circle class="{style}" cx="{px:.1f}" cy="{py:.1f}" r="4"/>')
            if text:
                parts.append(f'<text class="mark" x="{px + 7:.1f}" y="{py + 4:.1f}">{escape(text)}</text>')
        return "".join([*parts, self._legend_text(), "</svg>"])

    def data(self) -> dict[str, Any]:
        """The plot for the script of ``live``, with more points than are drawn."""
        _, scale_y = self._scales()
        limits = [scale_y.low, scale_y.high]
        plot: dict[str, Any] = {
            "kind": "plot",
            "x_label": self.x_label,
            "y_label": self.y_label,
            "height": self.height,
            "log": self.log,
            "equal": self.equal,
            "time": self.time,
            "y_range": np.log10(limits).tolist() if self.log else limits,
            "spans": [span[:2] for span in self._spans],
            "marks": [{"x": x, "y": y, "text": text} for x, y, _, text in self._marks if math.isfinite(x + y)],
            "lines": [],
            "bands": [],
        }
        for kind, data, style, thinned, label in self._layers:
            parts = thin(*data, points=live.POINTS) if thinned else data
            names = ("x", "y") if kind == "line" else ("x", "high", "low")
            arrays = {name: live.numbers(part) for name, part in zip(names, parts, strict=True)}
            plot[f"{kind}s"].append({"style": style, "label": label, **arrays})
        return plot

    # --- scales and axes -----------------------------------------------------------------------------------------

    def _scales(self) -> tuple["_Scale", "_Scale"]:
        xs = [layer[1][0] for layer in self._layers]
        ys = [part for layer in self._layers for part in layer[1][1:]]
        x_low, x_high = _limits(xs, 0.0)
        y_low, y_high = self.y_range or _limits(ys, 0.05, self.log)
        if self.equal:
            inner_w, inner_h = self.width - _LEFT - _RIGHT, self.height - _TOP - _BOTTOM
            unit = max((x_high - x_low) * 1.1 / inner_w, (y_high - y_low) * 1.1 / inner_h, 1e-6)
            x_mid, y_mid = (x_low + x_high) / 2, (y_low + y_high) / 2
            x_low, x_high = x_mid - unit * inner_w / 2, x_mid + unit * inner_w / 2
            y_low, y_high = y_mid - unit * inner_h / 2, y_mid + unit * inner_h / 2
        return (
            _Scale(x_low, x_high, _LEFT, self.width - _RIGHT),
            _Scale(y_low, y_high, self.height - _BOTTOM, _TOP, self.log),
        )

    def _axes(self, scale_x: "_Scale", scale_y: "_Scale") -> list[str]:
        left, right, bottom = _LEFT, self.width - _RIGHT, self.height - _BOTTOM
        parts = []
        for value in scale_y.ticks(max(self.height // 45, 2)):
            y = scale_y(value)
            parts.append(f'<path class="grid" d="M{left} {y:.1f}H{right}"/>')
            parts.append(f'<text class="tick" text-anchor="end" x="{left - 6}" y="{y + 4:.1f}">{number(value)}</text>')
        for value in scale_x.ticks(10):
            x = scale_x(value)
            parts.append(f'<path class="grid" d="M{x:.1f} {_TOP}V{bottom}"/>')
            parts.append(
                f'<text class="tick" text-anchor="middle" x="{x:.1f}" y="{bottom + 14}">{number(value)}</text>'
            )
        parts.append(
            f'<text class="axis" text-anchor="end" x="{right}" y="{self.height - 2}">{escape(self.x_label)}</text>'
        )
        parts.append(f'<text class="axis" x="{left}" y="{_TOP - 9}">{escape(self.y_label)}</text>')
        return parts

    def _span(self, scale_x: "_Scale", start: float, end: float, style: str) -> str:
        x0, x1 = (min(max(scale_x(value), _LEFT), self.width - _RIGHT) for value in (start, end))
        width, height = max(x1 - x0, 1.0), self.height - _TOP - _BOTTOM
        return f'<rect class="{style}" x="{x0:.1f}" y="{_TOP}" width="{width:.1f}" height="{height}"/>'

    def _legend_text(self) -> str:
        parts, x = [], float(self.width - _RIGHT - 6)
        for label, style in reversed(self._legend):
            width = 6.6 * len(label)
            parts.append(f'<text class="axis" text-anchor="end" x="{x:.0f}" y="{_TOP - 9}">{escape(label)}</text>')
            parts.append(f'<path class="key {style}" d="M{x - width - 22:.0f} {_TOP - 13}h14"/>')
            x -= width + 34
        return "".join(parts)


@dataclass(frozen=True)
class _Scale:
    """Mapping from data to pixels."""

    low: float
    high: float
    start: float
    end: float
    log: bool = False

    def __call__(self, value):
        low, high = self.low, self.high
        if self.log:
            value, low, high = np.log10(np.maximum(value, low)), math.log10(low), math.log10(high)
        return self.start + (value - low) / (high - low) * (self.end - self.start)

    def ticks(self, about: int) -> list[float]:
        if not self.log:
            return ticks(self.low, self.high, about)
        powers = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
        steps = (1.0,) if len(powers) > about + 2 else (1.0, 3.0)
        values = [step * 10.0**p for p in powers for step in steps]
        return [value for value in values if self.low * 0.999 <= value <= self.high * 1.001]


def _limits(parts: list[Array], margin: float, log: bool = False) -> tuple[float, float]:
    joined = np.concatenate([part[np.isfinite(part)] for part in parts]) if parts else np.empty(0)
    if log:
        joined = joined[joined > 0.0]
    if len(joined) == 0:
        return (0.1, 1.0) if log else (0.0, 1.0)
    low, high = float(joined.min()), float(joined.max())
    if log:
        return max(low * 0.8, 0.05), max(high * 1.3, low * 10.0, 1.0)
    pad = margin * (high - low) or (abs(high) or 1.0) * 1e-3
    return low - pad * (margin > 0), high + pad * (margin > 0 or high == low)


def _line(scale_x: _Scale, scale_y: _Scale, data: tuple[Array, ...], style: str) -> str:
    x, y = data
    good = np.isfinite(x) & np.isfinite(y)
    breaks = np.flatnonzero(np.diff(good.astype(np.int8)) != 0) + 1
    path = []
    for part in np.split(np.arange(len(x)), breaks):
        if len(part) and good[part[0]]:
            path.append("M" + _points(scale_x(x[part]), scale_y(y[part])))
    return f'<path class="line {style}" d="{"".join(path)}"/>' if path else ""


def _band(scale_x: _Scale, scale_y: _Scale, data: tuple[Array, ...], style: str) -> str:
    x, high, low = (part[np.isfinite(data[1]) & np.isfinite(data[2])] for part in data)
    if len(x) == 0:
        return ""
    ring = _points(np.concatenate([scale_x(x), scale_x(x[::-1])]), np.concatenate([scale_y(high), scale_y(low[::-1])]))
    return f'<path class="band {style}" d="M{ring}Z"/>'


def _points(x: Array, y: Array) -> str:
    pairs = np.stack([x, y], axis=1).tolist()
    return "L".join(["%.1f %.1f" % (a, b) for a, b in pairs])  # noqa: UP031  twice as fast as an f-string
