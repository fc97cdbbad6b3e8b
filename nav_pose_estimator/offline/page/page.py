"""Common layout of the HTML reports: self-contained, with light and dark colours and optionally interactive plots."""

from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

from nav_pose_estimator.offline.page import live
from nav_pose_estimator.offline.page.svg import Plot

_PLOT = '<figure class="plot"'
LINES = ("a", "b", "c", "d", "e", "f", "a dash", "b dash", "c dash")
"""Styles that distinguish the lines of a plot, in order."""
STYLE = """
:root{--bg:#fbfbf9;--card:#fff;--ink:#1c2126;--soft:#66707a;--rule:#e4e6e4;--a:#1f6feb;--b:#d1495b;--c:#2a9d6f;
--d:#8e5bd0;--e:#c98a1b;--f:#5b6770;--shade:#f6d9a8;--good:#2a9d6f;--bad:#c8323f}
@media(prefers-color-scheme:dark){:root{--bg:#14171a;--card:#1b1f23;--ink:#e6e8ea;--soft:#98a2ab;--rule:#2c3237;
--a:#6aa8ff;--b:#ff7b8a;--c:#5fd1a0;--d:#bb96f2;--e:#e8b35a;--f:#9aa5ae;--shade:#5a441c;--good:#5fd1a0;--bad:#ff7b8a}}
*{box-sizing:border-box}body{margin:0;background:var(--bg);color:var(--ink);
font:15px/1.55 ui-sans-serif,system-ui,"Segoe UI",Roboto,"Helvetica Neue",sans-serif;font-variant-numeric:tabular-nums}
main{max-width:1000px;margin:0 auto;padding:36px 20px 60px}h1{font-size:27px;line-height:1.2;margin:0 0 2px;
letter-spacing:-.01em}h2{font-size:17px;margin:34px 0 8px}p{margin:6px 0 10px}.soft,small{color:var(--soft)}
.tiles{display:grid;grid-template-columns:repeat(auto-fit,minmax(140px,1fr));gap:10px;margin:20px 0}
.tile{background:var(--card);border:1px solid var(--rule);border-radius:8px;padding:10px 14px}
.tile b{display:block;font-size:21px;font-weight:600;letter-spacing:-.01em}.tile span{color:var(--soft);font-size:13px}
figure{margin:0;background:var(--card);border:1px solid var(--rule);border-radius:8px;padding:8px}
figure+figure{margin-top:8px}figcaption{color:var(--soft);font-size:13px;padding:2px 6px 4px}
svg{display:block;width:100%;height:auto}.scroll{overflow-x:auto}
table{border-collapse:collapse;width:100%;font-size:14px}th,td{padding:4px 10px;
text-align:right;border-bottom:1px solid var(--rule);white-space:nowrap}th{color:var(--soft);font-weight:500}
th:first-child,td:first-child,td.text,th.text{text-align:left}td.text{white-space:normal}td.best{font-weight:650}
.line{fill:none;stroke-width:1.5;stroke-linejoin:round}.key{fill:none;stroke-width:3}.band{stroke:none;opacity:.22}
.a{stroke:var(--a)}.b{stroke:var(--b)}.c{stroke:var(--c)}.d{stroke:var(--d)}.e{stroke:var(--e)}.f{stroke:var(--f)}
.band.a{fill:var(--a)}.band.b{fill:var(--b)}.band.c{fill:var(--c)}.band.d{fill:var(--d)}.band.e{fill:var(--e)}
.band.f{fill:var(--f)}.dot{fill:var(--ink)}.dash{stroke-dasharray:4 3}.thick{stroke-width:3}.grid{stroke:var(--rule);
stroke-width:1}.outage{fill:var(--shade);opacity:.6}.tick,.axis,.mark{font-size:11.5px;fill:var(--soft)}
.mark{fill:var(--ink)}.mode-good{fill:var(--good)}.mode-bad{fill:var(--bad)}.mode-mid{fill:var(--e)}
.mode-wait{fill:var(--f)}figure[hidden],.is-live .drawn,figure:not(.is-live) .live{display:none}
details{margin:6px 0}summary{cursor:pointer;color:var(--soft)}
"""


def write(path: Path, title: str, body: Iterable[str]) -> None:
    """Write a page, and beside it the script for interactive plots if plotly is installed."""
    head = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f'<meta name="color-scheme" content="light dark"><title>{escape(title)}</title><style>{STYLE}</style></head>'
    )
    has_plots = False
    with path.open("w", encoding="utf-8") as file:
        file.write(f"{head}<body><main>")
        for part in body:
            has_plots = has_plots or _PLOT in part
            file.write(part)
        file.write("</main>")
        if has_plots and live.provide(path.parent):
            file.write(f'<script src="{live.SCRIPT}"></script><script>{live.code()}</script>')
        file.write("</body></html>\n")


def tiles(pairs: Iterable[tuple[str, str]]) -> str:
    """Key figures: (value, what it is)."""
    items = "".join(f'<div class="tile"><b>{escape(v)}</b><span>{escape(k)}</span></div>' for v, k in pairs)
    return f'<div class="tiles">{items}</div>'


def figure(plot: Plot | live.Track | str, caption: str = "") -> str:
    """A plot with its caption: the static drawing and the data for the script. A string is a static ``<svg>``."""
    words = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    if isinstance(plot, str):
        return f"<figure>{plot}{words}</figure>"
    drawn, hidden = ("", " hidden") if isinstance(plot, live.Track) else (plot.render(), "")
    data = f'<script type="application/json">{live.as_json(plot.data())}</script>'
    return f'{_PLOT}{hidden}><div class="drawn">{drawn}</div><div class="live"></div>{data}{words}</figure>'


def table(header: Sequence[str], rows: Iterable[Sequence[str]], text_columns: Sequence[int] = (0,)) -> str:
    """A table of texts; ``text_columns`` are left-aligned. A cell that begins with ``*`` is highlighted as the best."""

    def cell(i: int, value: str) -> str:
        names = [name for name, on in (("text", i in text_columns), ("best", value.startswith("*"))) if on]
        mark = f' class="{" ".join(names)}"' if names else ""
        return f"<td{mark}>{escape(value.removeprefix('*'))}</td>"

    head = "".join(f"<th{' class=text' if i in text_columns else ''}>{escape(h)}</th>" for i, h in enumerate(header))
    body = "".join(f"<tr>{''.join(cell(i, v) for i, v in enumerate(row))}</tr>" for row in rows)
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'
