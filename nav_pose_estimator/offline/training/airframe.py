"""Computation of the content of an airframe file from recordings, and a cross-validated table of its benefit."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator import __version__
from nav_pose_estimator.core.learning.conv_lstm import ConvLstm
from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.air_velocity import learn_air_velocity, with_law
from nav_pose_estimator.core.motion.airframe import (
    Airframe,
    Archive,
    PastFlight,
    TrainedNetwork,
    air_velocity,
    as_prior,
    control_of,
)
from nav_pose_estimator.core.motion.vehicle_class import MULTIROTOR, UNKNOWN, WHEELS
from nav_pose_estimator.core.motion.windows import SECONDS
from nav_pose_estimator.engine.outage.airframe_file import LONGEST_NAME
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.archive.kept import KeptResults
from nav_pose_estimator.offline.training import archive as sums
from nav_pose_estimator.offline.training import left_out, network
from nav_pose_estimator.offline.training.archive import NormalEquations
from nav_pose_estimator.offline.training.flights import FlightData

Array = NDArray[np.float64]
Merged = Sequence[tuple[Path, Airframe]]


@dataclass(frozen=True)
class Order:
    """Options: the class (None: by the flights), and the ``form`` of a network (None: without a network)."""

    vehicle_class: str | None = None
    is_one_aircraft: bool = False
    form: str | None = None
    steps: int = 2500
    folds: int = 4


@dataclass(frozen=True)
class Member:
    """A recording in the archive: the key of its stored data, and its normal equations."""

    kept: KeptResults
    key: str
    past: PastFlight
    shown_class: str
    equations: NormalEquations

    def data(self) -> FlightData:
        """Data of the flight, read from disk, so that only one flight is in memory at a time."""
        return self.kept.load(self.key)


def make_airframe(kept: KeptResults, keys: Sequence[str], merged: Merged, order: Order) -> tuple[Airframe, list[str]]:
    """The airframe of recordings, ``kept`` by ``keys``, and of files to merge; and the lines of the table."""
    in_files = _flights_of(merged)
    members = [member for member in (_member(kept, key) for key in keys) if not _is_double(member, in_files)]
    if not members and not merged:
        raise UserError("none of the recordings can be used, see the notes above")
    vehicle_class = choose_class(members, merged, order.vehicle_class)
    from_files = [NormalEquations.from_archive(airframe.archive) for _, airframe in merged]
    total = reduce(add, [*(member.equations for member in members), *from_files])
    scores, judged = [], []
    for member in members:
        score, archive = _left_out(member, total, vehicle_class, order.is_one_aircraft)
        scores.append(score)
        judged.append(archive)
    noise, spread = _noise([*judged, *(airframe.archive for _, airframe in merged)])
    trained = None
    if order.form is not None:
        trained, more = _network(members, vehicle_class, order, (noise, spread))
        scores = [replace(a, errors={**a.errors, **b}) for a, b in zip(scores, more, strict=True)]
    flights = (*(member.past for member in members), *in_files.values())
    archive = total.archive(noise, spread)
    airframe = Airframe(vehicle_class, order.is_one_aircraft, archive, trained, flights, made_with())
    return airframe, _lines(scores)


def made_with() -> str:
    """Versions of this package and of NumPy, and the vector instructions that NumPy has found."""
    config: Any = np.show_config(mode="dicts")
    found = ", ".join(config.get("SIMD Extensions", {}).get("found", []))
    return f"nav_pose_estimator {__version__}, NumPy {np.__version__} ({found})"[:LONGEST_NAME]


def choose_class(members: Sequence[Member], merged: Merged, given: str | None) -> str:
    """The class of all flights; ``UserError`` if they are of several, for which a common law would be wrong.

    The class ``given`` by the user overrides that of the flights' motion, but not that of a file.
    """
    shown = [(member.past.name, member.shown_class) for member in members]
    stated = [(path.name, airframe.vehicle_class) for path, airframe in merged]
    if given is None:
        found = {kind: name for name, kind in reversed([*stated, *shown])}
        if UNKNOWN in found:
            raise UserError(f"{found[UNKNOWN]} does not show by its motion what flew: say it with --class")
    else:
        found = {given: "--class", **{kind: name for name, kind in stated}}
        for name, kind in shown:
            if kind not in (given, UNKNOWN):
                print(f"note: {name} moves like a {kind}; taken as a {given} because --class says so", file=sys.stderr)
    if len(found) > 1:
        sides = " and ".join(f"{kind} ({name})" for kind, name in found.items())
        raise UserError(f"the flights are of several classes, {sides}: train each by itself, or name it with --class")
    return next(iter(found))


def _member(kept: KeptResults, key: str) -> Member:
    data: FlightData = kept.load(key)
    equations = NormalEquations.of(data.epochs, sums.air_velocity(data.epochs))
    return Member(kept, key, data.past, data.shown_class, equations)


def _flights_of(merged: Merged) -> dict[str, PastFlight]:
    """Flights of all files by digest; ``UserError`` if two files contain the same one, which would count twice."""
    found: dict[str, PastFlight] = {}
    for path, airframe in merged:
        for flight in airframe.flights:
            if flight.digest in found:
                raise UserError(f"{path} holds the flight {flight.name}, as another file does: it would count twice")
            found[flight.digest] = flight
        if airframe.network is not None:
            print(f"note: the network of {path} is not merged: networks cannot be added up", file=sys.stderr)
    return found


def _is_double(member: Member, in_files: dict[str, PastFlight]) -> bool:
    is_double = member.past.digest in in_files
    if is_double:
        print(f"note: {member.past.name} is in a file that is merged: it counts once", file=sys.stderr)
    return is_double


def _left_out(
    member: Member, total: NormalEquations, vehicle_class: str, is_one_aircraft: bool
) -> tuple[left_out.Score, Archive]:
    """Score of a flight with an archive of all others, and its own archive with the noise of their law on it.

    Without others, the law is that of the flight itself.
    """
    epochs, others = member.data().epochs, total - member.equations
    if others.seconds < 1.0:
        model, ways = learn_air_velocity(epochs), left_out.linear_ways(None, None)
    else:
        model = with_law(epochs, others.law(), vehicle_class == WHEELS)
        archive = others.archive(model.noise, model.wind_spread)
        ways = left_out.linear_ways(others.law(), as_prior(archive, vehicle_class, is_one_aircraft))
    # lasting errors of the law are only added for one aircraft: for others they are part of the law's own uncertainty
    noise = left_out.lasting_noise(epochs, model) if is_one_aircraft else model.noise
    own = member.equations.archive(noise, model.wind_spread)
    return left_out.Score(member.past.name, left_out.judge(epochs, ways)), own


def _noise(archives: Sequence[Archive]) -> tuple[Array, float]:
    """Noise and spread of the wind: means by time over recordings and files."""
    seconds = [one.seconds for one in archives]
    noise = np.average([one.noise for one in archives], axis=0, weights=seconds)
    return noise, float(np.average([one.wind_spread for one in archives], weights=seconds))


def _network(
    members: Sequence[Member], vehicle_class: str, order: Order, noise: tuple[Array, float]
) -> tuple[TrainedNetwork, list[dict[str, Array]]]:
    """A network of all recordings, and the errors of networks of the other folds on each flight, with a control."""
    if len(members) < 2:
        raise UserError(
            "--network needs two recordings or more: what it is worth shows on a flight that it has not seen"
        )
    form = order.form or ""
    recipe = network.Recipe(form, order.steps, turned=vehicle_class == MULTIROTOR)
    folds = [list(range(i, len(members), order.folds)) for i in range(min(order.folds, len(members)))]
    weights = network.with_progress("all flights", _examples(members), recipe)
    control = control_of(weights)
    stacked: list[Array] = [np.empty(0)] * len(members)
    for number, fold in enumerate(folds, 1):
        others = [member for i, member in enumerate(members) if i not in fold]
        trained = network.with_progress(f"fold {number} of {len(folds)}", _examples(others), recipe)
        for i in fold:
            stacked[i] = _with_outputs(members[i].data(), trained, form)
    by_chance = [_with_outputs(member.data(), control, form) for member in members]
    archives, scores = [], []
    for way, flights in ((left_out.STACKED, stacked), (left_out.UNTRAINED, by_chance)):
        archive, errors = _stacked(flights, (vehicle_class, order.is_one_aircraft), way, noise)
        archives.append(archive)
        scores.append(errors)
    return TrainedNetwork(form, weights, *archives), [a | b for a, b in zip(*scores, strict=True)]


def _stacked(
    flights: Sequence[Array], aircraft: tuple[str, bool], way: str, noise: tuple[Array, float]
) -> tuple[Archive, list[dict[str, Array]]]:
    """The archive with a network's outputs, and the errors of each flight with the archive of the others.

    ``aircraft``: class, and whether all flights are of one.
    """
    equations = [NormalEquations.of(epochs, sums.air_velocity(epochs[:, : me.COLUMNS])) for epochs in flights]
    total = reduce(add, equations)
    scores = []
    for epochs, own in zip(flights, equations, strict=True):
        ways = {way: left_out.stacked_way(as_prior((total - own).archive(*noise), *aircraft))}
        if way == left_out.STACKED:
            ways[left_out.NETWORK] = lambda seen: with_law(seen, left_out.OutputLaw(), aircraft[0] == WHEELS)
        scores.append(left_out.judge(epochs, ways))
    return total.archive(*noise), scores


def _with_outputs(data: FlightData, weights: ConvLstm, form: str) -> Array:
    outputs = np.array([air_velocity(weights, form, window) for window in data.windows.astype(float)])
    return np.column_stack([data.epochs, outputs])


def _examples(members: Sequence[Member]) -> network.Examples:
    """Examples of all flights, 4 MB for ten minutes; the wind of each flight is subtracted from velocities and dp."""
    windows, velocity, increments = [], [], []
    for member in members:
        data = member.data()
        through_air = sums.air_velocity(data.epochs)
        wind = data.epochs[:, me.BODY_VELOCITY : me.VELOCITY] - through_air
        windows.append(data.windows)
        velocity.append(through_air.astype(np.float32))
        increments.append(data.increments - np.column_stack([SECONDS * wind, np.zeros((len(wind), 6))]))
    return network.Examples(*(np.concatenate(parts).astype(np.float32) for parts in (windows, velocity, increments)))


def _lines(scores: Sequence[left_out.Score]) -> list[str]:
    if not scores:
        return []
    head = (
        f"dead reckoning over {left_out.LENGTH:.0f} s from {left_out.FIRST:.0f} to {left_out.LAST:.0f} s of flight, "
        "median / RMS m, each flight left out of the archive:"
    )
    return [head, *left_out.table(scores)]
