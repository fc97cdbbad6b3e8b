"""Turns a predicted velocity through the air into evidence for the filter in an outage."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.air_velocity import AirVelocityModel
from nav_pose_estimator.core.motion.prediction_error import velocity_error
from nav_pose_estimator.core.motion.wind import WIND_TIME
from nav_pose_estimator.engine.outage.methods.method import Advice, Array
from nav_pose_estimator.engine.samples import Hypothesis, MotionEvidence, Vector3, VelocityError

TRAVEL, HOVER = "travel", "hover"
_DWELL = 10.0  # s: mean duration of a regime
_FRESH = 1.0  # s: largest age of a prediction of another process


@dataclass(frozen=True)
class AirPrediction:
    """Predicted velocity through the air in b (3,) [m/s] with its noise while travelling and while hovering.

    ``noise``, ``hover_noise`` (3,): variance of the error's one-second mean, body axes [m^2/s^2]; ``hover_noise`` is
    None where the source does not distinguish hovering.
    """

    air_velocity: Array
    noise: Array
    hover_noise: Array | None = None


@dataclass(frozen=True)
class AirVelocityGuide:
    """Evidence from a model as it was when GNSS was lost, or else from the predictions of another process.

    ``spread_psd`` [m^2/s]: spectral density that each horizontal component of the stated position lacked in rehearsals.
    ``is_usual``: the model is the population's, not of this flight; a fresh prediction of another process is preferred.
    """

    model: AirVelocityModel | None
    drift_variance: float = 1.0
    spread_psd: float = 0.0
    is_usual: bool = False

    def hypotheses(self, recent: Array, prediction: AirPrediction | None) -> tuple[Hypothesis, ...]:
        """Hypotheses on the motion from the ``recent`` epochs; empty where there is no prediction."""
        return () if prediction is None else (travelling(prediction, self.spread_psd),)

    def advise(self, stamp_ns: int, recent: Array, external: VelocityError | None = None) -> Advice:
        """The evidence of the newest epoch, and the velocity error that the model of this process predicts for it."""
        newest, prediction, predict = recent[-1], None, None
        is_fresh = external is not None and abs(external.stamp_ns - stamp_ns) < _FRESH * 1e9
        model = None if self.is_usual and is_fresh else self.model
        if model is not None:
            prediction = _predict(model, newest)
            predict = partial(_velocity_error, model, stamp_ns, newest, prediction)
        elif external is not None and is_fresh:
            prediction = _from_outside(newest, external)
        hypotheses = self.hypotheses(recent, prediction)
        if not hypotheses:
            return Advice((), predict)
        evidence = motion_evidence(stamp_ns, newest, hypotheses, self.drift_variance, prediction, model)
        return Advice((evidence,), predict)


def travelling(prediction: AirPrediction, spread_psd: float = 0.0) -> Hypothesis:
    """The hypothesis that the vehicle travels as predicted, without a prior on its speed."""
    return Hypothesis(TRAVEL, 1.0, None, per_epoch(prediction.noise), doubt_psd=spread_psd)


def per_epoch(noise: Array) -> Vector3:
    """Variances (3,) of the mean over an epoch, from those of the mean over one second."""
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
        attitude=newest[me.ATTITUDE : me.BODY_VELOCITY].reshape(3, 3),
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
    """Estimate minus prediction, in n: the increment of the position error of CN113777645A, claim 3, as a velocity."""
    wind = model.wind_mean + model.wind
    dv, cov = velocity_error(newest, prediction.air_velocity, prediction.noise, wind, model.wind_spread)
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
