"""Magnetometer: levelled magnetic heading, with an offset that is learned while GNSS shows the heading.

In an outage it bounds the heading's drift. A magnetometer that disagrees with the motion is not used.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence

import numpy as np

from nav_pose_estimator.core.alignment.levelling import LARGEST_FIELD, likely_unit
from nav_pose_estimator.core.filter import measurements
from nav_pose_estimator.core.filter.layout import PHI, QUAT
from nav_pose_estimator.core.numerics.jit import kernel
from nav_pose_estimator.core.numerics.rotation import yaw_of
from nav_pose_estimator.core.numerics.vectors import q_rotate
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.number_checks import is_within
from nav_pose_estimator.engine.observation import LEFT_OUT, Decision, FilterView, Kind, Observation, Use
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import MagSample, Vector3
from nav_pose_estimator.engine.sensors.aiding import Aiding
from nav_pose_estimator.engine.sensors.magnetic.compass_check import CURE, CompassCheck, single_cause
from nav_pose_estimator.engine.sensors.magnetic.field_calibration import FieldCalibration
from nav_pose_estimator.engine.sensors.magnetic.turn_check import TurnCheck
from nav_pose_estimator.engine.sensors.sensor import Aid, Linearised, Pacer, shared_error
from nav_pose_estimator.engine.solutions import Level

WRONG_START = "mag.heading.wrong_start"
"""Event: the navigator continues from another heading, and quantities learned with the old one are void."""
KNOWN_HEADING = 0.2
"""rad: largest standard deviation of the filter's heading from which the offset is learned."""
_LARGEST_IRON = 1e-3  # T: beyond the range of magnetometers
_OFFSET_MEMORY = 100.0  # s: averaging time of the offset
_SHORTEST_PERIOD = 0.01  # s: floor of the period with which the offset is learned, and in ``CompassCheck``
_EMPTY = 20  # consecutive fields of exactly zero that are no start of a driver
_UNIT_VECTOR = 1e-3  # tolerance of the length of a normalised field


