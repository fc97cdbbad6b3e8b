"""Recordings in object stores (``s3://bucket/flight_bag`` and other URLs of fsspec), which are copied before reading.

fsspec and the package of the store (s3fs, gcsfs, ...) are optional dependencies for this module only.
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any

from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.sidecar import flight_name

_URL = re.compile(r"([a-z][a-z0-9+.-]+):/+(?=[^/])")  # a ``Path`` keeps only one of the slashes; C:/ is a drive


def is_remote(path: Path) -> bool:
    """Whether ``path`` is the URL of an object store."""
    return _URL.match(str(path)) is not None and not path.exists()


def matches(pattern: Path) -> list[Path]:
    """The sorted URLs that match ``pattern`` with * and ?; ``UserError`` if the store cannot be read."""
    with _store(pattern) as (store, place):
        return sorted(Path(store.unstrip_protocol(found)) for found in store.glob(place))


@contextmanager
def at_hand(path: Path) -> Iterator[Path]:
    """Context with ``path``, or with a temporary copy of a remote recording and the NAME.json beside it.

    Raises ``UserError`` if it cannot be copied.
    """
    if not is_remote(path):
        yield path
        return
    with TemporaryDirectory(prefix="nav_pose_estimator_") as folder:
        _copy(path, Path(folder, path.name))
        yield Path(folder, path.name)


def _copy(path: Path, here: Path) -> None:
    with _store(path) as (store, place):
        if store.isdir(place):
            here.mkdir()
            for entry in store.ls(place, detail=True):
                if entry["type"] == "file":
                    store.get_file(entry["name"], str(here / PurePosixPath(entry["name"]).name))
        else:
            store.get_file(place, str(here))
        beside = f"{flight_name(here)}.json"
        if store.exists(known := f"{place.rstrip('/').rpartition('/')[0]}/{beside}"):
            store.get_file(known, str(here.with_name(beside)))


@contextmanager
def _store(path: Path) -> Iterator[tuple[Any, str]]:
    """Context with the store of a URL and the path in it; any exception in it becomes a ``UserError``."""
    url = _URL.sub(r"\1://", str(path))
    try:
        from fsspec.core import url_to_fs
    except ImportError:
        raise UserError(
            f"{url} is in an object store: reading from there needs the Python package fsspec (pip install fsspec)"
        ) from None
    try:
        yield url_to_fs(url)
    except FileNotFoundError:
        raise UserError(f"{url} does not exist") from None
    except UserError:
        raise
    except Exception as error:  # the packages of the stores raise various types
        raise UserError(f"{url} cannot be fetched ({error})") from error
