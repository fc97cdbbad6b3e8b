"""A faster ``copy.deepcopy``: a navigator consists of thousands of small objects and is copied several times a minute.

Most of its content is immutable: numbers, and tuples and frozen dataclasses of them. Such values are recognised at once
and shared. Anything that is neither a container nor a plain object is left to ``copy.deepcopy``.

CPython 3.12 keeps the attributes of an object in the object itself. As soon as its ``__dict__`` is asked for, as any
copy does, they move to a dictionary that shares its keys with those of the class, from which each access takes more
than twice as long, for the rest of the object's life. So here the objects and their copies get dictionaries of their
own (``own_dictionary``), which are as fast as none.
"""

from __future__ import annotations

import copy
import dataclasses
from collections import deque
from collections.abc import Callable, Collection
from itertools import chain
from operator import is_
from types import BuiltinFunctionType, FunctionType, MethodType, NoneType
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")
_Memo = dict[int, Any]
_Copier = Callable[[Any, _Memo], Any]

_ATOMS = frozenset((NoneType, bool, int, float, complex, str, bytes, type, range, FunctionType, BuiltinFunctionType))
_ATOMS_AND_TUPLES = _ATOMS | {tuple}
_HEAP_TYPE = 1 << 9  # Py_TPFLAGS_HEAPTYPE: flag of classes that are not built into Python
_ABSENT = object()  # in place of a slot that has never been set
# Special methods by which a class customises its own copying.
_OWN_WAYS = ("__getstate__", "__setstate__", "__getnewargs__", "__getnewargs_ex__", "__reduce__", "__reduce_ex__")


def deep_copy(value: T, memo: dict[int, Any]) -> T:
    """Same as ``copy.deepcopy(value, memo)``, except that immutable values may be shared with the copy."""
    kind = type(value)
    if kind in _ATOMS:
        return value
    known = memo.get(id(value), memo)
    if known is not memo:
        return known  # type: ignore[no-any-return]
    copier = _COPIERS.get(kind)
    if copier is None:
        copier = _COPIERS[kind] = _copier_of(kind)
    return copier(value, memo)  # type: ignore[no-any-return]


def own_dictionary(value: object) -> dict[str, Any]:
    """The attributes of ``value``, which from now on has them in a dictionary that shares its keys with no other."""
    content = dict(value.__dict__)
    object.__setattr__(value, "__dict__", content)
    return content


def shallow_copy(value: T) -> T:
    """Same as ``copy.copy`` of an object without slots and special methods."""
    twin = object.__new__(type(value))
    object.__setattr__(twin, "__dict__", own_dictionary(value).copy())
    return twin


def _copy_tuple(value: tuple, memo: _Memo) -> tuple:
    if _never_change(value):
        return value
    items = [deep_copy(item, memo) for item in value]
    if all(map(is_, items, value)):
        return value
    twin = memo[id(value)] = tuple.__new__(type(value), items)
    return twin


def _never_change(items: Collection) -> bool:
    """Whether all items are immutable atoms or tuples of them; fast for the long lists of a history."""
    if _ATOMS.issuperset(map(type, items)):
        return True
    if not _ATOMS_AND_TUPLES.issuperset(map(type, items)):
        return False
    return _never_change(list(chain.from_iterable([item for item in items if type(item) is tuple])))


def _copy_list(value: list, memo: _Memo) -> list:
    if _never_change(value):
        twin = memo[id(value)] = value.copy()
        return twin
    twin = []
    memo[id(value)] = twin
    twin += [item if type(item) in _ATOMS else deep_copy(item, memo) for item in value]
    return twin


def _copy_deque(value: deque, memo: _Memo) -> deque:
    if _never_change(value):
        twin = memo[id(value)] = value.copy()
        return twin
    twin = deque(maxlen=value.maxlen)
    memo[id(value)] = twin
    twin.extend([item if type(item) in _ATOMS else deep_copy(item, memo) for item in value])
    return twin


def _copy_dict(value: dict, memo: _Memo) -> dict:
    twin: dict = {}
    memo[id(value)] = twin
    for key, item in value.items():
        own = key if type(key) in _ATOMS else deep_copy(key, memo)
        twin[own] = item if type(item) in _ATOMS else deep_copy(item, memo)
    return twin