class Magnetometer(Aid):
    """One row: heading error from the levelled field, with declination and the learned offset."""

    kind = Kind("magnetic_heading", quiet=True)
    sample, family = MagSample, "mag"

    def __init__(self, parameters: Parameters, aiding: Aiding, journal: Journal) -> None:
        super().__init__(parameters, aiding, journal)
        self._pacer = Pacer()
        self._offset = math.nan  # rad: magnetic minus filter heading
        self._since = 0.0
        self._is_new, self._zeros = True, 0  # whether no field has come yet; consecutive samples without one
        self._check = CompassCheck()
        self.turns = TurnCheck()
        """The test of its turns against those of the gyroscope."""
        self._calibration, self._hard_iron = FieldCalibration(parameters), parameters.attitude.hard_iron

    def set_parameters(self, parameters: Parameters) -> None:
        """New noise, period and declination."""
        aids = parameters.aids
        self._enabled, self._period, self.declination = aids.magnetometer, aids.magnetometer_period, aids.declination
        self._variance = aids.magnetometer_sd**2 * shared_error(aids.magnetometer_period)
        if not self._enabled:
            self.turns = TurnCheck()  # what it found would never be renewed

    def receive(self, sample: MagSample) -> Vector3:
        """The field of a sample, calibrated and in b; a unit other than tesla, or none, gives an event once."""
        self._zeros = 0 if any(sample.field) else self._zeros + 1
        if self._zeros == _EMPTY:
            text = "the magnetic field is exactly zero: the driver does not fill it, or the sensor is dead"
            self._journal.say(sample.stamp_ns, "mag.empty", Level.WARN, text)
        elif self._is_new and not self._zeros:
            self._is_new = False
            text = self._wrong_unit(math.hypot(*sample.field))
            if text:
                self._journal.say(sample.stamp_ns, "mag.unit", Level.WARN, f"{text}; alignment does not use it")
        return self._calibration.in_body(sample.field)

    def _wrong_unit(self, strength: float) -> str:
        unit, iron = likely_unit(strength), math.hypot(*self._hard_iron)
        if unit:
            return f"a magnetic field of {strength:.3g} is in {unit}: publish tesla"
        if abs(strength - 1.0) < _UNIT_VECTOR:
            return "a magnetic field of length 1 is a direction without its strength: publish tesla"
        if iron > _LARGEST_IRON:
            return f"attitude.hard_iron of {iron:.3g} T is beyond any magnetometer: is it in gauss? tesla is expected"
        return ""

    def observe(self, sample: MagSample, t: float) -> Observation | None:
        """A field in any unit, at most every ``aids.magnetometer_period``."""
        if not self._enabled or not self._pacer.passes(t, self._period):
            return None
        if not is_within(sample.field, LARGEST_FIELD):
            return self._refuse()
        if not any(sample.field):
            self.receive(sample)
            return self._refuse()
        field = self.receive(sample)
        self.turns.field(t, field)
        return Observation(t, sample.stamp_ns, self.kind, tuple(field))

    def decide(self, o: Observation, f: FilterView) -> Decision:
        """While GNSS shows the heading learn the offset; otherwise correct the heading by the field."""
        if self._aiding.gnss_is_good(o.t) and math.sqrt(f.P[PHI + 2, PHI + 2]) < KNOWN_HEADING:
            z, _ = measurements.magnetic_heading(f.nav, len(f.P), *o.measured, self.declination)
            self.learn(o, float(z[0]), f.nav[QUAT : QUAT + 4].tolist())
            return LEFT_OUT
        if self._check.doubted or math.isnan(self._offset):
            return LEFT_OUT
        return Decision(Use.GATED, self._offset)

    def reject(self, stamp_ns: int, error: float) -> None:
        """Stop using the magnetometer: motion has shown that its heading at the start was wrong by ``error`` [rad]."""
        self._check = CompassCheck(is_rejected=True)  # the old one compared with the wrong heading
        self._offset = math.nan
        text = (
            f"the magnetic heading at the start was wrong by {math.degrees(abs(error)):.0f} deg, as motion shows: "
            f"aligned again; likely cause: {single_cause(error)}; the magnetometer is not used, {CURE}"
        )
        self._journal.say(stamp_ns, WRONG_START, Level.WARN, text, error_deg=math.degrees(error))

    def compare_anew(self) -> None:
        """Start the comparison again, because it was made with a wrong heading. A rejected magnetometer stays out."""
        self._check, self._offset = CompassCheck(self._check.is_rejected), math.nan

    @property
    def offset(self) -> float:
        """Learned error of a magnetic heading [rad]; NaN where the magnetometer must not be used."""
        return math.nan if self._check.doubted else self._offset

    def begin_with(self, offset: float) -> None:
        """Start with the ``offset`` [rad] learned before a restart."""
        self._offset, self._since = offset, -_OFFSET_MEMORY

    def learn(self, o: Observation, error: float, q: Sequence[float]) -> None:
        """Learn the offset from the ``error`` [rad] of a magnetic heading against the filter's attitude ``q`` (4,)."""
        self._compare(o, q, error)
        if math.isnan(self._offset):
            self._offset, self._since = error, o.t
        share = max(self._period, _SHORTEST_PERIOD) / min(max(o.t - self._since, 1.0), _OFFSET_MEMORY)
        nearer = self._offset + min(share, 1.0) * math.remainder(error - self._offset, 2.0 * math.pi)
        self._offset = math.remainder(nearer, 2.0 * math.pi)

    def _compare(self, o: Observation, q: Sequence[float], error: float) -> None:
        deviation = 0.0 if math.isnan(self._offset) else math.remainder(error - self._offset, 2.0 * math.pi)
        field, to_body = level_field(*q, *o.measured)
        magnetic_north = cmath.rect(1.0, 0.5 * math.pi - self.declination)
        offset = error if math.isnan(self._offset) else self._offset
        name, text = self._check.add(
            magnetic_north * to_body,
            field,
            offset,
            deviation,
            max(self._period, _SHORTEST_PERIOD),
        )
        if name:
            level = Level.INFO if name == "mag.heading.agrees" else Level.WARN
            self._journal.say(o.stamp_ns, name, level, text)

    def figures(self) -> dict[str, float]:
        """Status: RMS of the magnetic heading about its mean error [deg] while GNSS shows the heading."""
        return {"mag.heading_spread_deg": math.degrees(self._check.spread)}

    def linearise(self, o: Observation, f: FilterView) -> Linearised:
        """One row, phi_z; the tilt's variance adds to the noise, since a tilt error projects the vertical field."""
        assert o.decision is not None
        tilt_variance = f.P[PHI, PHI] + f.P[PHI + 1, PHI + 1]
        z, H = measurements.magnetic_heading(f.nav, len(f.P), *o.measured, self.declination + o.decision.reference)
        return z, H, np.array([[self._variance + 4.0 * tilt_variance]])


@kernel
def level_field(w, x, y, z, bx, by, bz):
    """Horizontal part x + iy of a field in level body axes, and the factor from n to them, at attitude (w, x, y, z)."""
    q = (w, x, y, z)
    east, north, _ = q_rotate(q, (bx, by, bz))
    yaw = -yaw_of(q)
    to_body = complex(math.cos(yaw), math.sin(yaw))
    return complex(east, north) * to_body, to_body
