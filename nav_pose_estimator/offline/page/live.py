"""Interactive plots in the HTML reports, by the script of plotly if that is installed.

The package plotly is not imported, which would take long; its script is copied beside the page. Without the script the
page shows the static plots. The data of a plot are JSON in the page, with arrays as base64 of little-endian float32.
"""

import base64
import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

SCRIPT = "plotly.min.js"
_LOWEST = 0.25  # smallest displayed height of a track relative to its extent; a lower one is stretched
POINTS = 4000  # largest number of points of a line, three times that of a screen, for zooming

Array = np.ndarray


@cache
def script() -> Path | None:
    """The script in the installed package; None without it."""
    spec = find_spec("plotly")
    places = [] if spec is None else spec.submodule_search_locations or []
    return next((p for place in places if (p := Path(place) / "package_data" / SCRIPT).is_file()), None)


def provide(folder: Path) -> bool:
    """Copy the script to ``folder``; False if plotly is not installed."""
    source = script()
    if source is not None:
        shutil.copyfile(source, folder / SCRIPT)
    return source is not None


def code() -> str:
    """JavaScript that creates the plots from the data in the page."""
    return Path(__file__).with_name("live.js").read_text(encoding="utf-8")


def numbers(values: Array) -> str:
    """An array as text."""
    return base64.b64encode(np.ascontiguousarray(values, "<f4").tobytes()).decode("ascii")


def as_json(plot: Mapping[str, Any]) -> str:
    """Data of a plot as JSON for a script element of a page."""
    return json.dumps(plot, separators=(",", ":")).replace("<", "\\u003c")


@dataclass(frozen=True)
class Track:
    """Paths in space, ``lines`` of (ENU (N, 3) [m], style, label), which are only shown with the script.

    ``t`` (N,) [s] and ``path`` (N, 3) [m]: positions by time, to mark the time under the pointer in another plot.
    """

    lines: Sequence[tuple[Array, str, str]]
    t: Array
    path: Array
    height: int = 520

    def data(self) -> dict[str, Any]:
        """Data for the script; the vertical axis is stretched for flat paths."""
        points = np.concatenate([enu for enu, *_ in self.lines])
        extent = np.nanmax(points, axis=0) - np.nanmin(points, axis=0)
        longest = max(float(extent[:2].max()), 1e-3)
        east, north, up = np.maximum(extent / longest, [0.1, 0.1, _LOWEST]).tolist()
        return {
            "kind": "track",
            "height": self.height,
            "path": {"t": numbers(self.t), **_axes(self.path)},
            "aspect": {"x": east, "y": north, "z": up},
            "lines": [{"style": style, "label": label, **_axes(enu)} for enu, style, label in self.lines],
        }


def _axes(enu: Array) -> dict[str, str]:
    return {name: numbers(enu[:, i]) for i, name in enumerate("xyz")}
