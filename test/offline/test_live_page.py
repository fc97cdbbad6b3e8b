"""The report as it is read: in a browser, light and dark, wide and narrow, by its numbers; and without the script."""

import json
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pictures
from browser import ask, needs_browser
from nav_pose_estimator.offline.command_line import main
from nav_pose_estimator.offline.page import live, page
from nav_pose_estimator.offline.page.svg import Plot

pytestmark = pytest.mark.compiled
START, END = 90.0, 120.0
LOOKS = [(1100, False), (420, True)]
QUESTION = """(async () => {
  const shown = [...document.querySelectorAll("figure.plot")].map((figure) => figure.querySelector(".live"));
  const isTimed = (axis) => axis && axis.title.text.startsWith("s since");
  const timed = shown.filter((plot) => isTimed(plot._fullLayout.xaxis));
  const before = timed.map((plot) => [...plot._fullLayout.xaxis.range]);
  const name = (plot) => plot.layout.annotations ? plot.layout.annotations[0].text : "track";
  const error = timed.find((plot) => name(plot).startsWith("horizontal error"));
  const field = error.querySelector(".nsewdrag"), box = field.getBoundingClientRect();
  const [low, high] = error._fullLayout.xaxis.range;
  field.dispatchEvent(new MouseEvent("mousemove", { bubbles: true, clientY: box.top + box.height / 2,
    clientX: box.left + box.width * (105 - low) / (high - low) }));
  await new Promise((done) => setTimeout(done, 500));
  const hover = error.querySelector(".hoverlayer").textContent;
  const here = shown.map((plot) => plot.data.find((one) => one.name === "here")).filter((one) => one)
    .map((one) => [one.x[0], one.y[0]]);
  await Plotly.relayout(error, { "xaxis.range[0]": 95, "xaxis.range[1]": 115 });
  await new Promise((done) => setTimeout(done, 500));
  const style = getComputedStyle(document.body);
  return {
    plots: shown.map((plot) => ({
      name: name(plot), drawn: getComputedStyle(plot.parentElement.querySelector(".drawn")).display,
      overflow: plot.scrollWidth - plot.parentElement.clientWidth, top: plot._fullLayout.margin.t,
      traces: plot.data.map((one) => ({ name: one.name || "", type: one.type,
        x: [...one.x], y: [...one.y], z: one.z ? [...one.z] : [] })) })),
    hover, here, before, after: timed.map((plot) => plot._fullLayout.xaxis.range),
    background: style.backgroundColor, ink: style.color,
    tick: getComputedStyle(document.querySelector(".xtick text")).fill,
    tooWide: document.documentElement.scrollWidth - document.documentElement.clientWidth,
  };
})()"""


@pytest.fixture(scope="module")
def report(tmp_path_factory, repository) -> Path:
    """The report of the shipped flight that `make demo` replays."""
    folder = tmp_path_factory.mktemp("live") / "demo"
    bag = str(repository / "bags" / "multirotor_outage")
    assert main(["replay", bag, "--outage", f"{START:g}:{END - START:g}", "--out", str(folder)]) == 0
    return folder / "report.html"


@pytest.fixture(scope="module", params=LOOKS, ids=["wide, light", "narrow, dark"])
def seen(request, report) -> dict[str, Any]:
    """What the browser shows of it."""
    if live.script() is None:
        pytest.skip("needs the Python package plotly (requirements.txt)")
    width, dark = request.param
    return {"width": width, "dark": dark, **ask(report, QUESTION, width, dark)}


def plot(seen: dict[str, Any], beginning: str) -> dict[str, Any]:
    (found,) = (one for one in seen["plots"] if one["name"].startswith(beginning))
    return found


def trace(one: dict[str, Any], name: str) -> dict[str, np.ndarray]:
    (found,) = (t for t in one["traces"] if t["name"] == name)
    return {axis: np.array([np.nan if v is None else v for v in found[axis]], float) for axis in "xyz"}


def test_every_plot_is_alive_and_fits(seen) -> None:
    """GIVEN a window of any width WHEN the page stands THEN each plot has taken the place of its drawing, and fits."""
    assert len(seen["plots"]) >= 11
    assert {one["drawn"] for one in seen["plots"]} == {"none"}
    assert [one["name"] for one in seen["plots"] if one["overflow"] > 0] == []
    assert seen["tooWide"] <= 0


def test_the_plots_show_the_numbers_of_the_summary(seen, report) -> None:
    """GIVEN summary.json WHEN the error is read off the page THEN its largest value in the outage is that one."""
    (outage,) = json.loads((report.parent / "summary.json").read_text())["outages"]
    error = trace(plot(seen, "horizontal error"), "error")
    inside = (error["x"] >= START) & (error["x"] < END)
    assert error["y"][inside].max() == pytest.approx(outage["max_error_m"], rel=1e-3)
    at_end = inside & (error["x"] >= END - 1.05)
    assert error["y"][at_end].mean() == pytest.approx(outage["end_error_m"], rel=1e-3)
    sigma = trace(plot(seen, "horizontal error"), "3 sigma")
    assert np.interp(END - 0.5, sigma["x"], sigma["y"]) == pytest.approx(3.0 * outage["end_sigma_m"], rel=0.1)


def test_the_track_is_the_map_with_heights(seen) -> None:
    track, on_map = plot(seen, "track"), plot(seen, "North, m")
    assert {one["type"] for one in track["traces"]} == {"scatter3d"}
    in_space, flat = trace(track, "estimate"), trace(on_map, "estimate")
    for axis in "xy":
        assert in_space[axis].max() == pytest.approx(flat[axis].max(), abs=1.0)
    assert 5.0 < in_space["z"].max() - in_space["z"].min() < 100.0


