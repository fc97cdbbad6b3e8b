"""ROS parameter files for commands on recordings, in the same format as for the nodes.

Replay combines the three nodes, so it reads the sections of all of them: ``/**`` first, then ``attitude_node``,
``sins_node`` and ``anfis_node``, then ``pose_estimator``. Sections of other nodes are ignored.
"""

from collections.abc import Iterator, Mapping
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.ros import READ_BY_ROS
from nav_pose_estimator.engine.parameters.schema import ParameterError, update
from nav_pose_estimator.offline.flights import ros_yaml

SECTION = "ros__parameters"
SINGLE_NODES = ("attitude_node", "sins_node", "anfis_node")
COMPOSED_NODE = "pose_estimator"
_WILDCARD, _SINGLE, _COMPOSED = 1, 2, 3


def load_parameters(path: Path | str | None) -> Parameters:
    """Read the parameters of a YAML file over the defaults; the defaults for ``None``.

    Keys may be nested or dotted. A file without ``ros__parameters`` contains the parameter tree itself. Raises
    ``ParameterError``, one sentence that names file and key, for every error in the file.
    """
    if path is None:
        return Parameters()
    try:
        return update(Parameters(), _merge(_read(Path(path))))
    except ParameterError as error:
        raise ParameterError(f"{path}: {error}") from None


def _read(path: Path) -> Mapping[str, Any]:
    content = ros_yaml.read(path)
    if content is None:
        return {}
    if not isinstance(content, Mapping):
        raise ParameterError("holds no parameters, only a mapping of names to values can")
    return content


def _merge(content: Mapping[str, Any]) -> dict[str, Any]:
    """Values by dotted name of all relevant sections; specific sections override general ones."""
    sections = list(_sections(content))
    if not sections:
        _check_no_section(content)
        return dict(_flatten(content))
    ours = [(_rank(name), name, dict(_flatten(tree))) for name, tree in sections if _rank(name)]
    if not ours:
        raise ParameterError(f"has no section for {', '.join((*SINGLE_NODES, COMPOSED_NODE))} or /**")
    values: dict[str, Any] = {}
    of_single: dict[str, tuple[str, Any]] = {}
    for rank, name, tree in sorted(ours, key=lambda section: section[0]):
        values.update(tree)
        if rank == _SINGLE:
            _check_agreement(name, tree, of_single)
    return values


def _check_no_section(content: Mapping[str, Any]) -> None:
    """Raise ``ParameterError`` where a file without ``ros__parameters`` has the name of a node or a misspelled one."""
    for name, tree in content.items():
        misspelled = isinstance(tree, Mapping) and any(str(key).replace("_", "") == "rosparameters" for key in tree)
        if misspelled or str(name).startswith("/"):
            raise ParameterError(f"its section {str(name)!r} has no {SECTION!r} (with two underscores)")


def _check_agreement(name: str, tree: Mapping[str, Any], seen: dict[str, tuple[str, Any]]) -> None:
    """Raise ``ParameterError`` if two nodes set a parameter to different values, because replay is both of them."""
    for key, value in tree.items():
        other, their_value = seen.setdefault(key, (name, value))
        if their_value != value:
            raise ParameterError(f"{key} differs between {other} and {name}, and replay is both nodes in one")


def _sections(content: Mapping[str, Any], name: str = "") -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield (node name, its tree); a namespace may be part of the name or a level of its own."""
    for key, body in content.items():
        if key == SECTION:
            if body is not None and not isinstance(body, Mapping):
                raise ParameterError(f"{SECTION} of {name} is not a mapping of names to values")
            yield name, body or {}
        elif isinstance(body, Mapping):
            yield from _sections(body, str(key))


def _rank(name: str) -> int:
    """Specificity of a section, from 1; 0 for an irrelevant one."""
    own = name.rsplit("/", 1)[-1]  # without namespace
    if own == COMPOSED_NODE:
        return _COMPOSED
    if own in SINGLE_NODES:
        return _SINGLE
    concerns_us = "*" in own and any(fnmatchcase(node, own) for node in (*SINGLE_NODES, COMPOSED_NODE))
    return _WILDCARD if concerns_us else 0


def _flatten(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in tree.items():
        key = f"{prefix}{name}"
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{key}.")
        elif not key.startswith(READ_BY_ROS):
            yield key, value
