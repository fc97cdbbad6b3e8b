"""Files of population statistics of motion: TOML that ``train prior`` writes, and the one shipped with the package.

The numbers are followed by the list of flights that they come from. A file with implausible values is refused.
"""

import tomllib
from dataclasses import dataclass, fields
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

from nav_pose_estimator.core.motion.usual import Drag, Hover, Travel, UsualMotion
from nav_pose_estimator.errors import UserError

SHIPPED = "usual_motion.toml"
VERSION = 1
_LARGEST = 1 << 20  # bytes: largest size of a file
_BOUNDS = {  # plausible values, in the units of ``core.motion.usual``
    "speed": (0.01, 100.0),
    "velocity_time": (0.5, 600.0),
    "loiter": (0.5, 600.0),
    "wander": (0.01, 100.0),
    "time": (0.5, 3600.0),
    "missed": (0.001, 0.99),
    "rate": (0.01, 10.0),
    "rate_spread": (0.001, 10.0),
    "noise": (0.05, 50.0),
}
_MEAN_BOUNDS, _DEVIATION_BOUNDS = (-7.0, 5.0), (0.05, 5.0)  # of an activity, a logarithm of m/s^2
_Part = TypeVar("_Part", Travel, Hover, Drag)


@dataclass(frozen=True)
class KnownFlight:
    """A flight that a prior was made from: its ``airframe``, the SHA-256 of the recording, the kind of vehicle."""

    airframe: str
    digest: str
    kind: str


@lru_cache(maxsize=8)
def load_usual_motion(path: str = "") -> UsualMotion:
    """The content of the file ``path``; empty: of the shipped file. Raises ``UserError`` for an unusable file."""
    name, content = _content(path)
    multirotor, fixed_wing = (_part(name, content, key, Travel) for key in ("multirotor", "fixed_wing"))
    hover, drag = _part(name, content, "hover", Hover), _part(name, content, "drag", Drag)
    return UsualMotion(multirotor, fixed_wing, hover, drag)


def flights_of(path: str = "") -> list[KnownFlight]:
    """The flights that the numbers of the file come from; ``path`` and errors as for ``load_usual_motion``."""
    flights = _content(path)[1].get("flights", [])
    return [KnownFlight(*(str(one.get(key, "")) for key in ("airframe", "sha256", "kind"))) for one in flights]


def _content(path: str) -> tuple[str, dict[str, Any]]:
    """The name of the file for messages, and its parsed content."""
    name = path or SHIPPED
    try:
        if path and Path(path).stat().st_size > _LARGEST:
            raise UserError(f"{path} is not a prior of train prior: it is too large")
        text = Path(path).read_text("utf-8") if path else files(__package__).joinpath(SHIPPED).read_text("utf-8")
        content = tomllib.loads(text)
    except OSError as error:
        raise UserError(f"cannot read the prior {path}: {error.strerror}") from None
    except ValueError as error:  # neither UTF-8 nor TOML
        raise UserError(f"{name} is not a prior of train prior: {' '.join(str(error).split())}") from None
    if content.get("version") != VERSION:
        raise UserError(f"{name} is not a prior of version {VERSION}: make it again with train prior")
    return name, content


def as_toml(usual: UsualMotion) -> str:
    """The numbers as the text of a file, without the list of flights."""
    lines = [f"version = {VERSION}"]
    for part in fields(usual):
        lines += ["", f"[{part.name}]"]
        values = getattr(usual, part.name)
        for item in fields(values):
            value = getattr(values, item.name)
            lines.append(f"{item.name} = {_number(value)}")
    return "\n".join(lines) + "\n"


def _number(value: float | tuple[float, float]) -> str:
    return f"[{', '.join(map(_number, value))}]" if isinstance(value, tuple) else f"{value:.3f}"


def _part(name: str, content: dict[str, Any], key: str, kind: type[_Part]) -> _Part:
    section = content.get(key)
    names = [item.name for item in fields(kind)]
    if not isinstance(section, dict) or set(section) != set(names):
        raise UserError(f"{name}: [{key}] must have {', '.join(names)}; make it again with train prior")
    values = {}
    for item, value in section.items():
        if item in _BOUNDS:
            fits = _is_within(value, _BOUNDS[item])
        else:
            fits = isinstance(value, list) and len(value) == 2
            fits = fits and _is_within(value[0], _MEAN_BOUNDS) and _is_within(value[1], _DEVIATION_BOUNDS)
            value = tuple(map(float, value)) if fits else value
        if not fits:
            raise UserError(f"{name}: {key}.{item} = {value!r} is beyond what a vehicle can do; the prior is not used")
        values[item] = value
    return kind(**values)


def _is_within(value: Any, bounds: tuple[float, float]) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and bounds[0] <= value <= bounds[1]