def test_what_the_network_said_stands_beside_what_was_flown(seen) -> None:
    """GIVEN an outage with a trained network WHEN read THEN prediction and flight cover it, alike but not the same."""
    velocity = plot(seen, "velocity over ground")
    for axis in ("East", "North"):
        said, flown = trace(velocity, f"{axis}, predicted"), trace(velocity, f"{axis}, flown")
        known = np.isfinite(flown["y"])
        assert START <= flown["x"][known].min() < START + 1.0
        assert END - 1.0 < flown["x"][known].max() < END
        assert len(said["x"]) > 30
        off = np.interp(said["x"], flown["x"][known], flown["y"][known]) - said["y"]
        off = off[np.isfinite(off)]
        assert 0.01 < np.sqrt(np.mean(off**2)) < 0.7 * np.ptp(flown["y"][known])


def test_the_reliability_diagram_rises_from_none_to_nearly_all(seen) -> None:
    for name in ("East and North", "Up"):
        share = trace(plot(seen, "share of errors"), name)
        assert np.all(np.diff(share["y"]) >= 0.0)
        assert share["y"][0] < 0.5 < share["y"][-1] <= 1.0


def test_pointing_tells_the_value(seen) -> None:
    """GIVEN the pointer at 105 s WHEN it rests there THEN the error at that time is told."""
    error = trace(plot(seen, "horizontal error"), "error")
    told = [float(value) for value in re.findall(r"\d+\.?\d*", seen["hover"].replace("3 sigma", ""))]
    time = min(told, key=lambda value: abs(value - 105.0))
    assert time == pytest.approx(105.0, abs=0.1)
    nearest = error["y"][np.argmin(np.abs(error["x"] - time))]
    assert any(value == pytest.approx(nearest, rel=0.02) for value in told), (told, nearest)


def test_pointing_at_a_time_shows_the_place(seen, report) -> None:
    """GIVEN the pointer at 105 s in the plot of the error WHEN it rests THEN map and track mark where that was."""
    rows = np.genfromtxt(report.parent / "estimate.csv", delimiter=",", names=True, usecols=range(7))
    there = [np.interp(105.0, rows["t_s"], rows[name]) for name in ("east_m", "north_m")]
    assert len(seen["here"]) == 2
    for place in seen["here"]:
        assert place == pytest.approx(there, abs=1.0)


def test_plots_over_time_zoom_together(seen) -> None:
    """GIVEN plots over the time of the flight WHEN one is zoomed THEN all show that time."""
    assert len(seen["after"]) >= 8
    assert all(low < 20.0 and high > 250.0 for low, high in seen["before"])
    assert np.allclose(seen["after"], [95.0, 115.0])


def test_colours_follow_the_theme(seen) -> None:
    """GIVEN a light or a dark desktop WHEN the page stands THEN ink and ticks are far from the background."""

    def brightness(color: str) -> float:
        return float(np.mean([float(value) for value in re.findall(r"[\d.]+", color)[:3]]))

    assert (brightness(seen["background"]) < 128.0) is seen["dark"]
    for name in ("ink", "tick"):
        assert abs(brightness(seen[name]) - brightness(seen["background"])) > 90.0


def test_without_plotly_the_page_is_the_drawn_one(report, tmp_path, monkeypatch) -> None:
    """GIVEN no package plotly WHEN a report is written THEN it is one file without a script, with its plots drawn."""
    monkeypatch.setattr(live, "script", lambda: None)
    drawing = Plot("s", "m")
    drawing.line(np.arange(5.0), np.arange(5.0), "a", "line")
    page.write(tmp_path / "page.html", "page", [page.figure(drawing, "a line")])
    text = (tmp_path / "page.html").read_text()
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]
    assert "<svg" in text
    assert "<script src" not in text
    question = "getComputedStyle(document.querySelector('.drawn')).display"
    assert ask(tmp_path / "page.html", question, 800, False) == "block"


def test_a_report_without_its_script_beside_it_shows_the_drawings(report, tmp_path) -> None:
    """GIVEN report.html alone, as it is mailed WHEN it is opened THEN its plots are the drawn ones."""
    alone = tmp_path / "report.html"
    alone.write_text(report.read_text())
    question = "[...document.querySelectorAll('figure.plot:not([hidden]) .drawn')].map((d) => d.clientHeight > 50)"
    drawn = ask(alone, question, 800, False)
    assert len(drawn) >= 10
    assert all(drawn)


def test_the_page_of_pictures_has_every_look(report, tmp_path, monkeypatch) -> None:
    """GIVEN a report WHEN `make pictures` takes its pictures THEN each is a PNG of its size with something in it."""
    needs_browser()
    looks = [pictures.Look("wide", "", (900, 1200)), pictures.Look("dark", "", (500, 1200), True, drawn=True)]
    monkeypatch.setattr(pictures, "LOOKS", looks)
    made = pictures.gallery(report, tmp_path / "pictures")
    for look, path in zip(looks, made, strict=True):
        data = path.read_bytes()
        assert data.startswith(b"\x89PNG")
        assert struct.unpack(">II", data[16:24]) == look.size
        assert len(data) > 20_000, "an empty page takes a tenth of it"
        assert f'src="{path.name}"' in (path.parent / "index.html").read_text()


def test_nothing_in_a_report_is_from_elsewhere(report) -> None:
    """GIVEN a page WHEN it is opened THEN the script beside it is all that it loads, and it names no other host."""
    text = report.read_text()
    own = text.replace("http://www.w3.org/2000/svg", "")
    assert re.findall(r"https?://", own) == []
    assert re.findall(r'(?:src|href)="([^"]+)"', text) in ([live.SCRIPT], [])
