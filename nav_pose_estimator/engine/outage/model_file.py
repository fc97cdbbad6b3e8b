"""Trained models on disk: one file with a version and a checksum, written so that a kill never loses the last good one.

line 1    nav_pose_estimator model VERSION
line 2    SHA-256 of the rest, hexadecimal
rest      the arrays, in numpy's npz format (no pickled objects)
"""

import hashlib
import io
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from nav_pose_estimator.core.learning.anfis import Anfis
from nav_pose_estimator.errors import UserError

VERSION = 1
_MAGIC = b"nav_pose_estimator model "
_LARGEST = 256 * 2**20  # bytes: no model is larger, and a wrong file shall not fill the memory


def save_arrays(path: str | Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write ``arrays`` to ``path``: all of them or, whatever happens, the file that was there before.

    The bytes go to a temporary file beside it, reach the disk, and take the name in one step. ``UserError`` when that
    is impossible.
    """
    path = Path(path)
    buffer = io.BytesIO()
    named: dict[str, Any] = {name: np.asarray(value) for name, value in arrays.items()}
    np.savez(buffer, **named)  # without allow_pickle=False, which NumPy 1 would save as one more array
    body = buffer.getvalue()
    header = _MAGIC + f"{VERSION}\n{hashlib.sha256(body).hexdigest()}\n".encode()
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with temporary.open("wb") as file:
            file.write(header + body)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
        _sync_directory(path.parent)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise UserError(f"cannot write the model {path}: {error.strerror}") from None


def load_arrays(path: str | Path) -> dict[str, np.ndarray]:
    """The arrays that ``save_arrays`` wrote, bit for bit. ``UserError`` for a damaged, foreign or newer file."""
    path = Path(path)
    try:
        if path.stat().st_size > _LARGEST:
            raise UserError(f"{path} is not a model of nav_pose_estimator: it is too large")
        content = path.read_bytes()
    except OSError as error:
        raise UserError(f"cannot read the model {path}: {error.strerror}") from None
    first, _, rest = content.partition(b"\n")
    version = first.removeprefix(_MAGIC)
    if not first.startswith(_MAGIC) or not version.isdigit():
        raise UserError(f"{path} is not a model of nav_pose_estimator")
    if int(version) > VERSION:
        raise UserError(f"{path} has model version {int(version)}, this program reads up to {VERSION}: update it")
    checksum, _, body = rest.partition(b"\n")
    if checksum.decode("ascii", "replace") != hashlib.sha256(body).hexdigest():
        raise UserError(f"{path} is damaged: its checksum does not match")
    try:
        with np.load(io.BytesIO(body), allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (ValueError, OSError, zipfile.BadZipFile) as error:
        raise UserError(f"{path} is damaged: {error}") from None


def save_model(path: str | Path, model: Anfis) -> None:
    """Write a trained network to ``path``, see ``save_arrays``."""
    save_arrays(path, model.state())


def load_model(path: str | Path) -> Anfis:
    """The network that ``save_model`` wrote: its predictions are the same, bit for bit."""
    arrays = load_arrays(path)
    try:
        return Anfis.from_state(arrays)
    except UserError as error:
        raise UserError(f"{path}: {error}") from None


def _sync_directory(directory: Path) -> None:
    """Make the new name itself durable; where a directory cannot be opened (not POSIX) the system does without."""
    try:
        descriptor = os.open(directory, os.O_RDONLY)
    except OSError:
        return
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
