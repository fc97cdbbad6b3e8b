"""Import of message classes whose packages are optional: the parameters decide which ones a node needs."""

import importlib
from typing import Any

from nav_pose_estimator.engine.parameters.schema import ParameterError


def message_class(name: str, wanted: str, instead: str = "") -> Any:
    """The rclpy class of package/msg/Name; ``ParameterError`` where the package is not installed.

    ``wanted`` is the first clause of its sentence, about what needs the message; ``instead`` an alternative remedy.
    """
    package, _, kind = name.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), kind)
    except (ImportError, AttributeError):
        cure = f"install ros-jazzy-{package.replace('_', '-')}" + (f" or {instead}" if instead else "")
        raise ParameterError(f"{wanted}, but {package} is not installed here; {cure}") from None
