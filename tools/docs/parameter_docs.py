"""Writes ``config/nav_pose_estimator.yaml`` and ``docs/parameters.md`` from the parameter dataclasses.

``python tools/docs/parameter_docs.py`` writes both; with ``--check`` it only reports whether they are up to date.
"""

import argparse
import sys
import textwrap
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import troubleshooting_docs
from nav_pose_estimator.engine.outage.methods.registry import all_methods, estimators
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import Spec, spec_of

REPOSITORY = Path(__file__).resolve().parents[2]
YAML_FILE = Path("config/nav_pose_estimator.yaml")
PAGE = Path("docs/parameters.md")
WIDTH = 120

_YAML_HEAD = """\
# Every parameter of every node with its default: leave out what you do not change.
# Written by `make docs` from nav_pose_estimator/engine/parameters; a comment says what a value means, then its unit
# and range. Parameters marked "live" can be set while the node runs (ros2 param set), the others only at start.
/**:
  ros__parameters:
"""
_PAGE_HEAD = """\
# Parameters

Written by `make docs` from `nav_pose_estimator/engine/parameters`. The same names hold in a ROS parameter file, with
`-p NAME:=VALUE` on the command line, and in `replay --config FILE`. *Live* parameters can be set while a node runs; the
others are read-only then. An unknown name, a wrong type or a value out of range is refused in one sentence. A
*deviation* is one standard deviation.
"""
_METHODS_HEAD = """
## Methods

Ways through an outage: values of `learner.method` and of `replay --method`, and of `benchmark outage --methods`.

| method | what it uses | where | classical |
|---|---|---|---|
"""


def yaml_text() -> str:
    """The parameter file with every default."""
    return _YAML_HEAD + "".join(_yaml_group(Parameters(), 4))


def page_text() -> str:
    """The documentation page: one table per group, and the methods through an outage."""
    return _PAGE_HEAD + "".join(_page_groups(Parameters(), "")) + _METHODS_HEAD + "".join(_page_methods())


def _yaml_group(group: Any, indent: int) -> Iterator[str]:
    margin = " " * indent
    for item in fields(group):
        value = getattr(group, item.name)
        if is_dataclass(value):
            yield f"\n{_comment(_summary(value), margin)}{margin}{item.name}:\n"
            yield from _yaml_group(value, indent + 2)
        else:
            spec = spec_of(item, item.name, value)
            yield f"{_comment('. '.join(_facts(spec)), margin)}{margin}{item.name}: {_yaml_value(value)}\n"


def _facts(spec: Spec) -> Iterator[str]:
    yield spec.description.rstrip(".")
    bounds = _bounds(spec)
    measure = ", ".join(text for text in (spec.unit, bounds, "live" if spec.mutable else "") if text)
    if measure:
        yield f"[{measure}]"


def _bounds(spec: Spec) -> str:
    if spec.choices:
        return " | ".join(spec.choices)
    low, high = spec.minimum, spec.maximum
    if low is not None and high is not None:
        return f"{low:g} to {high:g}"
    if low is not None:
        return f"at least {low:g}"
    return "" if high is None else f"at most {high:g}"


def _page_groups(group: Any, prefix: str) -> Iterator[str]:
    specs = [item for item in fields(group) if not is_dataclass(getattr(group, item.name))]
    if specs:
        yield f"\n## {prefix.rstrip('.')}\n\n{_summary(group)}\n\n"
        yield "| parameter | default | unit | range | live | meaning |\n|---|---|---|---|---|---|\n"
    for item in specs:
        spec = spec_of(item, item.name, getattr(group, item.name))
        cells = [f"`{prefix}{spec.key}`", f"`{_yaml_value(spec.default)}`", spec.unit, _bounds(spec)]
        cells += ["yes" if spec.mutable else "", spec.description]
        yield "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n"
    for item in fields(group):
        if is_dataclass(getattr(group, item.name)):
            yield from _page_groups(getattr(group, item.name), f"{prefix}{item.name}.")


def _page_methods() -> Iterator[str]:
    for method in all_methods():
        where = "everywhere" if method.name in estimators() else "`benchmark outage`"
        yield f"| `{method.name}` | {method.summary} | {where} | {'yes' if method.is_classical else ''} |\n"


def _summary(group: Any) -> str:
    return " ".join((type(group).__doc__ or "").split("\n\n")[0].split())


def _comment(text: str, margin: str) -> str:
    return (
        textwrap.fill(
            text, WIDTH, initial_indent=f"{margin}# ", subsequent_indent=f"{margin}#   ", break_on_hyphens=False
        )
        + "\n"
    )


def _yaml_value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return "[" + ", ".join(_yaml_value(item) for item in value) + "]"
    if isinstance(value, str):
        return f'"{value}"'
    return _yaml_float(value) if isinstance(value, float) else str(value)


def _yaml_float(value: float) -> str:
    """Text of a float with a point and a signed exponent, without which YAML 1.1 reads a string."""
    text = repr(value)
    mantissa, mark, exponent = text.partition("e")
    return f"{mantissa if '.' in mantissa else mantissa + '.0'}{mark}{exponent}" if mark else text


def main() -> int:
    """Write the files, or check them."""
    parser = argparse.ArgumentParser(description="Write the parameter file and the generated pages from the code.")
    parser.add_argument("--check", action="store_true", help="write nothing, exit with 1 if a file is not up to date")
    check = parser.parse_args().check
    stale = 0
    pages = ((PAGE, page_text()), (troubleshooting_docs.PAGE, troubleshooting_docs.page_text()))
    for path, text in ((YAML_FILE, yaml_text()), *pages):
        target = REPOSITORY / path
        if target.exists() and target.read_text(encoding="utf-8") == text:
            continue
        stale += 1
        if not check:
            target.write_text(text, encoding="utf-8")
        print(f"{path} is out of date: run make docs" if check else f"wrote {path}")
    return 1 if check and stale else 0


if __name__ == "__main__":
    sys.exit(main())