def _copy_array(value: np.ndarray, memo: _Memo) -> np.ndarray:
    twin: np.ndarray = copy.deepcopy(value, memo) if value.dtype.hasobject else value.copy("K")
    memo[id(value)] = twin
    return twin


def _copy_method(value: MethodType, memo: _Memo) -> MethodType:
    twin = memo[id(value)] = MethodType(value.__func__, deep_copy(value.__self__, memo))
    return twin


def _copy_by_own_method(value: Any, memo: _Memo) -> Any:
    twin = memo[id(value)] = value.__deepcopy__(memo)
    return twin


def _copy_by_reduction(value: Any, memo: _Memo) -> Any:
    twin = copy.deepcopy(value, memo)
    if type(value).__dictoffset__:
        own_dictionary(value)
        own_dictionary(twin)
    return twin


def _copier_of(kind: type) -> _Copier:
    """The function that copies instances of ``kind``, chosen at its first instance."""
    if hasattr(kind, "__deepcopy__"):
        return _copy_by_own_method
    if issubclass(kind, tuple) and hasattr(kind, "_fields"):
        return _copy_tuple
    ancestors = kind.__mro__[:-1]
    is_plain = all(one.__flags__ & _HEAP_TYPE for one in ancestors)
    slots = [name for one in ancestors for name in _slots_of(one) if name not in ("__dict__", "__weakref__")]
    is_default = not any(getattr(kind, name, None) is not getattr(object, name, None) for name in _OWN_WAYS)
    dataclass_slots = slots and dataclasses.is_dataclass(kind)
    if not is_plain or not (is_default or dataclass_slots) or any(name.startswith("__") for name in slots):
        return _copy_by_reduction
    has_dictionary = kind.__dictoffset__ != 0
    if dataclasses.is_dataclass(kind) and kind.__dataclass_params__.frozen:  # type: ignore[attr-defined]
        return _copier_of_frozen(kind, slots, has_dictionary)
    return _copier_of_objects(kind, slots, has_dictionary) if slots else _copy_plain


def _slots_of(kind: type) -> tuple[str, ...]:
    slots = kind.__dict__.get("__slots__", ())
    return (slots,) if isinstance(slots, str) else tuple(slots)


def _content(value: Any, slots: list[str], has_dictionary: bool) -> dict[str, Any]:
    content = own_dictionary(value).copy() if has_dictionary else {}
    for name in slots:
        item = getattr(value, name, _ABSENT)
        if item is not _ABSENT:
            content[name] = item
    return content


def _copy_plain(value: Any, memo: _Memo) -> Any:
    """An object that has all it holds in its dictionary, and no way of its own to set it."""
    twin = memo[id(value)] = shallow_copy(value)
    content = twin.__dict__
    for name, item in content.items():
        if type(item) not in _ATOMS:
            content[name] = deep_copy(item, memo)
    return twin


def _copier_of_objects(kind: type, slots: list[str], has_dictionary: bool) -> _Copier:
    def copy_object(value: Any, memo: _Memo) -> Any:
        twin: Any = object.__new__(kind)
        memo[id(value)] = twin
        for name, item in _content(value, slots, has_dictionary).items():
            object.__setattr__(twin, name, item if type(item) in _ATOMS else deep_copy(item, memo))
        return twin

    return copy_object


def _copier_of_frozen(kind: type, slots: list[str], has_dictionary: bool) -> _Copier:
    """Copier of a frozen dataclass: it is shared where all its content is. Its content must not refer back to it."""

    def copy_frozen(value: Any, memo: _Memo) -> Any:
        content = _content(value, slots, has_dictionary)
        items = [deep_copy(item, memo) for item in content.values()]
        if all(map(is_, items, content.values())):
            memo[id(value)] = value
            return value
        twin: Any = object.__new__(kind)
        memo[id(value)] = twin
        for name, item in zip(content, items, strict=True):
            object.__setattr__(twin, name, item)
        return twin

    return copy_frozen


_COPIERS: dict[type, _Copier] = {
    tuple: _copy_tuple,
    list: _copy_list,
    dict: _copy_dict,
    deque: _copy_deque,
    np.ndarray: _copy_array,
    MethodType: _copy_method,
}
