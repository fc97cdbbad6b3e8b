"""The parameter tree as ROS parameters, declared with range, unit and meaning, and checked by the tree's own rules.

A parameter file with an unknown name, a wrong type or a value out of range stops the node before it starts
(``ParameterError``, one sentence). In a running node only the parameters marked as mutable can be set.
"""

import re
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import yaml
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.ros import READ_BY_ROS
from nav_pose_estimator.engine.parameters.schema import ParameterError, Spec, flatten, specs, update


def declare(node: Node, defaults: Any = None) -> Any:
    """Declare a whole tree (the estimators' by default); return it with the overrides of files and command line.

    One file can serve all executables (its key is ``/**``): other trees ignore the estimators' parameters in it.
    """
    ours = Parameters() if defaults is None else defaults
    foreign = flatten(Parameters()).keys() - flatten(ours).keys()
    parameters = update(ours, {name: value for name, value in overrides(node).items() if name not in foreign})
    declarations: list[Any] = [(spec.key, _ros_value(spec.default), descriptor(spec)) for spec in specs(parameters)]
    node.declare_parameters("", declarations, ignore_override=True)
    return parameters


def overrides(node: Node) -> dict[str, Any]:
    """Values that files and command line set for ``node``, by name, without those that rclpy itself reads."""
    given = node._parameter_overrides  # rclpy has no public access to overrides of undeclared names
    return {name: _tree_value(item.value) for name, item in given.items() if not name.startswith(READ_BY_ROS)}


def unaddressed(arguments: Sequence[str], node: str) -> list[str]:
    """Sentences on parameter files in ``arguments`` with no section for ``node`` (``/namespace/name``).

    ROS ignores such a file without a word, and the node runs with defaults.
    """
    notes = []
    for option, path in pairwise(arguments):
        if option == "--params-file":
            sections = list(_sections(_content(path)))
            if sections and not any(_fits(section, node) for section in sections):
                notes.append(f"{path} sets nothing for {node}: it is for {', '.join(sections)}")
    return notes


def _content(path: str) -> Any:
    """Content of a parameter file; None where this parser is stricter than that of ROS, which has read it before."""
    try:
        return yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (yaml.YAMLError, OSError, ValueError):
        return None


def _sections(content: Any, above: str = "") -> Iterator[str]:
    """Names of the nodes, with wildcards, for which a parameter file has values."""
    for name, value in content.items() if isinstance(content, dict) else ():
        if name == "ros__parameters":
            yield above
        else:
            yield from _sections(value, f"{above}/{str(name).strip('/')}")


def _fits(section: str, node: str) -> bool:
    """Whether ``section`` addresses ``node``: ``*`` stands for one name, ``**`` for any number of them."""
    tokens = {"**": "(/[^/]+)*", "*": "/[^/]+"}
    pattern = "".join(tokens.get(token, "/" + re.escape(token)) for token in section.strip("/").split("/"))
    return re.fullmatch(pattern, node) is not None


def descriptor(spec: Spec) -> ParameterDescriptor:
    """Descriptor of one parameter for ``ros2 param describe``: range, unit and meaning."""
    unit = f" [{spec.unit}]" if spec.unit else ""
    result = ParameterDescriptor(description=spec.description + unit, read_only=not spec.mutable)
    if spec.choices:
        result.additional_constraints = f"one of {', '.join(spec.choices)}"
    if spec.minimum is None and spec.maximum is None:
        return result
    if isinstance(spec.default, float):
        low = -sys.float_info.max if spec.minimum is None else float(spec.minimum)
        high = sys.float_info.max if spec.maximum is None else float(spec.maximum)
        result.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
    elif isinstance(spec.default, int):
        low = -(2**63) if spec.minimum is None else int(spec.minimum)
        high = 2**63 - 1 if spec.maximum is None else int(spec.maximum)
        result.integer_range = [IntegerRange(from_value=low, to_value=high, step=1)]
    else:
        result.additional_constraints = f"each from {spec.minimum:g} to {spec.maximum:g}"
    return result


class LiveParameters:
    """Keeps ``current`` up to date while the node runs; ``apply`` receives every accepted tree."""

    def __init__(self, node: Node, current: Parameters, apply: Callable[[Parameters], None]) -> None:
        self.current = current
        self._apply = apply
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._set)

    def _check(self, changes: list[Parameter]) -> SetParametersResult:
        try:
            update(self.current, self._ours(changes))
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _set(self, changes: list[Parameter]) -> None:
        ours = self._ours(changes)
        if ours:
            self.current = update(self.current, ours)
            self._apply(self.current)

    def _ours(self, changes: Iterable[Parameter]) -> dict[str, Any]:
        return {item.name: _tree_value(item.value) for item in changes if not item.name.startswith(READ_BY_ROS)}


def _ros_value(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def _tree_value(value: Any) -> Any:
    """A ROS value as the tree has it: arrays, which rclpy gives as array.array or list, become tuples."""
    return value if isinstance(value, (bool, int, float, str, type(None))) else tuple(value)
