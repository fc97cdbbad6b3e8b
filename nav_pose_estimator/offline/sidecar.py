"""NAME.json beside a recording: what is known of the flight besides its samples."""

import json
from pathlib import Path

from nav_pose_estimator.offline.bags.raw_messages import BagError


def flight_name(recording: Path) -> str:
    """NAME of NAME_bag, NAME.mcap, NAME.ulg, ..."""
    name = recording.name if recording.name.endswith("_bag") else recording.stem
    return name.removesuffix("_bag")


def sidecar_path(recording: Path) -> Path:
    """NAME.json beside a recording, or beside the one that it is a link to."""
    recording = recording.resolve()
    return recording.with_name(f"{flight_name(recording)}.json")


def sidecar(recording: Path) -> dict:
    """Content of ``sidecar_path``, empty if it does not exist; ``BagError`` for invalid content."""
    path = sidecar_path(recording)
    if not path.is_file():
        return {}
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise BagError(f"{path} is not valid JSON ({error})") from None
    if not isinstance(content, dict):
        return {}
    content = {name: value for name, value in content.items() if value is not None}
    bag = content.get("bag", {})
    values = [content.get("gnss_latency_est_s", 0.0), bag.get("stamp_offset_s", 0.0) if isinstance(bag, dict) else None]
    window = content.get("flight_window_s", [0.0, 0.0])
    values += window if isinstance(window, list) and len(window) == 2 else [None]
    if not all(isinstance(value, (int, float)) and abs(value) < 1e12 for value in values):  # false for NaN
        raise BagError(
            f"{path}: gnss_latency_est_s and bag.stamp_offset_s must be numbers, flight_window_s two of them"
        )
    return content
