"""Snapshots: independent copies of a component's state, by one rule for all components.

A component holds parameters, values derived from them, and state. Parameters are frozen dataclasses and are shared
between copies. The state is a dataclass, and each of its fields is copied, new ones without further code. A type that
the rule does not cover raises an error instead of being shared silently.

A class with methods and its own constructor can be a state as ``@dataclass(init=False, eq=False, slots=True)``: with
slots, an attribute that is not declared as a field cannot be set, so none is forgotten.
"""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Callable
from enum import Enum
from types import FunctionType, NoneType
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")

SHARED = {"shared": True}
"""Metadata of a dataclass field that all copies share: ``field(metadata=SHARED)``."""

_ATOMS = (bool, int, float, complex, str, bytes, NoneType, range, frozenset, np.generic, Enum, type, FunctionType)


def snapshot(state: T) -> T:
    """An independent copy of ``state``.

    Copied with their content: dataclasses (without a call of ``__init__``), lists, tuples, sets, dictionaries, deques
    and numpy arrays. Shared: numbers, strings, enumerations, functions, frozen dataclasses, read-only arrays, and
    fields marked ``SHARED``. An object that occurs twice in the state occurs twice in the copy as one object. A state
    must not keep a view of one of its own arrays: the copy of a view is an array of its own.

    Raises TypeError with the name of the type for anything else.
    """
    copied: T = _copy(state, {})
    return copied


def _copy(value: Any, known: dict[int, Any]) -> Any:
    kind = type(value)
    if kind is float or kind is int or isinstance(value, _ATOMS):
        return value
    if id(value) in known:
        return known[id(value)]
    if dataclasses.is_dataclass(kind):
        return _copy_dataclass(value, known)
    copier = _COPIERS.get(kind)
    if copier is None:
        raise TypeError(f"a state must not hold a {kind.__module__}.{kind.__qualname__}: snapshot cannot copy it")
    twin = known[id(value)] = copier(value, known)
    return twin


def _copy_dataclass(value: Any, known: dict[int, Any]) -> Any:
    if value.__dataclass_params__.frozen:
        return value
    twin = known[id(value)] = object.__new__(type(value))
    for field in dataclasses.fields(value):
        content = getattr(value, field.name)
        object.__setattr__(twin, field.name, content if "shared" in field.metadata else _copy(content, known))
    return twin


def _copy_array(array: np.ndarray, known: dict[int, Any]) -> np.ndarray:
    if array.dtype.hasobject:
        raise TypeError("a state must not hold an array of objects: snapshot cannot copy them")
    return array.copy() if array.flags.writeable else array


_COPIERS: dict[type, Callable[[Any, dict[int, Any]], Any]] = {
    np.ndarray: _copy_array,
    list: lambda value, known: [_copy(item, known) for item in value],
    tuple: lambda value, known: tuple(_copy(item, known) for item in value),
    set: lambda value, known: set(value),
    dict: lambda value, known: {key: _copy(item, known) for key, item in value.items()},
    deque: lambda value, known: deque((_copy(item, known) for item in value), value.maxlen),
}
