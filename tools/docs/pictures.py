"""Pictures of the reports: those in the documentation, and a gallery of all variants.

    python tools/docs/pictures.py readme RECORDING --outage 400:30    # docs/outage.png
    python tools/docs/pictures.py report                              # docs/report.png, of the shipped flight
    python tools/docs/pictures.py gallery --out out/pictures          # of the shipped flight: out/pictures/index.html

Needs Chromium (apt install chromium).
"""

import argparse
import shutil
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from chromium import CHROMIUM, picture
from nav_pose_estimator.offline.command_line import main as command
from nav_pose_estimator.offline.page import live

REPOSITORY = Path(__file__).resolve().parents[2]
_README_SIZE = (1000, 1320)
_README_STYLE = "<style>.tiles{display:none}</style>"  # without the figures of the computing time
_REPORT_SIZE = (900, 1820)
_HIDDEN = "main>:is(h1,h2,p,.tiles,.scroll,figure:nth-of-type(1)){display:none}"
_REPORT_STYLE = f"<style>{_HIDDEN}figure{{margin-bottom:8px}}</style>"


@dataclass(frozen=True)
class Look:
    """A variant: its description, the report and the size of the window."""

    name: str
    caption: str
    size: tuple[int, int]
    dark: bool = False
    drawn: bool = False  # without plotly


LOOKS = (
    Look("wide_light", "a desktop", (1100, 6400)),
    Look("wide_dark", "a dark desktop", (1100, 6400), dark=True),
    Look("narrow_light", "a narrow window", (500, 6400)),
    Look("narrow_dark", "a narrow window, dark", (500, 6400), dark=True),
    Look("drawn_light", "without plotly: drawn plots", (1100, 5400), drawn=True),
)


def report(recording: Path, outage: str, folder: Path) -> Path:
    """The report of a replay of ``recording`` with an ``outage`` START:LENGTH."""
    code = command(["replay", str(recording), "--outage", outage, "--out", str(folder)])
    if code:
        sys.exit(code)
    return folder / "report.html"


def styled(page: Path, style: str) -> None:
    """Add a ``style`` element to a page."""
    page.write_text(page.read_text(encoding="utf-8").replace("</head>", f"{style}</head>"), encoding="utf-8")


def gallery(page: Path, out: Path) -> list[Path]:
    """Write pictures of ``page`` in all variants and an index.html with them; return the pictures."""
    out.mkdir(parents=True, exist_ok=True)
    made = []
    with tempfile.TemporaryDirectory() as folder:
        alone = Path(folder) / page.name
        shutil.copyfile(page, alone)
        for look in LOOKS:
            made.append(out / f"{look.name}.png")
            picture(alone if look.drawn else page, made[-1], look.size, look.dark)
    items = "".join(
        f'<figure><figcaption>{escape(look.caption)}</figcaption><img src="{look.name}.png" width="{look.size[0]}">'
        "</figure>"
        for look in LOOKS
    )
    title = "<!doctype html><meta charset=utf-8><title>Reports</title>"
    (out / "index.html").write_text(f"{title}<body style='display:flex;flex-wrap:wrap'>{items}\n", encoding="utf-8")
    return made


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one of the commands."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    readme = commands.add_parser("readme", help="docs/outage.png")
    readme.add_argument("recording", type=Path)
    readme.add_argument("--outage", default="400:30")
    commands.add_parser("report", help="docs/report.png")
    show = commands.add_parser("gallery", help="a page of pictures")
    show.add_argument("--out", type=Path, default=Path("out/pictures"))
    given = parser.parse_args(arguments)
    if CHROMIUM is None:
        sys.exit("there is no Chromium here (apt install chromium)")
    with tempfile.TemporaryDirectory() as folder:
        if given.command == "readme":
            page = report(given.recording, given.outage, Path(folder) / "replay")
            (page.parent / live.SCRIPT).unlink(missing_ok=True)  # the static drawing is smaller as a picture
            styled(page, _README_STYLE)
            picture(page, REPOSITORY / "docs" / "outage.png", _README_SIZE)
            return 0
        page = report(REPOSITORY / "bags" / "multirotor_outage", "90:30", Path(folder) / "replay")
        if given.command == "report":
            styled(page, _REPORT_STYLE)
            picture(page, REPOSITORY / "docs" / "report.png", _REPORT_SIZE)
        else:
            gallery(page, given.out)
            print(f"pictures: {given.out / 'index.html'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
