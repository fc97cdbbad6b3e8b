"""Schema of the parameters: frozen dataclasses in which each default, unit, range and description is written once.

ROS parameter descriptors, YAML files, the table in the documentation and the checks are derived from them.
"""

import difflib
import reprlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import Field, dataclass, field, fields, is_dataclass, replace
from typing import Any, TypeVar

from nav_pose_estimator.errors import UserError

_Settings = TypeVar("_Settings")
_brief = reprlib.Repr()
_brief.maxstring = _brief.maxother = 80
_shown = _brief.repr  # a value in a message, shortened if long


class ParameterError(UserError):
    """A parameter that does not exist, has the wrong type or is out of range. The text is for the user."""


@dataclass(frozen=True)
class Spec:
    """Specification of one parameter: ``key`` is its dotted name, ``mutable`` whether it can change in flight."""

    key: str
    default: Any
    unit: str
    description: str
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    mutable: bool = False


def param(
    default: Any,
    unit: str,
    description: str | Callable[[], str],
    minimum: float | None = None,
    maximum: float | None = None,
    choices: tuple[str, ...] | Callable[[], tuple[str, ...]] = (),
    mutable: bool = False,
) -> Any:
    """Declare a field. ``default`` bool, int, float, str or a tuple of floats; unit "" for a pure number.

    ``description`` and ``choices`` may be functions, called whenever they are needed, for those that come from a
    registry.
    """
    meta = {
        "unit": unit,
        "description": description,
        "minimum": minimum,
        "maximum": maximum,
        "choices": choices,
        "mutable": mutable,
    }
    return field(default=default, metadata=meta)


def specs(group: Any, prefix: str = "") -> Iterator[Spec]:
    """All parameters below ``group`` (a parameter dataclass or an instance of one), depth first."""
    instance = group() if isinstance(group, type) else group
    for item in fields(instance):
        value = getattr(instance, item.name)
        key = f"{prefix}{item.name}"
        if is_dataclass(value):
            yield from specs(value, f"{key}.")
        else:
            yield spec_of(item, key, value)


def spec_of(item: Field, key: str, value: Any) -> Spec:
    """The specification that ``param`` declared for a field, with the name ``key`` and the default ``value``."""
    return Spec(key, value, **{name: fact() if callable(fact) else fact for name, fact in item.metadata.items()})


def flatten(group: Any) -> dict[str, Any]:
    """Dotted name -> value."""
    return {spec.key: spec.default for spec in specs(group)}


def check(spec: Spec, value: Any) -> Any:
    """``value`` converted to the type of the parameter's default; ``ParameterError`` where it is invalid."""
    default = spec.default
    if isinstance(default, tuple):
        return _check_tuple(spec, value)
    if isinstance(default, bool) or isinstance(value, bool):
        if not (isinstance(value, bool) and isinstance(default, bool)):
            raise ParameterError(f"{spec.key}: {_shown(value)} is not {_kind(default)}")
        return value
    if isinstance(default, float) and isinstance(value, int):
        value = float(value)
    if type(value) is not type(default):
        raise ParameterError(f"{spec.key}: {_shown(value)} is not {_kind(default)}")
    if spec.choices and value not in spec.choices:
        raise ParameterError(f"{spec.key}: {_shown(value)} is not one of {', '.join(spec.choices)}")
    if isinstance(value, (int, float)):
        _check_range(spec, value)
    return value


def update(group: Any, values: Mapping[str, Any]) -> Any:
    """A copy of ``group`` with the dotted ``values`` set; ``ParameterError`` for an unknown name or a bad value."""
    known = {spec.key: spec for spec in specs(group)}
    for key, value in values.items():
        if key not in known:
            close = difflib.get_close_matches(key, known, n=1)
            hint = f"; did you mean {close[0]!r}?" if close else ""
            raise ParameterError(f"there is no parameter {_shown(key)}{hint}")
        group = _set(group, key.split("."), check(known[key], value))
    return group


def _set(group: Any, path: list[str], value: Any) -> Any:
    if len(path) == 1:
        return replace(group, **{path[0]: value})
    return replace(group, **{path[0]: _set(getattr(group, path[0]), path[1:], value)})


def _check_range(spec: Spec, value: float) -> None:
    if value != value:
        raise ParameterError(f"{spec.key}: NaN is not a value")
    if spec.minimum is not None and value < spec.minimum:
        raise ParameterError(f"{spec.key}: {value:g} is below the minimum {spec.minimum:g} {spec.unit}".rstrip())
    if spec.maximum is not None and value > spec.maximum:
        raise ParameterError(f"{spec.key}: {value:g} is above the maximum {spec.maximum:g} {spec.unit}".rstrip())


def _check_tuple(spec: Spec, value: Any) -> tuple[float, ...]:
    is_list = isinstance(value, (tuple, list))
    if not is_list or any(isinstance(item, bool) or not isinstance(item, (int, float)) for item in value):
        raise ParameterError(f"{spec.key}: {_shown(value)} is not a list of numbers")
    items = tuple(map(float, value))
    if len(items) != len(spec.default):
        raise ParameterError(f"{spec.key}: needs {len(spec.default)} numbers, not {len(items)}")
    for item in items:
        _check_range(spec, item)
    return items


def _kind(default: Any) -> str:
    return {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}[type(default)]


def settings(kind: type[_Settings], group: Any) -> _Settings:
    """An instance of the core's settings class ``kind`` from the fields of ``group`` that have the same names."""
    return kind(**{item.name: getattr(group, item.name) for item in fields(kind)})  # type: ignore[arg-type]
