"""Adapters between the sensors and the kernels of routine flight (``core.routine``), one for each kind of observation.

An adapter writes the settings and values that the kernels need, and hands their result to the sensor. This changes the
sensor exactly as ``decide``, ``note`` and ``settle`` would have done.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import ClassVar, Protocol

from nav_pose_estimator.core.gnss import doubt, height_reference, slow_height
from nav_pose_estimator.core.gnss.reacquisition import Fix
from nav_pose_estimator.core.routine import table
from nav_pose_estimator.engine.observation import GATED, LEFT_OUT, Decision, Observation, Use
from nav_pose_estimator.engine.sensors import barometer, magnetometer
from nav_pose_estimator.engine.sensors.aiding import Aiding
from nav_pose_estimator.engine.sensors.barometer import Barometer
from nav_pose_estimator.engine.sensors.gnss.lasting_error import whole_variance
from nav_pose_estimator.engine.sensors.gnss.position import CHANCE, GnssPositionSensor, local
from nav_pose_estimator.engine.sensors.gnss.receiver import Gnss
from nav_pose_estimator.engine.sensors.gnss.velocity import GnssVelocitySensor, rows_of
from nav_pose_estimator.engine.sensors.magnetometer import Magnetometer
from nav_pose_estimator.engine.sensors.sensor import Aid

_NO_NOISE = [0.0] * (table.EVENT_COLUMNS - table.EVENT_NOISE)
_VALUES = slice(table.RESULT_Z, table.RESULT_Z + 3)
_INNOVATION = slice(table.RESULT_INNOVATION, table.RESULT_INNOVATION + 3)


class RoutineKind(Protocol):
    """The adapter of one kind of observation."""

    number: ClassVar[int]
    """Its number in ``core.routine.table``."""

    def prepare(self, settings: list[float], t: float) -> bool:
        """Write what the kernel has to know from ``t`` [s] on; False while the sensor has to decide itself."""

    def values(self, o: Observation) -> list[float]:
        """Event of ``o``: number of rows, value (3,) and noise covariance (9,), row-major."""

    def again(self, o: Observation) -> int:
        """Number with which ``o``, which has a decision, acts again in a replay; ``table.UNUSUAL`` if it cannot."""

    def done(self, o: Observation, result: list[float], period: float | None) -> None:
        """Take the ``result`` of ``o``, which acted when fixes came every ``period`` [s]; None: the present period."""


class RoutineVelocity:
    """GNSS velocities, used with their stated noise."""

    number: ClassVar[int] = table.VELOCITY

    def __init__(self, sensor: GnssVelocitySensor) -> None:
        self._sensor = sensor

    def prepare(self, settings: list[float], t: float) -> bool:
        """While the noise is what is stated."""
        settings[table.LEVER : table.DOUBTFUL] = self._sensor.lever.tolist()
        return not self._sensor.noise.learns

    def values(self, o: Observation) -> list[float]:
        """Two or three rows, with the stated noise."""
        assert o.stated_R is not None
        return [rows_of(o), *o.measured, *o.stated_R.ravel().tolist(), 0.0]

    def again(self, o: Observation) -> int:
        """Behind the gate, or left out as before."""
        return table.UNUSUAL if self._sensor.noise.learns else _gnss_again(o, table.SAME_VELOCITY)

    def done(self, o: Observation, result: list[float], period: float | None) -> None:
        """Record the innovation of a velocity that was used."""
        o.decision = GATED
        period = period or self._sensor.reception.fix_period
        self._sensor.agrees(o, result[table.RESULT_NIS], result[_INNOVATION], result[_VALUES], period)


class RoutinePosition:
    """GNSS positions that agree with the filter."""

    number: ClassVar[int] = table.POSITION

    def __init__(self, sensor: GnssPositionSensor, aiding: Aiding) -> None:
        self._sensor, self._aiding = sensor, aiding
        self._decision = GATED  # the last decision, kept because it rarely changes

    def prepare(self, settings: list[float], t: float) -> bool:
        """While neither the guard nor the doubts have anything to say."""
        sensor, guard = self._sensor, self._sensor.guard.settings
        heights = sensor.heights
        settings[table.LEVER : table.DOUBTFUL] = sensor.lever.tolist()
        settings[table.RETURN_AFTER], settings[table.SIGMAS] = guard.loss_time, guard.sigmas
        settings[table.DOUBTFUL] = doubt.OFF
        settings[table.HEIGHT_STEP : table.BARO_APART] = height_reference.STEP, height_reference.PAUSE, *heights.last
        settings[table.LEAST_HEIGHT_SD] = slow_height.lasting_sd(sensor.vertical_sd)
        settings[table.HEIGHT_MEAN_T : table.SETTINGS_SIZE] = sensor.slow_height.last, sensor.slow_height.mean
        state = sensor.guard.state
        return (
            not (
                sensor.noise.learns
                or sensor.pull.is_on
                or sensor.monitors.is_on
                or sensor.failure
                or state.tracks
                or state.loose
            )
            and sensor.velocity.doubt.is_calm
            and heights.is_calm(t)
            and sensor.jump.is_over(t)
        )

    def values(self, o: Observation) -> list[float]:
        """Three rows, or two where the height was left out. A height of NaN fails every test of the kernel."""
        assert o.stated_R is not None
        lat, lon, alt = o.measured
        height = alt - (self._sensor.heights.shift if o.decision is None else o.decision.reference)
        known = o.decision is None or math.isfinite(height)
        least = 0.0 if o.decision is None else o.decision.least_sd[1]
        return [3.0 if known else 2.0, lat, lon, height if known else 0.0, *o.stated_R.ravel().tolist(), least]

    def again(self, o: Observation) -> int:
        """Behind the gate, or left out as before."""
        return table.UNUSUAL if self._sensor.noise.learns else _gnss_again(o, table.SAME_POSITION)

    def done(self, o: Observation, result: list[float], period: float | None) -> None:
        """Record a fix that agreed with the filter, and pass it to the monitors."""
        assert o.stated_R is not None
        sensor, t, z = self._sensor, o.t, result[_VALUES]
        reference = sensor.heights.shift
        sensor.velocity.doubt.agrees()
        sensor.heights.agrees(t, -z[2])
        sensor.slow_height.note(t, -z[2])
        sensor.monitors.fix(z[0], z[1], o.stamp_ns)
        place = local(o.measured, reference, math.nan, sensor.origin)
        east, north, up = map(math.sqrt, whole_variance(o.stated_R, sensor.reception.lasting).tolist())
        sd = max(east, north)
        own_sd = max(result[table.RESULT_SD : table.RESULT_SD + 2])
        sensor.gate_radius = sensor.guard.settings.sigmas * math.hypot(sd, own_sd)
        sensor.guard.expected(Fix(t, place, (east, north, up)), max(t - self._aiding.fix_used, 0.0))
        velocity = sensor.velocity.misfit_at(t)
        sensor.monitors.used(o, place, None if velocity is None else velocity.velocity, CHANCE * sd)
        sensor.record.add(result[table.RESULT_NIS], z, period or sensor.reception.fix_period)
        sensor.reception.use(t, with_height=True)
        self._decision = o.decision = _gated(reference, result[table.RESULT_LEAST], self._decision)


class RoutineHeight:
    """Barometric heights, which are only compared with GNSS while that is good."""

    number: ClassVar[int] = table.HEIGHT

    def __init__(self, sensor: Barometer) -> None:
        self._sensor = sensor

    def prepare(self, settings: list[float], t: float) -> bool:
        """They correct nothing."""
        settings[table.BARO_APART], settings[table.VAGUE_VAR] = barometer.FAR, barometer.VAGUE**2
        return True

    def values(self, o: Observation) -> list[float]:
        """The height."""
        return [1.0, o.measured, 0.0, 0.0, *_NO_NOISE]

    def again(self, o: Observation) -> int:
        """Left out as before."""
        return table.UNUSUAL if self._sensor.is_vague else _nothing_again(o)

    def done(self, o: Observation, result: list[float], period: float | None) -> None:
        """Compare the height with that of the filter."""
        o.decision = LEFT_OUT
        self._sensor.learn(o, result[table.RESULT_HEIGHT], result[table.RESULT_VARIANCE])


class RoutineHeading:
    """Magnetic headings, which are only compared with that of the filter while GNSS is good."""

    number: ClassVar[int] = table.HEADING

    def __init__(self, sensor: Magnetometer) -> None:
        self._sensor = sensor

    def prepare(self, settings: list[float], t: float) -> bool:
        """They correct nothing."""
        settings[table.HEADING_SD] = magnetometer.KNOWN_HEADING
        settings[table.DECLINATION] = self._sensor.declination
        return True

    def values(self, o: Observation) -> list[float]:
        """The field in b."""
        return [1.0, *o.measured, *_NO_NOISE]

    def again(self, o: Observation) -> int:
        """Left out as before."""
        return _nothing_again(o)

    def done(self, o: Observation, result: list[float], period: float | None) -> None:
        """Compare the heading with that of the filter."""
        o.decision = LEFT_OUT
        self._sensor.learn(o, result[table.RESULT_ERROR], result[table.RESULT_QUAT : table.RESULT_QUAT + 4])


def _gated(reference: float, least: float, before: Decision) -> Decision:
    """The decision to use a fix behind the gate, minus ``reference`` [m], with a height deviation of at least ``least``
    [m]; ``before`` if that is the same."""
    if before.reference == reference and before.least_sd[1] == least:
        return before
    return Decision(Use.GATED, reference, least_sd=(0.0, least, 0.0))


def _gnss_again(o: Observation, gated: int) -> int:
    d = o.decision
    if d is None or d.widening != 1.0 or d.least_sd[0] or d.least_sd[2]:
        return table.UNUSUAL
    if d.least_sd[1] and d.use is not Use.GATED:
        return table.UNUSUAL
    return {Use.GATED: gated, Use.LEFT_OUT: table.NO_GNSS}.get(d.use, table.UNUSUAL)


def _nothing_again(o: Observation) -> int:
    return table.NOTHING if o.decision is not None and o.decision.use is Use.LEFT_OUT else table.UNUSUAL


def kinds(gnss: Gnss, aids: Iterable[Aid], aiding: Aiding) -> dict[str, RoutineKind]:
    """The adapters, by the names of their observations."""
    found: dict[str, RoutineKind] = {
        gnss.velocity.kind.name: RoutineVelocity(gnss.velocity),
        gnss.position.kind.name: RoutinePosition(gnss.position, aiding),
    }
    for aid in aids:
        if isinstance(aid, Barometer):
            found[aid.kind.name] = RoutineHeight(aid)
        elif isinstance(aid, Magnetometer):
            found[aid.kind.name] = RoutineHeading(aid)
    return found
