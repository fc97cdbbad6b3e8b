"""What is said about beams."""

from __future__ import annotations

from nav_pose_estimator.core.beams.judge import GATED, LOST, OUT, PARITY, USED
from nav_pose_estimator.engine.solutions import Level

VERDICTS = {USED: "used", LOST: "lost", GATED: "rejected", PARITY: "rejected.parity", OUT: "rejected.out"}
"""Last words of the counters of a beam."""

CONTRADICTS = (
    "beam_velocity.contradicts",
    Level.WARN,
    "beam velocities not used: most beams contradict the navigator while GNSS is good (aids.beams.rpy? a sensor whose "
    "z axis points down and x ahead has roll 3.1416; aids.beams.delay, lever, scale?)",
)
AGREES = ("beam_velocity.contradicts.ended", Level.INFO, "beam velocities and GNSS agree again: they are used")


def latched(beam: int, is_out: bool) -> tuple[str, Level, str]:
    """Beam number ``beam`` is left out, or back."""
    if is_out:
        return (
            "beam_velocity.beam_out",
            Level.WARN,
            f"beam {beam} is left out: its velocities do not fit the others and the navigator",
        )
    return "beam_velocity.beam_in", Level.INFO, f"beam {beam} fits again and is used"
