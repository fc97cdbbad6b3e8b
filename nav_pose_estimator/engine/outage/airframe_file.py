"""Airframe files (NAME.airframe): the knowledge of an aircraft from past flights, in the container of ``array_file``.

    about                       JSON in bytes: class, whether all flights are of one aircraft, form of the network,
                                list of flights, software that made the file
    archive.*                   normal equations of nine inputs
    network.*                   weights of a network, optional; with it
    stacked.*, control.*        normal equations with its outputs as inputs, and with those of a random network

Such files are shared between people. So their content, which is data only, is checked for plausibility before it is
used, in ``load_airframe`` and nowhere else.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from nav_pose_estimator.core.learning.conv_lstm import ConvLstm
from nav_pose_estimator.core.motion import airframe as known
from nav_pose_estimator.core.motion.airframe import Airframe, Archive, PastFlight, TrainedNetwork
from nav_pose_estimator.core.motion.prior import MotionPrior
from nav_pose_estimator.core.motion.vehicle_class import CLASSES
from nav_pose_estimator.core.motion.windows import CHANNELS
from nav_pose_estimator.core.motion.windows import INCREMENTS as INCREMENT_COUNT
from nav_pose_estimator.engine import array_file
from nav_pose_estimator.errors import UserError

KIND = array_file.Kind("airframe", 1)
_INPUTS, _ADDED = 9, 3
_SHAPES = {known.VELOCITY: (CHANNELS, 6), known.INCREMENTS: (6, INCREMENT_COUNT)}
"""Channels and outputs of a network of each form."""
_LARGEST_SQUARE = 1e4  # largest mean square of an input in its fixed scale
_FASTEST = 150.0  # m/s: largest speed that a law may predict
_BOUNDS = {"noise": (1e-4, 1e4), "wind_spread": (0.0, 60.0**2), "seconds": (1.0, 1e9)}  # m^2/s^2, m^2/s^2, s
_MOST_FLIGHTS = 100_000
LONGEST_NAME = 200
"""Largest number of characters of a flight's name and of the software that made the file."""


def save_airframe(path: str | Path, airframe: Airframe) -> None:
    """Write ``airframe`` to ``path``, completely or not at all.

    Raises ``UserError`` when that is impossible, and for content that ``load_airframe`` would refuse.
    """
    network = airframe.network
    about = {
        "class": airframe.vehicle_class,
        "one_aircraft": airframe.is_one_aircraft,
        "form": network.form if network else None,
        "made_with": airframe.made_with,
        "flights": [[flight.name, flight.digest, round(flight.seconds, 1)] for flight in airframe.flights],
    }
    arrays = {"about": np.frombuffer(json.dumps(about).encode(), np.uint8)}
    arrays |= _named("archive", vars(airframe.archive))
    if network is not None:
        arrays |= _named("network", network.weights.state())
        arrays |= _named("stacked", vars(network.archive)) | _named("control", vars(network.control))
    try:
        _airframe(arrays)
    except UserError as error:
        raise UserError(f"{path} is not written: {error}") from None
    array_file.save(path, KIND, arrays)


def load_airframe(path: str | Path) -> Airframe:
    """Read an airframe file. Raises ``UserError`` for one that is damaged, foreign, newer or implausible."""
    arrays = array_file.load(path, KIND)
    try:
        return _airframe(arrays)
    except UserError as error:
        raise UserError(f"{path}: {error}; the file is not used") from None
    except KeyError as error:
        raise UserError(f"{path} is not a whole airframe file: {error} is missing") from None


def _airframe(arrays: Mapping[str, np.ndarray]) -> Airframe:
    about = _about(arrays["about"])
    form, network = about.get("form"), None
    if form is not None:
        weights = ConvLstm.from_state(_part(arrays, "network"))
        if (weights.channels, weights.outputs) != _SHAPES.get(form):
            raise UserError(f"its network does not fit the form {form!r}")
        stacked, control = (_archive(_part(arrays, name), _INPUTS + _ADDED) for name in ("stacked", "control"))
        network = TrainedNetwork(form, weights, stacked, control)
    flights = tuple(_flight(item) for item in about["flights"])
    archive = _archive(_part(arrays, "archive"), _INPUTS)
    made_with = about.get("made_with", "")
    return Airframe(about["class"], about["one_aircraft"], archive, network, flights, made_with)


