"""What the flight so far says of the motion in an outage, as evidence for the filter.

``MotionKnowledge`` is made when GNSS is lost, from data before the loss only; from then on it turns every half second
of the navigator's own solution into a ``MotionEvidence``. Methods that the benchmark compares differ only here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.air_velocity import AirVelocityModel
from nav_pose_estimator.core.motion.regimes import MotionRegimes, learn_regimes
from nav_pose_estimator.core.motion.wind import WIND_TIME
from nav_pose_estimator.engine.samples import Hypothesis, MotionEvidence, Vector3, VelocityError

_TRAVEL_TIME, _HOVER_TIME = 2.0, 2.0  # s over which the velocity of a regime counts as one draw
_DWELL = 10.0  # s: how long a regime lasts, on average
_RECENT = 30.0  # s whose mean square speed the velocity prior expects
_SLOWEST = 0.05  # m/s
_FRESH = 1.0  # s: an older prediction from outside is not used
BEST, PRIOR = "best", "velocity_prior"


@dataclass(frozen=True)
class Prediction:
    """Velocity through the air in b (3,) [m/s] with its noise of one second, travelling and hovering [m^2/s^2]."""

    air_velocity: np.ndarray
    noise: np.ndarray
    hover_noise: np.ndarray


@dataclass(frozen=True)
class MotionKnowledge:
    """Regimes and network as they were when GNSS was lost. ``recent_square``: mean square speed of the last 30 s."""

    method: str
    regimes: MotionRegimes
    recent_square: float
    model: AirVelocityModel | None
    drift_variance: float = 1.0

    @classmethod
    def of(
        cls, method: str, epochs: np.ndarray, model: AirVelocityModel | None, drift_variance: float = 1.0
    ) -> MotionKnowledge:
        """From the aided epochs (N, COLUMNS) of the window before the outage, N > 0."""
        newest = epochs[-1, me.TIME]
        recent = epochs[epochs[:, me.TIME] > newest - _RECENT, me.VELOCITY : me.VELOCITY + 2]
        return cls(method, learn_regimes(epochs), float(np.square(recent).sum(axis=1).mean()), model, drift_variance)

    def evidence(
        self, stamp_ns: int, recent: np.ndarray, external: VelocityError | None = None
    ) -> tuple[MotionEvidence | None, VelocityError | None]:
        """What the newest of the ``recent`` epochs says, and the velocity error that the network sees in it.

        ``external`` is a prediction of another process, used where there is no model here.
        """
        newest = recent[-1]
        prediction = self._predict(newest)
        error = None if prediction is None else self._velocity_error(stamp_ns, newest, prediction)
        if prediction is None and external is not None and abs(external.stamp_ns - stamp_ns) < _FRESH * 1e9:
            prediction = self._from_outside(newest, external)
        hypotheses = self._hypotheses(recent, prediction)
        if not hypotheses:
            return None, error
        evidence = MotionEvidence(
            stamp_ns=stamp_ns,
            interval=me.PERIOD,
            attitude=np.ascontiguousarray(me.attitude(newest[None])[0]),
            velocity=vector3(newest[me.VELOCITY : me.FORCE]),
            body_velocity=vector3(newest[me.BODY_VELOCITY : me.VELOCITY]),
            air_velocity=None if prediction is None else vector3(prediction.air_velocity),
            hypotheses=hypotheses,
            dwell=_DWELL,
            wind_tau=WIND_TIME,
            drift_variance=self.drift_variance,
            **self._wind(),
        )
        return evidence, error

    def _predict(self, newest: np.ndarray) -> Prediction | None:
        if self.model is None:
            return None
        air_velocity, strange = self.model.predict(newest)
        return Prediction(air_velocity, strange * self.model.noise, strange * self.model.hover_noise)

    def _velocity_error(self, stamp_ns: int, newest: np.ndarray, prediction: Prediction) -> VelocityError:
        """Estimate minus prediction, in n: what the source text calls the increment of the position error."""
        assert self.model is not None
        C = me.attitude(newest[None])[0]
        wind = np.append(self.model.wind_mean + self.model.wind, 0.0)
        dv = newest[me.VELOCITY : me.FORCE] - C @ prediction.air_velocity - wind
        cov = C @ np.diag(prediction.noise) @ C.T
        cov[:2, :2] += self.model.wind_spread * np.eye(2)
        return VelocityError(stamp_ns, vector3(dv), cov)

    def _from_outside(self, newest: np.ndarray, external: VelocityError) -> Prediction:
        C = me.attitude(newest[None])[0]
        velocity = C.T @ (newest[me.VELOCITY : me.FORCE] - np.array(external.dv_n))
        noise = np.diag(C.T @ external.cov @ C)
        return Prediction(velocity, noise, noise + self.regimes.travel_var + 1.0)

    def _hypotheses(self, recent: np.ndarray, prediction: Prediction | None) -> tuple[Hypothesis, ...]:
        per_epoch = 1.0 / me.PERIOD
        noise = None if prediction is None else vector3(prediction.noise * per_epoch)
        if self.method == PRIOR:
            return (Hypothesis("travel", 1.0, max(0.5 * self.recent_square, _SLOWEST**2), None),)
        # a car at constant speed is as calm as one that has stopped: of a guided vehicle only its nose tells
        if self.method != BEST or (self.model is not None and self.model.is_guided):
            return () if prediction is None else (Hypothesis("travel", 1.0, None, noise),)
        regimes = self.regimes
        active = float(me.activity(recent)[-1])
        travel = Hypothesis(
            name="travel",
            probability=1.0 - regimes.hover_probability if regimes.can_hover else 1.0,
            velocity_var=regimes.travel_var,
            air_noise=noise,
            log_likelihood=_log_density(active, regimes.travel_activity),
            # the network knows more of a travelling vehicle than its mean speed
            velocity_time=_TRAVEL_TIME if prediction is None else None,
        )
        if not regimes.can_hover:
            return () if prediction is None else (travel,)
        hover = Hypothesis(
            name="hover",
            probability=regimes.hover_probability,
            velocity_var=regimes.hover_var,
            air_noise=None if prediction is None else vector3(prediction.hover_noise * per_epoch),
            log_likelihood=_log_density(active, regimes.hover_activity),
            velocity_time=_HOVER_TIME,
        )
        return travel, hover

    def _wind(self) -> dict:
        if self.model is None:
            return {}
        mean, wind = self.model.wind_mean, self.model.wind_mean + self.model.wind
        return {
            "wind": (float(wind[0]), float(wind[1])),
            "wind_mean": (float(mean[0]), float(mean[1])),
            "wind_cov": self.model.wind_cov,
            "wind_spread": self.model.wind_spread,
        }


def _log_density(value: float, moments: tuple[float, float]) -> float:
    mean, variance = moments
    return -0.5 * ((value - mean) ** 2 / variance + math.log(variance))


def vector3(values: np.ndarray) -> Vector3:
    """Three numbers as a tuple."""
    x, y, z = values.tolist()
    return x, y, z
