"""A single file that a command is asked to write."""

from pathlib import Path

from nav_pose_estimator.errors import UserError
from nav_pose_estimator.whole_file import replacing


def check_new(path: Path, force: bool) -> None:
    """``UserError`` where ``path`` cannot be written, or exists and ``force`` does not allow to replace it."""
    if path.is_dir():
        raise UserError(f"--out {path} is a folder; choose another name")
    if path.exists() and not force:
        raise UserError(f"{path} exists already; choose another name or give --force")
    if not path.parent.is_dir():
        raise UserError(f"{path.parent} is no folder to write {path.name} into")


def write_whole(path: Path, text: str) -> None:
    """Write ``text`` atomically. ``UserError`` where that fails, with an earlier file unchanged."""
    try:
        with replacing(path) as unfinished:
            unfinished.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UserError(f"{path} cannot be written: {error.strerror}; nothing was changed") from None
