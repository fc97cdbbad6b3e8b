"""Heights from pressure: barometer with a reference learned while GNSS is good, and depth sensor under water."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from nav_pose_estimator.core.earth.atmosphere import height_pressure, pressure_height, water_height
from nav_pose_estimator.core.earth.ellipsoid import gravity
from nav_pose_estimator.core.filter import measurements
from nav_pose_estimator.core.filter.blocks import DEPTH, Block, GaussMarkov
from nav_pose_estimator.core.filter.kalman import REJECTED
from nav_pose_estimator.core.filter.layout import ALT, DPOS, LAT
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.observation import GATED, LEFT_OUT, Decision, FilterView, Kind, Observation, Use
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import PressureSample, WaterPressure
from nav_pose_estimator.engine.sensors.aiding import Aiding
from nav_pose_estimator.engine.sensors.frozen import FROZEN, Frozen
from nav_pose_estimator.engine.sensors.sensor import Aid, Linearised, Pacer, shared_error
from nav_pose_estimator.engine.solutions import Level

_LOWEST, _HIGHEST = 1_000.0, 120_000.0  # Pa: range of valid air pressures, from 31 km up to below any place on Earth
_THICK = 30_000.0  # Pa: pressure at 9 km; a lower one does not identify a unit
FAR = 2_500.0
"""m: difference of barometric and GNSS height that is too large for weather and geoid."""
_NEAR = 1_200.0  # m: difference that weather and geoid may cause
_ANY_LAKE = 5e3  # m: initial standard deviation of the height of the water surface
_OF_A_FIX = 0.5  # fraction of the standard deviation of a fix that does not average out
_HIGH = 3000.0  # m: above this height a pressure in another unit is less likely than an altitude
_THIN, _DEEPEST = 50_000.0, 1.2e8  # Pa: range of valid absolute pressures, from a mountain lake to below any sea bed
_UNITS = {"hPa": 100.0, "kPa": 1e3, "bar": 1e5, "mmHg": 133.322, "inHg": 3386.39, "psi": 6894.76}  # Pa
VAGUE = 20.0
"""m: a reference height with a larger standard deviation is not from GNSS."""
_UP = DPOS + 2
_APART = 25.0  # m: deviation from its reference above which the barometer contradicts GNSS
_APART_TIME = 5.0  # s for which it has to last
_SHORTEST_PERIOD = 0.01  # s: floor of the period with which the offset is learned
_NEWEST = 0.2  # weight of the newest innovation in the running mean without GNSS
_STRAYS = 1.2  # deviations of a height above which that mean shows that barometer or filter is wrong ...
_EITHER = 1.5  # ... and standard deviation of the height then, relative to the largest mean
_MOVED = 0.5  # ... and relative to the distance by which it has moved the height against the IMU


def standard_height(pressure: float) -> float:
    """Pressure altitude [m] of ``pressure`` [Pa]; NaN outside the range of heights in which vehicles fly."""
    return pressure_height(pressure) if _THICK < pressure < _HIGHEST else math.nan


def likely_unit(pressure: float, height: float = math.nan) -> str:
    """Unit other than pascal in which ``pressure`` matches ``height`` [m] (NaN: any height); empty without one."""
    for unit, factor in _UNITS.items():
        found = standard_height(pressure * factor)
        if abs(found - height) < _NEAR or (math.isnan(height) and math.isfinite(found)):
            return unit
    return ""


class Barometer(Aid):
    """Barometric height: pressure altitude less its offset from the GNSS height, learned while GNSS is good."""

    kind = Kind("height", quiet=True)
    sample, family = PressureSample, "baro"
    vertical_only = True

    def __init__(self, parameters: Parameters, aiding: Aiding, journal: Journal) -> None:
        super().__init__(parameters, aiding, journal)
        self._pacer = Pacer()
        self._offset = math.nan  # m: barometric minus filter height
        self._since = 0.0
        self.pressure = math.nan  # Pa, the last good one
        self.offset_variance = 0.0
        """m^2: variance of the filter's height at the last comparison."""
        self._unit_reported = False
        self._apart_since = math.inf
        self._contradicts, self._apart = False, 0.0  # m above its reference, at the last height
        self._frozen, self._lasting = Frozen(), 0.0
        self._moved = 0.0  # m: sum of its corrections of the height since GNSS was good
        self.least_sd = 0.0
        """m: floor of the height's standard deviation until GNSS is good."""

    def set_parameters(self, parameters: Parameters) -> None:
        """New noise, period and time constant."""
        aids = parameters.aids
        self._enabled, self._period, self._tau = aids.barometer, aids.barometer_period, aids.barometer_tau
        self._sd = aids.barometer_sd
        self._R = np.array([[aids.barometer_sd**2 * shared_error(aids.barometer_period)]])

    def observe(self, sample: PressureSample, t: float) -> Observation | None:
        """A pressure [Pa], at most every ``aids.barometer_period``."""
        height = pressure_height(sample.pressure) if _LOWEST < sample.pressure < _HIGHEST else math.nan
        is_valid = not math.isnan(height)
        if is_valid:
            self.pressure = sample.pressure
            was = self._frozen.verdict
            self._frozen.note(t, height)
            if self._frozen.verdict != was:
                self._report_frozen(sample, was == FROZEN)
        if not self._enabled or self._frozen.verdict or not self._pacer.passes(t, self._period):
            return None
        if not is_valid:
            unit = likely_unit(sample.pressure)
            guess = f"looks like {unit}" if unit else "which it cannot be: the driver may not fill it"
            if unit and standard_height(sample.pressure * _UNITS[unit]) > _HIGH:
                guess += ", or a height in metres"
            return self._refuse_unit(sample.stamp_ns, sample.pressure, guess)
        return Observation(t, sample.stamp_ns, self.kind, height)

    def decide(self, o: Observation, f: FilterView) -> Decision:
        """Learn the reference while GNSS is good; without GNSS use it."""
        height = float(f.nav[ALT])
        if self._aiding.gnss_is_good(o.t) and self._aiding.height_is_good(o.t):
            if abs(o.measured - height) < FAR:
                self.learn(o, height, float(f.P[_UP, _UP]))
            else:
                pressure = height_pressure(o.measured)
                unit = likely_unit(pressure, height)
                guess = f"looks like {unit}" if unit else "no unit fits the height of GNSS"
                self._refuse_unit(o.stamp_ns, pressure, guess)
            return LEFT_OUT
        if self._contradicts or not math.isfinite(self._offset):
            return LEFT_OUT
        return Decision(Use.GATED, self._offset, least_sd=(0.0, self.least_sd, 0.0))

    def note(self, o: Observation, f: FilterView, z: np.ndarray, status: int, nis: float) -> None:
        """Count the outcome, and update the running mean of the innovation [m], estimate minus measurement.

        A large mean stays as a doubt about the height: the filter follows the barometer, which may be wrong, and may go
        on drifting.
        """
        innovation = float(z[0])
        self._lasting += _NEWEST * (innovation - self._lasting)
        if status != REJECTED and nis > 0.0:
            self._moved -= innovation - float(self._R[0, 0]) * nis / innovation  # the gain is 1 - R / S, nis = z^2 / S
        if abs(self._lasting) > _STRAYS * self._sd:
            self.least_sd = max(self.least_sd, _EITHER * abs(self._lasting))
        if self.least_sd > 0.0:
            self.least_sd = max(self.least_sd, _MOVED * abs(self._moved))
        super().note(o, f, z, status, nis)

    @property
    def contradiction(self) -> str:
        """Why the height is less certain than usual, one clause for the user; empty where it is not."""
        if not self._contradicts:
            return ""
        return f"barometer and GNSS have come {abs(self._apart):.0f} m apart in height: one of them is wrong"

    @property
    def offset(self) -> float:
        """Barometric minus GNSS height [m] as learned; NaN where the barometer must not be used."""
        return math.nan if self._contradicts else self._offset

    @property
    def is_vague(self) -> bool:
        """Whether the height of the last comparison was not from GNSS."""
        return self.offset_variance > VAGUE**2

    def begin_with(self, offset: float, variance: float, least_sd: float) -> None:
        """Start with the ``offset`` [m], ``offset_variance`` [m^2] and ``least_sd`` [m] from before a restart."""
        self._offset, self._since, self.offset_variance = offset, -self._tau, variance
        self.least_sd = least_sd

    def _report_frozen(self, sample: PressureSample, was_frozen: bool) -> None:
        """Events of the begin and end of a frozen barometer: it repeats a value for longer than ever before."""
        is_frozen = self._frozen.verdict == FROZEN
        if is_frozen and not was_frozen:
            text = (
                f"barometer not used: it repeats {sample.pressure:.2f} Pa exactly, which it did not do before: frozen"
            )
            self._journal.say(sample.stamp_ns, "baro.frozen", Level.WARN, text)
        elif was_frozen and not is_frozen:
            self._journal.say(sample.stamp_ns, "baro.frozen.ended", Level.INFO, "the barometer's values change again")

    def _refuse_unit(self, stamp_ns: int, pressure: float, guess: str) -> None:
        """Count a pressure that is not in pascal; the first one gives an event with a ``guess`` why."""
        if self._unit_reported:
            self._journal.count("baro.rejected.unit")
            return
        self._unit_reported = True
        text = f"barometer not used: its value is {pressure:.5g}; pascal expected, {guess}"
        self._journal.say(stamp_ns, "baro.rejected.unit", Level.ERROR, text)

    def _watch(self, o: Observation, apart: float) -> None:
        """Events of the begin and end of a contradiction: ``apart`` [m] from its reference for some seconds."""
        self._apart = apart
        self._apart_since = min(self._apart_since, o.t) if abs(apart) > _APART else math.inf
        contradicts = o.t - self._apart_since > _APART_TIME
        if contradicts and not self._contradicts:
            text = f"barometer not used: it has drifted {apart:+.0f} m from GNSS heights (port blocked, prop wash?)"
            self._journal.say(o.stamp_ns, "baro.contradicts", Level.WARN, text)
        elif self._contradicts and not contradicts:
            self._journal.say(o.stamp_ns, "baro.contradicts.ended", Level.INFO, "barometer and GNSS heights agree")
        self._contradicts = contradicts

    def learn(self, o: Observation, height: float, variance: float) -> None:
        """Learn the offset from ``o`` and the filter's ``height`` [m] of ``variance`` [m^2] while GNSS is good."""
        self.offset_variance, self._lasting, self._moved, self.least_sd = variance, 0.0, 0.0, 0.0
        difference = o.measured - height
        if math.isfinite(self._offset):
            self._watch(o, difference - self._offset)
        if math.isnan(self._offset):
            self._offset, self._since = difference, o.t
        period = max(self._period, _SHORTEST_PERIOD)
        share = period / min(max(o.t - self._since, period), self._tau)
        self._offset += min(share, 1.0) * (difference - self._offset)

    def settle(self, o: Observation, f: FilterView) -> None:
        """Floor of the height's variance: repeated heights cannot be better than the reference they are based on."""
        if self.is_vague:
            f.P[_UP, _UP] = max(f.P[_UP, _UP], self.offset_variance)

    def linearise(self, o: Observation, f: FilterView) -> Linearised:
        """One row, the height."""
        assert o.decision is not None
        return *measurements.height(f.nav, len(f.P), o.measured - o.decision.reference), self._R


