"""Plots that can be zoomed and read with the pointer, if plotly is installed: its script, next to the page.

Nothing is imported from plotly, which takes long: one file of it is copied. A page without that file beside it shows
the plots as they were drawn. The data of a plot are JSON in the page, arrays as base64 of little-endian float32.
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
_LOWEST = 0.25  # of a track's extent: a flatter height is stretched to it
POINTS = 4000  # of one line: three times what a screen shows, so that zooming shows more

Array = np.ndarray


@cache
def script() -> Path | None:
    """The script in the installed package; None without it."""
    spec = find_spec("plotly")
    places = [] if spec is None else spec.submodule_search_locations or []
    return next((p for place in places if (p := Path(place) / "package_data" / SCRIPT).is_file()), None)


def provide(folder: Path) -> bool:
    """Put the script into ``folder``; False where there is none."""
    source = script()
    if source is not None:
        shutil.copyfile(source, folder / SCRIPT)
    return source is not None


def code() -> str:
    """What turns the data in the page into plots."""
    return Path(__file__).with_name("live.js").read_text(encoding="utf-8")


def numbers(values: Array) -> str:
    """An array as text."""
    return base64.b64encode(np.ascontiguousarray(values, "<f4").tobytes()).decode("ascii")


def as_json(plot: Mapping[str, Any]) -> str:
    """To stand in a script element of a page."""
    return json.dumps(plot, separators=(",", ":")).replace("<", "\\u003c")


@dataclass(frozen=True)
class Track:
    """Paths in space, ``lines`` of (ENU (N, 3) [m], style, label). A page without script has no drawing of it.

    ``t`` (N,) [s], ``path`` (N, 3): where the vehicle was when, for who points at a time in another plot.
    """

    lines: Sequence[tuple[Array, str, str]]
    t: Array
    path: Array
    height: int = 520

    def data(self) -> dict[str, Any]:
        """For the script. Up is stretched where the path is flat."""
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
