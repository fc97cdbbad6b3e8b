"""Trained models on disk, as ``array_file`` keeps them.

A checksum shows that the file is as it was written, not that a training wrote it. So a model is also checked against
what a vehicle can do: speeds, winds and variances outside those bounds are refused before anything flies with them.
"""

from collections.abc import Mapping
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

from nav_pose_estimator.core.learning.anfis import Anfis
from nav_pose_estimator.engine.outage import array_file
from nav_pose_estimator.errors import UserError

VERSION = 1
_KIND = array_file.FileKind("model", VERSION)
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
    """Write ``arrays`` to ``path``, all of them or nothing. ``UserError`` when that is impossible."""
    array_file.save(path, _KIND, arrays)


def load_arrays(path: str | Path) -> dict[str, np.ndarray]:
    """The arrays that ``save_arrays`` wrote, bit for bit.

    ``UserError`` for a damaged, foreign or newer file, and for a model that says what no vehicle can do.
    """
    arrays = array_file.load(path, _KIND)
    _check_bounds(Path(path), arrays)
    return arrays


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