class DepthSensor(Aid):
    """Height of an underwater vehicle from water pressure.

    The height of the water surface is a state. It is observable while the vehicle is at the surface with GNSS, and is a
    random walk because of tide and weather.
    """

    kind = Kind("depth", quiet=True)
    sample, family = WaterPressure, "depth"
    blocks: ClassVar[dict[Block, GaussMarkov]] = {DEPTH: GaussMarkov(walk=2e-3)}

    def __init__(self, parameters: Parameters, aiding: Aiding, journal: Journal) -> None:
        super().__init__(parameters, aiding, journal)
        self._pacer = Pacer()
        self._unit_reported = False

    def set_parameters(self, parameters: Parameters) -> None:
        """New noise."""
        aids = parameters.aids
        self._density, self._period = aids.water_density, aids.barometer_period
        self._R = np.array([[aids.depth_sd**2 * shared_error(self._period)]])
        self._surface_sd = _OF_A_FIX * parameters.gnss.vertical_sd
        self.first_sd = {DEPTH: _ANY_LAKE}

    def observe(self, sample: WaterPressure, t: float) -> Observation | None:
        """An absolute pressure [Pa], at most every ``aids.barometer_period``."""
        if not self._pacer.passes(t, self._period):
            return None
        if not _THIN < sample.pressure < _DEEPEST:
            if self._unit_reported:
                return self._refuse()
            self._unit_reported = True
            text = f"water pressure not used: {sample.pressure:.5g} is not an absolute pressure in pascal"
            return self._journal.say(sample.stamp_ns, "depth.rejected.value", Level.WARN, text)
        return Observation(t, sample.stamp_ns, self.kind, sample.pressure)

    def decide(self, o: Observation, f: FilterView) -> Decision:
        """Gate it; without GNSS, with the lasting error of fixes as a floor of the surface's deviation."""
        if self._aiding.gnss_is_good(o.t):
            return GATED
        return Decision(Use.GATED, reference=self._surface_sd)

    def settle(self, o: Observation, f: FilterView) -> None:
        """Floor of the height's variance: height and surface have a common error, which GNSS has left.

        It is added to both with full correlation, so that pressure still observes changes of height and the vertical
        velocity.
        """
        if o.decision is None or not o.decision.reference > 0.0:
            return
        missing, surface = o.decision.reference**2 - float(f.P[_UP, _UP]), DEPTH.states(f.constants).start
        if missing > 0.0:
            f.P[_UP, _UP] += missing
            f.P[surface, surface] += missing
            f.P[_UP, surface] -= missing  # negative: one error is estimate minus truth, the other truth minus estimate
            f.P[surface, _UP] -= missing

    def linearise(self, o: Observation, f: FilterView) -> Linearised:
        """One row: the height less that of the surface."""
        height = water_height(o.measured, self._density, gravity(f.nav[LAT], f.nav[ALT]))
        return *measurements.height_in_water(f.nav, len(f.P), DEPTH.states(f.constants).start, height), self._R
