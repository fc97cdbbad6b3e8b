"""What an estimator leaves to the next process, and how that one begins with it."""

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

_MODEL, _REHEARSALS = "model.", "rehearsals."  # beginnings of the names of their arrays
_FLIGHT = "flight"  # epochs of aided flight
_FLOWN = 240.0  # s of them: what shows how a vehicle moves, and not too much to write every second
_SETTLED = 30.0  # s until a navigator that has gone on is a fair sample of one that flies


def arrays_of(estimator: PoseEstimator) -> dict[str, np.ndarray] | None:
    """What the next process can go on with, as named arrays; None while nothing is known.

    The state of the navigator, the outage model, what it is learned from, and what rehearsals have shown.
    """
    state = state_of(estimator.sins.run)
    if state is None:
        return None
    arrays, aid = state.arrays(), estimator.outage_aid
    if aid is not None and aid.learner.state.model is not None:
        arrays.update({_MODEL + name: value for name, value in aid.learner.arrays().items()})
    if aid is not None and len(aid.learner.state.memory):
        arrays[_FLIGHT] = aid.learner.state.memory.last(_FLOWN)
    if aid is not None and aid.rehearsals.count:
        shown = rehearsal_arrays.arrays_of(aid.rehearsals.state)
        arrays.update({_REHEARSALS + name: value for name, value in shown.items()})
    return arrays


def resume(estimator: PoseEstimator, arrays: Mapping[str, np.ndarray]) -> None:
    """Let an estimator that has seen nothing go on from ``arrays``, if its first IMU sample allows that.

    ``UserError`` where they are not what ``arrays_of`` gave, or beyond what a vehicle can do.
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


def _named(arrays: Mapping[str, np.ndarray], beginning: str) -> dict[str, np.ndarray]:
    """Those whose names begin so, without the beginning."""
    return {name.removeprefix(beginning): value for name, value in arrays.items() if name.startswith(beginning)}


def _with_older_wind(model: Mapping[str, np.ndarray], seconds: float) -> Mapping[str, np.ndarray]:
    """``model`` with its wind ``seconds`` later, of which nobody has seen anything."""
    if not all(name in model for name in ("wind", "wind_cov", "wind_spread")):
        return model  # of a method that knows no wind
    wind, cov = unseen(model["wind"], model["wind_cov"], float(model["wind_spread"]), seconds)
    return {**model, "wind": wind, "wind_cov": cov}


def _load_model(learner: OutageLearner, model: Mapping[str, np.ndarray], journal: Journal, stamp_ns: int) -> None:
    try:
        learner.load(model)
    except UserError as error:  # of another learner.method
        journal.say(stamp_ns, "resume.model.refused", Level.INFO, f"the saved outage model is not used: {error}")
