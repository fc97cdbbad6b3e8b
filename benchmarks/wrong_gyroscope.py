"""Time with a wrong pose and a good status, with a gyroscope of wrong scale, sign or axes from the start.

A quantity is wrong beyond 3 sigma and 3 m, 0.7 m/s, 2 deg of tilt or 4 deg of heading. The status is good unless it has
a doubt or the mode is EXPIRED.

tools/in_environment.sh python benchmarks/wrong_gyroscope.py --kinds "all x 1.2" "z inverted" --vehicles hover laps
"""

import argparse
import math
from dataclasses import dataclass, field, replace

import numpy as np

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter.error_state import turn_between
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import ImuBlock
from nav_pose_estimator.engine.solutions import Event, Mode, NavBlock
from nav_pose_estimator.sim import scenarios
from nav_pose_estimator.sim.recording import Recording

VEHICLES = ("multirotor_outage", "laps", "stop_and_go", "hover", "fixed_wing", "road_vehicle", "closed_curve")
DURATION = 100.0  # s
SAME = np.eye(3)
QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
SWAPPED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
KINDS: dict[str, tuple[np.ndarray, np.ndarray]] = {
    "sound": (SAME, SAME),
    "all x 1.2": (1.2 * SAME, SAME),
    "all x 0.8": (0.8 * SAME, SAME),
    "z x 1.2": (np.diag([1.0, 1.0, 1.2]), SAME),
    "z x 0.8": (np.diag([1.0, 1.0, 0.8]), SAME),
    "x x 0.8": (np.diag([0.8, 1.0, 1.0]), SAME),
    "all x 0.5": (0.5 * SAME, SAME),
    "x inverted": (np.diag([-1.0, 1.0, 1.0]), SAME),
    "y inverted": (np.diag([1.0, -1.0, 1.0]), SAME),
    "z inverted": (np.diag([1.0, 1.0, -1.0]), SAME),
    "all inverted": (-SAME, SAME),
    "x and y exchanged": (SWAPPED, SAME),
    "x and y exchanged in both": (SWAPPED, SWAPPED),
    "gyroscope turned": (QUARTER, SAME),
    "accelerometer turned": (SAME, QUARTER),
    "degrees": (SAME * 180.0 / math.pi, SAME),
}
"""Matrices that the rates and the forces are multiplied by."""
LEAST = (3.0, 0.7, math.radians(2.0), math.radians(4.0))
QUANTITIES = ("position", "velocity", "tilt", "heading")


@dataclass
class Sum:
    """Seconds of all flights of one kind."""

    wrong: np.ndarray = field(default_factory=lambda: np.zeros(len(QUANTITIES)))
    any_of_them: float = 0.0
    good: float = 0.0
    heading: float = 0.0
    """Largest error of the heading [deg] while it was wrong and the status good."""
    flights: int = 0


def errors(recording: Recording, row: np.ndarray, t: float) -> list[tuple[float, float]]:
    """(error, standard deviation) of each of ``QUANTITIES`` at ``t`` [s].

    Those of position and velocity are horizontal or vertical, whichever error is larger relative to its deviation.
    """
    truth = recording.truth
    k = min(int(np.searchsorted(truth.t, t - 1e-3)), len(truth.t) - 1)
    sd = np.sqrt(row[at.OUT_VAR : at.OUT_VAR + 9])
    turn = turn_between(truth.q_nb[k], row[at.OUT_QUAT : at.OUT_QUAT + 4])
    found = []
    for error, deviation in (
        (recording.error_enu(t, row[at.OUT_POS : at.OUT_VEL]), sd[at.DPOS : at.DPOS + 3]),
        (row[at.OUT_VEL : at.OUT_QUAT] - truth.v_n[k], sd[at.DVEL : at.DVEL + 3]),
    ):
        pairs = (math.hypot(*error[:2]), math.hypot(*deviation[:2])), (abs(error[2]), float(deviation[2]))
        found.append(max(pairs, key=lambda pair: pair[0] / pair[1]))
    return [*found, (math.hypot(*turn[:2]), math.hypot(*sd[:2])), (abs(turn[2]), float(sd[2]))]


def fly(recording: Recording, kind: str, total: Sum) -> list[Event]:
    """Fly with a wrong gyroscope, add to ``total``, and return the events about the IMU."""
    gyro, accel = KINDS[kind]
    estimator = PoseEstimator(update(Parameters(), {"learner.method": "coast"}), attitude=False)
    asked, events = -math.inf, []
    total.flights += 1
    for sample in recording.samples():
        if isinstance(sample, ImuBlock):
            sample = replace(sample, gyro=sample.gyro @ gyro.T, accel=sample.accel @ accel.T)
        for output in estimator.feed(sample):
            if isinstance(output, Event) and output.text and output.name.startswith("imu."):
                events.append(output)
            elif isinstance(output, NavBlock) and output.stamps_ns[-1] - asked > 0.19e9:
                asked = output.stamps_ns[-1]
                judge(recording, output, estimator, total)
    return events


def judge(recording: Recording, block: NavBlock, estimator: PoseEstimator, total: Sum) -> None:
    """Add 0.2 s to ``total``."""
    status = estimator.status()
    if status.mode is Mode.EXPIRED or status.doubt:
        return
    pairs = errors(recording, block.rows[-1], (block.stamps_ns[-1] - recording.start_ns) * 1e-9)
    wrong = np.array([e > 3.0 * sd and e > least for (e, sd), least in zip(pairs, LEAST, strict=True)])
    total.wrong += 0.2 * wrong
    total.any_of_them += 0.2 * bool(wrong.any())
    total.good += 0.2
    if wrong[-1]:
        total.heading = max(total.heading, math.degrees(pairs[-1][0]))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=list(KINDS))
    parser.add_argument("--vehicles", nargs="+", default=list(VEHICLES), choices=list(VEHICLES))
    parser.add_argument("--seeds", nargs="+", type=int, default=[1])
    parser.add_argument("--words", action="store_true", help="show every flight and its events")
    options = parser.parse_args()
    flights = [
        (v, s, scenarios.generate(v, DURATION, s, imu_rate=100.0)) for v in options.vehicles for s in options.seeds
    ]
    print(f"{'kind':26s} flights  wrong and good  " + "  ".join(f"{q:>8s}" for q in QUANTITIES) + "   good  heading")
    for kind in options.kinds:
        total = Sum()
        for vehicle, seed, recording in flights:
            before = total.any_of_them
            events = fly(recording, kind, total)
            if options.words:
                print(f"  {vehicle} {seed}: {total.any_of_them - before:.1f} s")
                for event in events:
                    print(f"    {(event.stamp_ns - recording.start_ns) * 1e-9:.1f} {event.name}: {event.text}")
        parts = "  ".join(f"{seconds:6.1f} s" for seconds in total.wrong)
        whole = f"{kind:26s} {total.flights:7d}  {total.any_of_them:12.1f} s"
        print(f"{whole}  {parts} {total.good:6.0f} s {total.heading:4.0f} deg", flush=True)


if __name__ == "__main__":
    main()
