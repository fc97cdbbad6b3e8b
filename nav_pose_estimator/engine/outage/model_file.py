"""Files of trained models, written atomically: a crash never loses the last good one.

The container is that of ``engine.array_file``. Its checksum shows that the file is as it was written, not who wrote it.
So the content is also checked for plausibility: a model with speeds, winds or variances out of bounds is refused before
it is used.
"""

from collections.abc import Mapping
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

from nav_pose_estimator.core.learning.anfis import Anfis
from nav_pose_estimator.engine import array_file
from nav_pose_estimator.errors import UserError

VERSION = 1
_MODEL = array_file.Kind("model", VERSION)
_NETWORK = "network."  # prefix of the names of the network's arrays
_FASTEST = 150.0  # m/s: largest speed that a network may predict
_STRONGEST = 60.0  # m/s: largest wind
_BOUNDS: dict[str, tuple[float, float]] = {
    "wind": (-2.0 * _STRONGEST, 2.0 * _STRONGEST),  # the change from the mean
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
"""Bounds of the arrays of an outage model, by name; ``*`` stands for any prefix."""


def save_arrays(path: str | Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write ``arrays`` to ``path`` atomically: on failure the previous file remains.

    Raises ``UserError`` when the file cannot be written.
    """
    array_file.save(path, _MODEL, arrays)


def load_arrays(path: str | Path) -> dict[str, np.ndarray]:
    """The arrays that ``save_arrays`` wrote, bit for bit.

    Raises ``UserError`` for a damaged, foreign or newer file, and for an implausible model.
    """
    arrays = array_file.load(path, _MODEL)
    check_bounds(str(path), arrays)
    return arrays


def check_bounds(path: str, arrays: Mapping[str, np.ndarray]) -> None:
    """Raise ``UserError``, with ``path`` in its message, for an implausible model."""
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
    """The largest speed [m/s] that a network predicts at the centres of its rules and one deviation around them."""
    scaling, centres = model.network.scaling, model.network.premises.centre.T
    steps = np.concatenate([np.zeros((1, centres.shape[1])), np.eye(centres.shape[1]), -np.eye(centres.shape[1])])
    z = (centres[:, None, :] + steps).reshape(-1, centres.shape[1])
    x = scaling.in_mean + np.divide(z, scaling.in_gain, out=np.zeros_like(z), where=scaling.in_gain > 0.0)
    with np.errstate(all="ignore"):
        return float(np.max(np.linalg.norm(model.predict(x), axis=1)))


def save_model(path: str | Path, model: Anfis) -> None:
    """Write a trained network to ``path`` with ``save_arrays``."""
    save_arrays(path, model.state())


def load_model(path: str | Path) -> Anfis:
    """The network that ``save_model`` wrote; its predictions are the same, bit for bit."""
    arrays = load_arrays(path)
    try:
        return Anfis.from_state(arrays)
    except UserError as error:
        raise UserError(f"{path}: {error}") from None
