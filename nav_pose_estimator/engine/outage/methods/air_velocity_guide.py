"""What a predicted velocity through the air says about the motion in an outage, as evidence for the filter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.air_velocity import AirVelocityModel
from nav_pose_estimator.core.motion.wind import WIND_TIME
from nav_pose_estimator.engine.outage.methods.method import Advice, Array
from nav_pose_estimator.engine.samples import Hypothesis, MotionEvidence, Vector3, VelocityError

TRAVEL, HOVER = "travel", "hover"
_DWELL = 10.0  # s: how long a regime lasts, on average
_FRESH = 1.0  # s: an older prediction from outside is not used


@dataclass(frozen=True)
class AirPrediction:
    """Velocity through the air in b (3,) [m/s] with the variance of a mean over one second, travelling and hovering.

    ``noise``, ``hover_noise`` (3,) [m^2/s^2]; None where hovering was not distinguished.
    """

    air_velocity: Array
    noise: Array
    hover_noise: Array | None = None


@dataclass(frozen=True)
class AirVelocityGuide:
    """A network as it was when GNSS was lost; without one, what another process predicts.

    ``spread_psd`` [m^2/s]: of each horizontal component, what the stated position has lacked in rehearsals.
    ``is_usual``: the model is what is usual, not of this flight; a network of another process knows more.
    """

    model: AirVelocityModel | None
    drift_variance: float = 1.0
    spread_psd: float = 0.0
    is_usual: bool = False

    def hypotheses(self, recent: Array, prediction: AirPrediction | None) -> tuple[Hypothesis, ...]:
        """What the vehicle may be doing by the ``recent`` epochs; empty where nothing can be said."""
        return () if prediction is None else (travelling(prediction, self.spread_psd),)

    def advise(self, stamp_ns: int, recent: Array, external: VelocityError | None = None) -> Advice:
        """The evidence of the newest epoch, and the velocity error that the network of this process sees in it."""
        newest, prediction, error = recent[-1], None, None
        is_fresh = external is not None and abs(external.stamp_ns - stamp_ns) < _FRESH * 1e9
        model = None if self.is_usual and is_fresh else self.model
        if model is not None:
            prediction = _predict(model, newest)
            error = _velocity_error(model, stamp_ns, newest, prediction)
        elif external is not None and is_fresh:
            prediction = _from_outside(newest, external)
        hypotheses = self.hypotheses(recent, prediction)
        if not hypotheses:
            return Advice((), error)
        return Advice((motion_evidence(stamp_ns, newest, hypotheses, self.drift_variance, prediction, model),), error)


def travelling(prediction: AirPrediction, spread_psd: float = 0.0) -> Hypothesis:
    """The vehicle goes as the network says; nothing is expected of its speed."""
    return Hypothesis(TRAVEL, 1.0, None, per_epoch(prediction.noise), doubt_psd=spread_psd)


def per_epoch(noise: Array) -> Vector3:
    """Variances (3,) of a mean over one second as those of an epoch."""
    return vector3(noise * (1.0 / me.PERIOD))


def motion_evidence(
    stamp_ns: int,
    newest: Array,
    hypotheses: tuple[Hypothesis, ...],
    drift_variance: float,
    prediction: AirPrediction | None = None,
    model: AirVelocityModel | None = None,
) -> MotionEvidence:
    """Evidence from the ``newest`` epoch (COLUMNS,); the wind is that of the ``model``."""
    return MotionEvidence(
        stamp_ns=stamp_ns,
        interval=me.PERIOD,
        attitude=np.ascontiguousarray(me.attitude(newest[None])[0]),
        velocity=vector3(newest[me.VELOCITY : me.FORCE]),
        body_velocity=vector3(newest[me.BODY_VELOCITY : me.VELOCITY]),
        air_velocity=None if prediction is None else vector3(prediction.air_velocity),
        hypotheses=hypotheses,
        dwell=_DWELL,
        wind_tau=WIND_TIME,
        drift_variance=drift_variance,
        **_wind(model),
    )


def vector3(values: Array) -> Vector3:
    """Three numbers as a tuple."""
    x, y, z = values.tolist()
    return x, y, z


def _predict(model: AirVelocityModel, newest: Array) -> AirPrediction:
    air_velocity, strange = model.predict(newest)
    return AirPrediction(air_velocity, strange * model.noise, strange * model.hover_noise)


def _velocity_error(model: AirVelocityModel, stamp_ns: int, newest: Array, prediction: AirPrediction) -> VelocityError:
    """Estimate minus prediction, in n: what CN113777645A (claim 3) calls the increment of the position error."""
    C = me.attitude(newest[None])[0]
    wind = np.append(model.wind_mean + model.wind, 0.0)
    dv = newest[me.VELOCITY : me.FORCE] - C @ prediction.air_velocity - wind
    cov = C @ np.diag(prediction.noise) @ C.T
    cov[:2, :2] += model.wind_spread * np.eye(2)
    return VelocityError(stamp_ns, vector3(dv), cov)


def _from_outside(newest: Array, external: VelocityError) -> AirPrediction:
    C = me.attitude(newest[None])[0]
    velocity = C.T @ (newest[me.VELOCITY : me.FORCE] - np.array(external.dv_n))
    return AirPrediction(velocity, np.diag(C.T @ external.cov @ C))


def _wind(model: AirVelocityModel | None) -> dict:
    if model is None:
        return {}
    mean, wind = model.wind_mean, model.wind_mean + model.wind
    return {
        "wind": (float(wind[0]), float(wind[1])),
        "wind_mean": (float(mean[0]), float(mean[1])),
        "wind_cov": model.wind_cov,
        "wind_spread": model.wind_spread,
    }
