"""What a command found, as JSON for scripts."""

import json
import math
import platform
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from nav_pose_estimator import __version__
from nav_pose_estimator.core.numerics.jit import COMPILED


def write_json(path: Path, content: dict[str, Any]) -> dict[str, Any]:
    """Write ``content`` and return what the file holds; NaN and infinity, which JSON does not know, become null."""
    content = _plain(content)
    path.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return content


def versions() -> dict[str, str]:
    """Versions of what took part."""
    kernels = "compiled" if COMPILED else "plain Python"
    found = {"nav_pose_estimator": __version__, "python": platform.python_version(), "kernels": kernels}
    for name in ("numpy", "numba", "rosbags"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def _plain(value: Any) -> Any:
    """``value`` in the types of JSON."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, str) or value is None or isinstance(value, bool):
        return value
    if isinstance(value, Iterable):
        return [_plain(item) for item in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return int(value)