def _about(content: np.ndarray) -> dict[str, Any]:
    try:
        about = json.loads(content.astype(np.uint8).tobytes())
    except (ValueError, RecursionError):
        raise UserError("its description is not JSON") from None
    if not isinstance(about, dict) or about.get("class") not in CLASSES:
        raise UserError(f"it must name one of the classes {', '.join(CLASSES)}")
    flights = about.get("flights")
    if not isinstance(about.get("one_aircraft"), bool) or not isinstance(flights, list):
        raise UserError("its description of its flights does not fit")
    if not _is_short_text(about.get("made_with", "")):  # files of an earlier version do not say it
        raise UserError("its description of what made it does not fit")
    if len(flights) > _MOST_FLIGHTS or about.get("form") not in (None, *known.FORMS):
        raise UserError("its description of its flights or its network does not fit")
    return about


def _flight(item: Any) -> PastFlight:
    if not isinstance(item, list) or [type(value) for value in item[:2]] != [str, str] or len(item) != 3:
        raise UserError("its list of flights does not fit")
    name, digest, seconds = item
    is_number = isinstance(seconds, (int, float)) and 0.0 <= seconds < _BOUNDS["seconds"][1]
    if not (is_number and name and _is_short_text(name) and len(digest) == 64):
        raise UserError("its list of flights does not fit")
    return PastFlight(name, digest, float(seconds))


def _is_short_text(value: Any) -> bool:
    return isinstance(value, str) and len(value) <= LONGEST_NAME and value.isprintable()


def _archive(part: Mapping[str, np.ndarray], inputs: int) -> Archive:
    """The normal equations in ``part``. Raises ``UserError`` for numbers that no flight yields."""
    shapes = {"gram": (inputs + 1, inputs + 1), "moment": (inputs + 1, 3), "noise": (3,)}
    shapes |= {"wind_spread": (), "seconds": ()}
    values = {name: np.array(part[name]) for name in shapes}
    for name, value in values.items():
        if value.shape != shapes[name] or value.dtype.kind != "f" or not np.isfinite(value).all():
            raise UserError(f"its {name} is not what an archive holds")
        low, high = _BOUNDS.get(name, (-np.inf, np.inf))
        if not ((value >= low) & (value <= high)).all():
            raise UserError(f"its {name} is beyond what a vehicle can do")
    gram, moment = values["gram"], values["moment"]
    if not np.allclose(gram, gram.T, atol=1e-9) or np.diag(gram).max() > _LARGEST_SQUARE or gram[-1, -1] != 1.0:
        raise UserError("its gram is not a matrix of normal equations")
    if np.linalg.eigvalsh(gram)[0] < -1e-9 * _LARGEST_SQUARE:
        raise UserError("its gram is not a matrix of normal equations")
    archive = Archive(gram, moment, values["noise"], float(values["wind_spread"]), float(values["seconds"]))
    speed = float(np.sqrt(np.abs(np.sum(moment * _law(archive)))))
    if not speed <= _FASTEST or not np.abs(moment).max() <= _FASTEST * np.sqrt(_LARGEST_SQUARE):
        raise UserError(f"its law predicts {speed:.3g} m/s, beyond what a vehicle can do")
    return archive


def _law(archive: Archive) -> np.ndarray:
    return MotionPrior(archive.gram, archive.moment, archive.noise, archive.wind_spread).coefficients


def _named(prefix: str, arrays: Mapping[str, Any]) -> dict[str, np.ndarray]:
    return {f"{prefix}.{name}": np.asarray(value) for name, value in arrays.items()}


def _part(arrays: Mapping[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    return {name.removeprefix(f"{prefix}."): value for name, value in arrays.items() if name.startswith(f"{prefix}.")}
