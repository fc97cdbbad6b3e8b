"""Counters and event sentences of the beam velocity sensor."""

from __future__ import annotations

import math

from nav_pose_estimator.core.beams.judge import GATED, LOST, OUT, PARITY, USED
from nav_pose_estimator.core.filter.measurements import BEAMS
from nav_pose_estimator.engine.solutions import Level

VERDICTS = {USED: "used", LOST: "lost", GATED: "rejected", PARITY: "rejected.parity", OUT: "rejected.out"}
"""Last words of the counters of a beam."""
COUNTERS = tuple(
    {verdict: f"beam_velocity.{beam}.{word}" for verdict, word in VERDICTS.items()}
    for beam in (*range(1, BEAMS + 1), "points")
)
"""Names of the counters of each beam, then those of points, by verdict."""

UNPROVEN = (
    "beam_velocity.unproven",
    Level.WARN,
    "beam velocities not used: GNSS was lost before they had agreed with it in motion, so their mounting is uncertain",
)
AGREES = ("beam_velocity.contradicts.ended", Level.INFO, "beam velocities and GNSS agree again: they are used")


def delayed(delay: float, sd: float) -> tuple[str, Level, str]:
    """Event for velocities with a latency of ``delay`` [s]; a lower bound where ``sd`` is NaN, else the estimate."""
    text = f"beam velocities seem to be {delay:.2f} s old when they are stamped (at arrival?): set aids.beams.delay"
    if not math.isnan(sd):
        text = f"beam velocities are {delay:.2f} s old when they are stamped: compensated (set aids.beams.delay)"
    return "beam_velocity.delayed", Level.WARN, text


def latched(beams: list[int], are_out: bool) -> tuple[str, Level, str]:
    """Event for ``beams``, counted from 1, that are excluded until they agree again, or used again."""
    which = f"beam {beams[0]}" if len(beams) == 1 else f"beams {', '.join(map(str, beams))}"
    if are_out:
        text = f"{which} excluded: too many velocities disagree with the navigator or the other beams"
        return "beam_velocity.beam_out", Level.WARN, text
    return "beam_velocity.beam_in", Level.INFO, f"{which} used again: the velocities agree"
