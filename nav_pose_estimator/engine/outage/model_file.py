"""Trained models on disk: one file with a version and a checksum, written so that a kill never loses the last good one.

line 1    nav_pose_estimator model VERSION
line 2    SHA-256 of the rest, hexadecimal
rest      the arrays, in numpy's npz format (no pickled objects)

A checksum shows that the file is as it was written, not that a training wrote it. So a model is also checked against
what a vehicle can do: speeds, winds and variances outside those bounds are refused before anything flies with them.
"""

import hashlib
import io
import os
import zipfile
from collections.abc import Mapping
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

from nav_pose_estimator.core.learning.anfis import Anfis
from nav_pose_estimator.errors import UserError

VERSION = 1
_MAGIC = b"nav_pose_estimator model "
_LARGEST = 16 * 2**20  # bytes, also unpacked: no model is larger, and a wrong file shall not fill the memory
_NETWORK = "network."  # beginning of the names of its arrays
_FASTEST = 150.0  # m/s
_STRONGEST = 60.0  # m/s of wind
_BOUNDS: dict[str, tuple[float, float]] = {
    "wind": (-2.0 * _STRONGEST, 2.0 * _STRONGEST),  # a change since the mean
    "wind_mean": (-_STRONGEST, _STRONGEST),
    "wind_cov": (-(_STRONGEST**2), _STRONGEST**2),
    "wind_spread": (0.0, _STRONGEST**2),
    "noise": (1e-4, 1e4),  # m^2/s^2, of a mean over one second
    "hover_noise": (1e-4, 1e4),
    "target_square": (0.0, _FASTEST**2),
    "errors": (0.0, 1e6),
    "parameter_cov": (-1e21, 1e21),
    "*option.rules": (1, 64),
    "*option.iterations": (0, 100_000),
}
"""What the arrays of an outage model may hold, by name; ``*`` stands for any beginning."""


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
    """The arrays that ``save_arrays`` wrote, bit for bit.

    ``UserError`` for a damaged, foreign or newer file, and for a model that says what no vehicle can do.
    """
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
    arrays = _unpack(path, body)
    _check_bounds(path, arrays)
    return arrays


def _unpack(path: Path, body: bytes) -> dict[str, np.ndarray]:
    try:
        with zipfile.ZipFile(io.BytesIO(body)) as archive:
            unpacked = sum(item.file_size for item in archive.infolist())
        if unpacked > _LARGEST:
            raise UserError(f"{path} is not a model of nav_pose_estimator: it is too large")
        with np.load(io.BytesIO(body), allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except UserError:
        raise
    except Exception as error:  # numpy and zipfile raise whatever the bytes lead to
        raise UserError(f"{path} is damaged: {' '.join(str(error).split())}") from None


def _check_bounds(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    for name, values in arrays.items():
        if values.dtype.kind not in "fiub":
            continue
        bounds = [limits for pattern, limits in _BOUNDS.items() if fnmatchcase(name, pattern)]
        if any(not ((values >= low) & (values <= high)).all() for low, high in bounds):  # false for NaN
            raise UserError(f"{path}: {name} is beyond what a vehicle can do; the model is not used")
    for name in ("wind_cov", "parameter_cov"):
        cov = arrays.get(name)
        if cov is not None and cov.ndim == 2 and cov.shape[0] == cov.shape[1] > 0:
            eigenvalues = np.linalg.eigvalsh(cov)
            if eigenvalues[0] < -1e-6 * max(abs(eigenvalues[-1]), 1e-9):
                raise UserError(f"{path}: {name} is not a covariance; the model is not used")
    network = {name.removeprefix(_NETWORK): value for name, value in arrays.items() if name.startswith(_NETWORK)}
    if network:
        speed = _fastest(Anfis.from_state(network))
        if not speed <= _FASTEST:
            raise UserError(f"{path}: its network predicts {speed:.3g} m/s; the model is not used")


def _fastest(model: Anfis) -> float:
    """The largest velocity [m/s] that a network predicts where its rules lie, and a deviation beside that."""
    scaling, centres = model.network.scaling, model.network.premises.centre.T
    steps = np.concatenate([np.zeros((1, centres.shape[1])), np.eye(centres.shape[1]), -np.eye(centres.shape[1])])
    z = (centres[:, None, :] + steps).reshape(-1, centres.shape[1])
    x = scaling.in_mean + np.divide(z, scaling.in_gain, out=np.zeros_like(z), where=scaling.in_gain > 0.0)
    with np.errstate(all="ignore"):
        return float(np.max(np.linalg.norm(model.predict(x), axis=1)))


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
