"""Message classes of packages that may be missing: which ones a node needs, its parameters decide."""

import importlib
from typing import Any

from nav_pose_estimator.engine.parameters.schema import ParameterError


def message_class(name: str, wanted: str, instead: str = "") -> Any:
    """The rclpy class of package/msg/Name. ``ParameterError`` where the package is not installed.

    ``wanted`` begins its sentence and says what asks for the message, ``instead`` ends it with what else could be done.
    """
    package, _, kind = name.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), kind)
    except (ImportError, AttributeError):
        cure = f"install ros-jazzy-{package.replace('_', '-')}" + (f" or {instead}" if instead else "")
        raise ParameterError(f"{wanted}, but {package} is not installed here; {cure}") from None
