"""Frequency of a wrong pose with a good status on recorded flights whose GNSS latency is not set, by ``gnss.delay_sd``.

The truth is the receiver's own track at its times of validity: stamps less the latency in NAME.json beside the bag.

tools/in_environment.sh python benchmarks/unknown_latency.py flights/*_bag
"""

import argparse
import math
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from nav_pose_estimator.core.earth.ellipsoid import lla_to_enu
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, ImuBlock
from nav_pose_estimator.engine.solutions import Mode, NavBlock
from nav_pose_estimator.offline.flights.flight_window import flight_window
from nav_pose_estimator.offline.flights.recording import Recording, load

WRONG, LEAST = 3.0, 3.0  # sigmas, and m: an error that exceeds both is wrong
EVERY, LONGEST_GAP = 0.2, 0.6  # s between two looks, and between two fixes that are interpolated
Place = tuple[float, float, float]


class Track:
    """The receiver's track: position ENU [m] by time [s] since the recording's epoch."""

    def __init__(self, recording: Recording, latency: float) -> None:
        held = recording.held
        velocities = {s.stamp_ns: s.vel_enu for s in held if isinstance(s, GnssVelocity)}
        fixes = {s.stamp_ns: s for s in held if isinstance(s, GnssFix) and s.stamp_ns in velocities and s.lat == s.lat}
        first = next(iter(fixes.values()))
        self.origin: Place = (first.lat, first.lon, first.alt)
        stamps = sorted(fixes)
        self.t = np.array([1e-9 * (stamp - recording.epoch_ns) for stamp in stamps]) - latency
        places = np.array([self.local((fixes[s].lat, fixes[s].lon, fixes[s].alt)) for s in stamps])
        self._curve = CubicHermiteSpline(self.t, places, np.array([velocities[s] for s in stamps]))

    def local(self, place: Place) -> np.ndarray:
        """ENU (3,) of latitude, longitude and height."""
        return np.asarray(lla_to_enu(*place, *self.origin))

    def at(self, t: float) -> np.ndarray | None:
        """Position (3,) at ``t``, None between fixes that are far apart and before or after all of them."""
        k = int(self.t.searchsorted(t))
        is_known = 0 < k < len(self.t) and self.t[k] - self.t[k - 1] < LONGEST_GAP
        return self._curve(t) if is_known else None


def fly(recording: Recording, track: Track, delay_sd: float) -> np.ndarray:
    """Rows (N, 4) of the flight: horizontal error and sigma [m]; whether the status is good, and the pose wrong."""
    settings = {"gnss.delay_sd": delay_sd, "learner.method": "coast"}
    estimator = PoseEstimator(update(Parameters(), settings), attitude=False)
    begin, end = flight_window(recording)
    rows, asked = [], -math.inf
    for sample in recording.held:
        for output in estimator.feed(sample):
            if not isinstance(output, NavBlock):
                continue
            t = 1e-9 * (int(output.stamps_ns[-1]) - recording.epoch_ns)
            place = track.at(t) if t - asked > EVERY - 1e-6 and begin < t < end else None
            if place is None:
                continue
            asked, row, status = t, output.rows[-1], estimator.status()
            off = float(np.hypot(*(track.local(tuple(row[at.OUT_POS : at.OUT_VEL].tolist())) - place)[:2]))
            sd = math.sqrt(row[at.OUT_VAR + at.DPOS] + row[at.OUT_VAR + at.DPOS + 1])
            is_good = status.mode is not Mode.EXPIRED and not status.doubt
            rows.append((off, sd, is_good, off > WRONG * sd and off > LEAST))
    return np.array(rows, float).reshape(-1, 4)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bags", type=Path, nargs="+")
    parser.add_argument("--delay-sd", type=float, nargs="+", default=[0.0, 0.2], help="gnss.delay_sd, s")
    options = parser.parse_args()
    totals = dict.fromkeys(options.delay_sd, 0.0)
    for bag in options.bags:
        recording = load(bag)
        if not any(isinstance(sample, ImuBlock) for sample in recording.held):
            continue
        latency = float(recording.sidecar.get("gnss_latency_est_s", 0.0))
        track = Track(recording, latency)
        print(f"{bag.name}: latency {latency:.2f} s")
        for delay_sd in options.delay_sd:
            off, sd, good, wrong = fly(recording, track, delay_sd).T
            lies = EVERY * float(np.sum((good > 0.0) & (wrong > 0.0)))
            totals[delay_sd] += lies
            print(
                f"    delay_sd {delay_sd:.2f} s: wrong and OK {lies:5.1f} s of {EVERY * len(off):5.1f} s, error "
                f"{np.sqrt(np.mean(off**2)):.2f} m rms, {off.max():.1f} m at most, median sigma {np.median(sd):.2f} m",
                flush=True,
            )
    print("all:", ", ".join(f"delay_sd {key:.2f} s: {seconds:.1f} s" for key, seconds in totals.items()))


if __name__ == "__main__":
    main()
