"""Search for the recordings that command-line arguments stand for: bags, flight logs, folders, patterns and lists."""

import glob
from collections.abc import Collection, Iterator, Sequence
from itertools import chain
from pathlib import Path

from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.remote import is_remote, matches

_ENDINGS = frozenset((".mcap", ".db3", ".ulg", ".ulog", ".bin", ".log"))
_LIST = ".txt"
_METADATA = "metadata.yaml"  # a folder with one is a rosbag2


def find(names: Sequence[Path | str], also: Collection[str] = ()) -> list[Path]:
    """Recordings that ``names`` stand for, each once, in the order of the names and sorted within each.

    A name is a recording, a folder (searched recursively), a pattern (``flights/**/*.ulg``), or a text file with such
    names, one per line. In an object store (``offline.remote``) it is a recording or a pattern. ``also``: further file
    endings to find. Raises ``UserError`` for a folder, pattern or list without recordings. Whether a recording is
    readable is not checked.
    """
    found: dict[Path, None] = {}
    for name in names:
        found.update(dict.fromkeys(_meant_by(Path(name), _ENDINGS.union(also))))
    return list(found)


def _meant_by(name: Path, endings: Collection[str], lists: tuple[Path, ...] = ()) -> list[Path]:
    """Recordings that one name stands for; ``lists`` are the lists that it was found in."""
    if is_remote(name):
        return _some(name, matches(name)) if glob.has_magic(str(name)) else [name]
    if _is_folder(name):
        return _some(name, sorted(_inside(name, endings)))
    if name.exists():
        return _listed(name, endings, lists) if name.suffix == _LIST else [name]
    if glob.has_magic(str(name)):
        paths = sorted(Path(match) for match in glob.glob(str(name), recursive=True))
        chosen = [_inside(match, endings) if _is_folder(match) else _known(match, endings) for match in paths]
        return _some(name, list(chain.from_iterable(chosen)))
    return [name]


def _is_folder(path: Path) -> bool:
    return path.is_dir() and not (path / _METADATA).exists() and not any(_files_of_a_bag(path))


def _files_of_a_bag(folder: Path) -> Iterator[Path]:
    """Storage files of a bag without metadata.yaml, which begin with the name of the folder."""
    return (path for path in folder.glob(f"{glob.escape(folder.name)}_*") if path.suffix in (".mcap", ".db3"))


def _inside(folder: Path, endings: Collection[str]) -> Iterator[Path]:
    """All recordings in a folder; a bag folder is one recording."""
    for path in sorted(folder.iterdir()):
        if path.name.startswith("."):
            continue
        if path.is_dir():
            yield from _inside(path, endings) if _is_folder(path) else [path]
        else:
            yield from _known(path, endings)


def _known(path: Path, endings: Collection[str]) -> list[Path]:
    return [path] if path.is_dir() or path.suffix.lower() in endings else []


def _listed(path: Path, endings: Collection[str], lists: tuple[Path, ...]) -> list[Path]:
    """Recordings that a text file lists, relative to its folder; empty lines and lines with # are ignored."""
    if path.resolve() in lists:
        raise UserError(f"{path} is a list that lists itself")
    lists = (*lists, path.resolve())
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except UnicodeDecodeError:
        raise UserError(f"{path} is not a list of recordings: it is not a text file") from None
    names = [line.strip() for line in lines if line.strip() and not line.strip().startswith("#")]
    return _some(path, [one for name in map(Path, names) for one in _meant_by(_beside(path, name), endings, lists)])


def _beside(path: Path, name: Path) -> Path:
    return name if is_remote(name) else path.parent / name


def _some(name: Path, found: list[Path]) -> list[Path]:
    if not found:
        raise UserError(f"{name} holds no recording: bags, .mcap, .db3, .ulg, .bin or .log are expected")
    return found
