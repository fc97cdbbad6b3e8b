"""Parameters for work on recordings: a YAML file as the nodes take it, and the options of the command line."""

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import yaml

from nav_pose_estimator.engine.parameter_schema import ParameterError, update
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.aids import AidParameters

ROS_KEY = "ros__parameters"
NODES = ("/**", "sins_node", "pose_estimator", "anfis_node", "attitude_node")
"""Sections of a ROS parameter file, the more general first: later ones override."""
_OF_ROS = ("use_sim_time", "qos_overrides")


def load_parameters(path: Path | None) -> Parameters:
    """The parameters of a YAML file over the defaults. Raises ``ParameterError`` with one sentence."""
    if path is None:
        return Parameters()
    try:
        content = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ParameterError(f"{path} cannot be read ({error.strerror})") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ParameterError(f"{path} is not valid YAML: {' '.join(str(error).split())}") from None
    if content is None:
        return Parameters()
    if not isinstance(content, Mapping):
        raise ParameterError(f"{path} holds no parameters: it must be a mapping of names to values")
    values: dict[str, Any] = {}
    for tree in _trees(content):
        values.update(_flatten(tree))
    values = {key: value for key, value in values.items() if not key.startswith(_OF_ROS)}
    try:
        return update(Parameters(), values)
    except ParameterError as error:
        raise ParameterError(f"{path}: {error}") from None


def _trees(content: Mapping) -> list[Mapping]:
    """The parameter trees of a ROS file in the order in which they apply, or the plain tree itself."""
    sections = {str(name).lstrip("/") or "/**": body for name, body in content.items() if _is_section(body)}
    if not sections:
        return [content]
    order = [name for name in (node.lstrip("/") for node in NODES) if name in sections]
    return [sections[name][ROS_KEY] or {} for name in order]


def _is_section(body: Any) -> bool:
    return isinstance(body, Mapping) and ROS_KEY in body


def _flatten(tree: Mapping, prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in tree.items():
        if isinstance(value, Mapping):
            flat.update(_flatten(value, f"{prefix}{name}."))
        else:
            flat[f"{prefix}{name}"] = value
    return flat


def aid_names() -> list[str]:
    """Aids that can be switched: the true-or-false parameters of ``aids``."""
    return [item.name for item in fields(AidParameters) if isinstance(item.default, bool)]


def with_aids(parameters: Parameters, text: str) -> Parameters:
    """``parameters`` with exactly the aids of a comma-separated list switched on; ``none`` for GNSS and IMU alone."""
    chosen = [name.strip() for name in text.split(",") if name.strip()]
    known = aid_names()
    unknown = [name for name in chosen if name not in known and name != "none"]
    if unknown or not chosen:
        what = f"there is no aid {unknown[0]!r}" if unknown else "it names no aid"
        raise ParameterError(f"--aid {text}: {what}; choose from {', '.join(known)} or none")
    return update(parameters, {f"aids.{name}": name in chosen for name in known})
