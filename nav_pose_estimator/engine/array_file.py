"""Files of named arrays: with version and checksum, written atomically.

line 1    nav_pose_estimator KIND VERSION
line 2    SHA-256 of the rest, hexadecimal
rest      the arrays, in numpy's npz format (no pickled objects)

The checksum shows that the file is unchanged, not that its numbers are valid: the caller has to check these.
"""

import hashlib
import io
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from nav_pose_estimator.errors import UserError
from nav_pose_estimator.whole_file import replacing

_LARGEST = 16 * 2**20  # bytes, packed and unpacked: larger than any valid file, so that a wrong one cannot fill memory


class Kind(NamedTuple):
    """Kind of content in one word, and the newest version of it that this program can read."""

    word: str
    version: int

    @property
    def article(self) -> str:
        """The word with its article."""
        return f"{'an' if self.word[0] in 'aeiou' else 'a'} {self.word}"

    @property
    def magic(self) -> bytes:
        """Beginning of the first line."""
        return f"nav_pose_estimator {self.word} ".encode()


def save(path: str | Path, kind: Kind, arrays: Mapping[str, np.ndarray], durable: bool = True) -> None:
    """Write ``arrays`` to ``path`` atomically: on any failure the previous file remains.

    A temporary file beside it is written, synchronised to the disk and renamed. With ``durable`` False the disk is not
    waited for: the file survives the end of the process, but perhaps not a loss of power. Raises ``UserError`` where
    writing fails.
    """
    path = Path(path)
    buffer = io.BytesIO()
    named: dict[str, Any] = {name: np.asarray(value) for name, value in arrays.items()}
    np.savez(buffer, **named)  # without allow_pickle=False, which NumPy 1 would save as one more array
    body = buffer.getvalue()
    header = kind.magic + f"{kind.version}\n{hashlib.sha256(body).hexdigest()}\n".encode()
    try:
        with replacing(path) as unfinished, unfinished.open("wb") as file:
            file.write(header + body)
            file.flush()
            if durable:
                os.fsync(file.fileno())
        if durable:
            _sync_directory(path.parent)
    except OSError as error:
        raise UserError(f"cannot write the {kind.word} {path}: {error.strerror}") from None


def load(path: str | Path, kind: Kind) -> dict[str, np.ndarray]:
    """The arrays that ``save`` wrote, bit for bit; ``UserError`` for a damaged, foreign or newer file."""
    path = Path(path)
    foreign = f"{path} is not {kind.article} of nav_pose_estimator"
    try:
        if path.stat().st_size > _LARGEST:
            raise UserError(f"{foreign}: it is too large")
        content = path.read_bytes()
    except OSError as error:
        raise UserError(f"cannot read the {kind.word} {path}: {error.strerror}") from None
    first, _, rest = content.partition(b"\n")
    version = first.removeprefix(kind.magic)
    if not first.startswith(kind.magic) or not version.isdigit():
        raise UserError(foreign)
    if int(version) > kind.version:
        text = f"{path} has {kind.word} version {int(version)}, this program reads up to {kind.version}: update it"
        raise UserError(text)
    checksum, _, body = rest.partition(b"\n")
    if checksum.decode("ascii", "replace") != hashlib.sha256(body).hexdigest():
        raise UserError(f"{path} is damaged: its checksum does not match, perhaps it was copied in part")
    return _unpack(path, foreign, body)


def _unpack(path: Path, foreign: str, body: bytes) -> dict[str, np.ndarray]:
    try:
        with zipfile.ZipFile(io.BytesIO(body)) as archive:
            unpacked = sum(item.file_size for item in archive.infolist())
        if unpacked > _LARGEST:
            raise UserError(f"{foreign}: it is too large")
        with np.load(io.BytesIO(body), allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except UserError:
        raise
    except Exception as error:  # numpy and zipfile raise many types of errors for damaged bytes
        raise UserError(f"{path} is damaged: {' '.join(str(error).split())}") from None


def _sync_directory(directory: Path) -> None:
    """Synchronise the new name to the disk; skipped where a directory cannot be opened (not POSIX)."""
    try:
        descriptor = os.open(directory, os.O_RDONLY)
    except OSError:
        return
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
