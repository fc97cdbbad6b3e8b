"""Parser of the YAML of ROS (``get_value`` of rcl_yaml_param_parser, Jazzy), which is neither YAML 1.1 nor 1.2.

``5e-4`` is a number (PyYAML: a string), ``y`` and ``on`` are true, ``1:30`` is a string (PyYAML: 90), ``010`` is eight.
The values of a list have one type. Aliases, with which a small file can expand to a huge one, are rejected as in rcl.
"""

import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from nav_pose_estimator.engine.parameters.schema import ParameterError

_LARGEST = 1 << 20  # bytes; the file with all parameters has 20 kB
_DEEPEST = 20  # levels of nesting; that file has 5
_TRUE = frozenset(("Y", "y", "yes", "Yes", "YES", "true", "True", "TRUE", "on", "On", "ON"))
_FALSE = frozenset(("N", "n", "no", "No", "NO", "false", "False", "FALSE", "off", "Off", "OFF"))
_OCTAL, _WHOLE = re.compile(r"[+-]?0[0-7]+"), re.compile(r"[+-]?(0[xX][0-9a-fA-F]+|[1-9][0-9]*|0)")
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_HEXADECIMAL = re.compile(r"[+-]?0[xX]([0-9a-fA-F]+\.?[0-9a-fA-F]*|\.[0-9a-fA-F]+)([pP][+-]?[0-9]+)?")
_SPECIAL = re.compile(r"[+-]?\.?(nan|inf|infinity)", re.IGNORECASE)


def read(path: Path) -> Any:
    """The content of a file: mappings, lists, texts, numbers, true and false; None where a value is missing.

    Raises ``ParameterError``, one sentence without the file's name.
    """
    if path.exists() and not path.is_file():  # a pipe would wait for ever
        raise ParameterError("cannot be read (it is not a file)")
    try:
        with path.open("rb") as file:
            data = file.read(_LARGEST + 1)
    except OSError as error:
        raise ParameterError(f"cannot be read ({error.strerror})") from None
    if len(data) > _LARGEST:
        raise ParameterError(f"is not a parameter file: it is larger than {_LARGEST >> 20} MiB")
    try:
        return parse(data.decode("utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ParameterError(f"is not valid YAML: {' '.join(str(error).split())}") from None


def parse(text: str) -> Any:
    """The first document of ``text``. Raises ``ParameterError`` or ``yaml.YAMLError``."""
    builder = _Builder()
    for event in yaml.parse(text, Loader=yaml.SafeLoader):
        if isinstance(event, yaml.DocumentEndEvent):
            break
        builder.take(event)
    return builder.root[0] if builder.root else None


def scalar(text: str) -> bool | int | float | str:
    """Value of an unquoted scalar."""
    if text in _TRUE or text in _FALSE:
        return text in _TRUE
    whole = int(text, 8) if _OCTAL.fullmatch(text) else int(text, 0) if _WHOLE.fullmatch(text) else None
    if whole is not None and -(2**63) <= whole < 2**63:
        return whole
    if _NUMBER.fullmatch(text):
        return text if math.isinf(float(text)) else float(text)  # out of range: rcl takes it for a text
    if _HEXADECIMAL.fullmatch(text):
        return float.fromhex(text)
    return float(text.replace(".", "")) if _SPECIAL.fullmatch(text) else text


@dataclass
class _Builder:
    """Builds values from the events of the parser, without recursion."""

    root: list[Any] = field(default_factory=list)
    _open: list[Any] = field(default_factory=list)  # containers, the innermost last
    _keys: list[Any] = field(default_factory=list)  # of each of them the key that waits for its value

    def take(self, event: yaml.Event) -> None:
        """Process one event."""
        line = 1 + (event.start_mark.line if event.start_mark else 0)
        if isinstance(event, yaml.AliasEvent):
            raise ParameterError(
                f"holds the alias *{event.anchor} in line {line}, which ROS does not read: write it out"
            )
        if isinstance(event, yaml.ScalarEvent):
            self._put(_value(event), line)
        elif isinstance(event, yaml.CollectionStartEvent):
            if len(self._open) == _DEEPEST:
                raise ParameterError(f"is nested deeper than {_DEEPEST} levels in line {line}")
            container: Any = {} if isinstance(event, yaml.MappingStartEvent) else []
            self._put(container, line)
            self._open.append(container)
            self._keys.append(None)
        elif isinstance(event, yaml.CollectionEndEvent):
            self._open.pop()
            self._keys.pop()

    def _put(self, value: Any, line: int) -> None:
        if not self._open:
            self.root.append(value)
        elif isinstance(self._open[-1], list):
            items = self._open[-1]
            if items and type(value) is not type(items[0]):
                raise ParameterError(
                    f"mixes {items[0]!r} and {value!r} in the list in line {line}, which ROS does not read:"
                    " write all of it with a point, or all without"
                )
            items.append(value)
        elif self._keys[-1] is None:
            if isinstance(value, (dict, list)):
                raise ParameterError(f"has a key that is not a name in line {line}")
            if str(value) in self._open[-1]:
                raise ParameterError(f"has {str(value)!r} a second time in line {line}")
            self._keys[-1] = str(value)
        else:
            self._open[-1][self._keys[-1]] = value
            self._keys[-1] = None


def _value(event: yaml.ScalarEvent) -> Any:
    if event.style in ("'", '"'):
        return event.value
    return scalar(event.value) if event.value else None
