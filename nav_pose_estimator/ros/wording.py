"""Texts of diagnostics: status and inputs in sentences, by pure functions of plain data."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from nav_pose_estimator.engine.solutions import Mode, Status

OK, WARN, ERROR = 0, 1, 2  # diagnostic_msgs/DiagnosticStatus

Description = tuple[int, str, list[tuple[str, str]]]
"""Level, sentence, and facts by key: the content of ``~/status``."""

_LEVELS = {Mode.AIDED: OK, Mode.EXPIRED: ERROR}
MEANINGS = {
    Mode.WAITING_IMU: "waiting for the IMU",
    Mode.ALIGNING: "aligning",
    Mode.NO_ORIGIN: "level, but without a position",
    Mode.AIDED: "GNSS is used",
    Mode.COASTING: "GNSS is lost, the drift is held",
    Mode.DEAD_RECKONING: "GNSS is lost, only the IMU is left",
    Mode.EXPIRED: "too long without GNSS: do not trust the position",
    Mode.REACQUIRING: "GNSS is back and being checked",
}


ATTITUDE_MEANINGS = {
    Mode.WAITING_IMU: "waiting for the IMU",
    Mode.ALIGNING: "levelling",
    Mode.AIDED: "the attitude is level",
}
LEARNER_MEANINGS = {
    Mode.WAITING_IMU: "waiting for the navigator",
    Mode.ALIGNING: "the model is not used yet",
    Mode.AIDED: "the model helps when GNSS is lost",
}


@dataclass(frozen=True)
class InputReport:
    """State of one input topic.

    ``total`` messages in all, ``rate`` [Hz] since the last report, ``lost`` messages in all and ``lost_lately`` since
    the last report, ``age`` [s] of the last message. ``misfits``: one clause for each incompatible publisher.
    ``is_gone``: there was a publisher, and there is none any more.
    """

    topic: str
    total: int
    rate: float
    lost: int
    age: float
    publishers: int
    needed: bool
    misfits: tuple[str, ...] = ()
    lost_lately: int = 0
    is_gone: bool = False


def level_of(status: Status) -> int:
    """OK, WARN or ERROR by the mode; WARN instead of OK while the navigator is in doubt."""
    level = _LEVELS.get(status.mode, WARN)
    return WARN if status.doubt and level == OK else level


def sentence(status: Status, meanings: Mapping[Mode, str] = MEANINGS) -> str:
    """Sentence that describes the state; ``meanings`` of the modes where they differ from those of the navigator."""
    waiting = status.waiting_for.rstrip(".")
    parts = [f"{status.mode.value}: {waiting or meanings[status.mode]}"]
    if status.mode is Mode.COASTING and status.held_by and not waiting:
        parts[0] += f" by {status.held_by}"
    if status.seconds_coasting > 0.0:
        parts.append(f"for {status.seconds_coasting:.0f} s")
    if math.isfinite(status.horizontal_sd):
        parts.append(f"position good to {metres(status.horizontal_sd)} (1 sigma)")
    if status.mode is not Mode.AIDED and math.isfinite(status.horizontal_sd_in_30_s):
        parts.append(f"to {metres(status.horizontal_sd_in_30_s)} in 30 s")
    if status.doubt:
        parts.append(f"in doubt: {status.doubt}")
    if status.gnss_refusal and status.gnss_refusal not in waiting:
        parts.append(f"GNSS refused: {status.gnss_refusal}")
    return ", ".join(parts)


def facts(status: Status) -> list[tuple[str, str]]:
    """Facts by key, with the same keys in every message."""
    satellites = "unknown" if status.satellites is None else str(status.satellites)
    pairs = [
        ("mode", status.mode.value),
        ("waiting for", status.waiting_for or "-"),
        ("seconds without GNSS", f"{status.seconds_coasting:.1f}"),
        ("horizontal sigma [m]", number(status.horizontal_sd)),
        ("horizontal sigma in 30 s [m]", number(status.horizontal_sd_in_30_s)),
        ("GNSS refused because", status.gnss_refusal or "-"),
        ("in doubt because", status.doubt or "-"),
        ("satellites", satellites),
    ]
    return pairs + [(key, number(value)) for key, value in sorted(status.values.items())]


def learner_facts(status: Status, training: str, history: Sequence[Mapping[str, float]]) -> list[tuple[str, str]]:
    """Facts by key for the learner; ``history``: its scores after each training, the learning curve."""
    names = sorted({name for scores in history for name in scores if "error" in name})
    curves = [(name, ", ".join(number(scores.get(name, math.nan)) for scores in history)) for name in names]
    return [
        ("mode", status.mode.value),
        ("not used because", status.waiting_for or "-"),
        ("training", training),
        ("trainings", str(len(history))),
        *((key, number(value)) for key, value in sorted(status.values.items())),
        *((f"{name} after each training", curve) for name, curve in curves),
    ]


def input_sentence(reports: list[InputReport]) -> tuple[int, str]:
    """Level and sentence for the inputs: WARN for silent needed inputs, losses and incompatible publishers."""
    words = [words for report in reports for words in _complaints(report)]
    return (WARN, "; ".join(words)) if words else (OK, "all needed inputs arrive")


def _complaints(report: InputReport) -> Iterator[str]:
    if report.needed and report.age > 2.0:
        since = "was never received" if not math.isfinite(report.age) else f"silent for {report.age:.0f} s"
        yield f"{report.topic} {since} ({report.publishers} publishers)"
    elif report.is_gone:
        yield f"{report.topic}: its publisher is gone"
    if report.lost_lately:
        yield f"{report.topic}: {report.lost_lately} messages lost"
    yield from (f"{report.topic}: {misfit}" for misfit in report.misfits)


def input_facts(reports: list[InputReport]) -> list[tuple[str, str]]:
    """Rate, age and losses of every input."""
    return [
        (
            report.topic,
            f"{report.rate:.1f} Hz, {report.total} in all, {report.lost} lost, last {number(report.age)} s ago, "
            f"{report.publishers} publishers",
        )
        for report in reports
    ]


def metres(value: float) -> str:
    """A length [m] as text, in m or km."""
    return f"{value:.1f} m" if value < 10.0 else f"{value:.0f} m" if value < 10_000.0 else f"{value / 1000:.0f} km"


def number(value: float) -> str:
    """A number as text; "unknown" if it is not finite."""
    return f"{value:.4g}" if math.isfinite(value) else "unknown"
