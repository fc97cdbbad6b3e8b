"""Saves the state of an estimator for the next process, and lets that process continue from it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from nav_pose_estimator.core.motion.wind import unseen
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.continuation.saved_state import SavedState
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.navigator.filter_run import FilterRun, resumed, state_of
from nav_pose_estimator.engine.outage import rehearsal_arrays
from nav_pose_estimator.engine.outage.epochs import FlightMemory
from nav_pose_estimator.engine.outage.learner import OutageLearner
from nav_pose_estimator.engine.outage.model_file import check_bounds
from nav_pose_estimator.engine.outage.rehearsals import Rehearsals
from nav_pose_estimator.engine.solutions import Level
from nav_pose_estimator.errors import UserError

_MODEL, _REHEARSALS = "model.", "rehearsals."  # prefixes of the names of their arrays
_FLIGHT = "flight"  # name of the array of epochs of aided flight
_FLOWN = 240.0  # s of saved epochs: enough for training, and little enough to be written every second
_SETTLED = 30.0  # s after a continuation until the navigator is representative enough for a rehearsal


def arrays_of(estimator: PoseEstimator) -> dict[str, np.ndarray] | None:
    """The state to be saved, as named arrays; None before the navigator has one.

    It consists of the state of the navigator, the outage model, its training data, and the results of rehearsals.
    """
    state = state_of(estimator.sins.run)
    if state is None:
        return None
    arrays, aid = state.arrays(), estimator.outage_aid
    if aid is not None:
        arrays.update({_MODEL + name: value for name, value in _model_of(aid.learner).items()})
    if aid is not None and len(aid.learner.state.memory):
        arrays[_FLIGHT] = aid.learner.state.memory.last(_FLOWN)
    if aid is not None and aid.rehearsals.count:
        shown = rehearsal_arrays.arrays_of(aid.rehearsals.state)
        arrays.update({_REHEARSALS + name: value for name, value in shown.items()})
    return arrays


def resume(estimator: PoseEstimator, arrays: Mapping[str, np.ndarray]) -> None:
    """Let an estimator without data continue from ``arrays``, if its first IMU sample permits.

    Raises ``UserError`` for arrays that ``arrays_of`` did not make, or that are implausible.
    """
    saved = SavedState.of(arrays)
    model, shown = (_named(arrays, beginning) for beginning in (_MODEL, _REHEARSALS))
    check_bounds("the saved state", model)
    flown = arrays.get(_FLIGHT)
    if shown:
        rehearsal_arrays.take_over(Rehearsals().state, shown)  # refused now, not in flight
    if flown is not None:
        FlightMemory().take_over(flown)

    def begin(run: FilterRun, stamp_ns: int) -> FilterRun:
        twin, gap = resumed(saved, run, stamp_ns), 1e-9 * (stamp_ns - saved.stamp_ns)
        warm, aid = twin.start_up.warm_start, estimator.outage_aid
        if aid is not None and warm is not None and warm.is_fresh:
            if model:
                _load_model(aid.learner, _with_older_wind(model, gap), run.journal, stamp_ns)
            if shown:
                rehearsal_arrays.take_over(aid.rehearsals.state, shown)
            if flown is not None:
                aid.learner.state.memory.take_over(flown)
                aid.rehearsals.state.next_ns = stamp_ns + round(_SETTLED * 1e9)
        return twin

    estimator.sins.resume = begin


def _model_of(learner: OutageLearner) -> Mapping[str, np.ndarray]:
    """Arrays of the model; none without one, and of a drag law or an airframe file, which need no saving."""
    try:
        return learner.arrays()
    except UserError:
        return {}


def _named(arrays: Mapping[str, np.ndarray], beginning: str) -> dict[str, np.ndarray]:
    """The arrays whose names have the prefix ``beginning``, without it."""
    return {name.removeprefix(beginning): value for name, value in arrays.items() if name.startswith(beginning)}


def _with_older_wind(model: Mapping[str, np.ndarray], seconds: float) -> Mapping[str, np.ndarray]:
    """``model`` with its wind predicted ``seconds`` ahead, without observations."""
    if not all(name in model for name in ("wind", "wind_cov", "wind_spread")):
        return model  # of a method without wind
    wind, cov = unseen(model["wind"], model["wind_cov"], float(model["wind_spread"]), seconds)
    return {**model, "wind": wind, "wind_cov": cov}


def _load_model(learner: OutageLearner, model: Mapping[str, np.ndarray], journal: Journal, stamp_ns: int) -> None:
    try:
        learner.load(model)
    except UserError as error:  # of another learner.method
        journal.say(stamp_ns, "resume.model.refused", Level.INFO, f"the saved outage model is not used: {error}")
