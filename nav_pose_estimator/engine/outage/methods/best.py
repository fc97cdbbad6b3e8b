"""The recommended method: the hypotheses of hovering and travelling, with the network where it has helped."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.air_velocity import AirVelocityModel, is_guided
from nav_pose_estimator.core.motion.regimes import MotionRegimes, learn_regimes
from nav_pose_estimator.core.motion.usual_drag import expected_noise, with_usual_drag
from nav_pose_estimator.core.motion.vehicle_class import FIXED_WING
from nav_pose_estimator.engine.outage.methods.air_velocity_guide import (
    HOVER,
    TRAVEL,
    AirPrediction,
    AirVelocityGuide,
    per_epoch,
    travelling,
)
from nav_pose_estimator.engine.outage.methods.anfis import NETWORK, Anfis
from nav_pose_estimator.engine.outage.methods.coast import Coast
from nav_pose_estimator.engine.outage.methods.method import Array, Flight, Guide, RehearsalScores
from nav_pose_estimator.engine.samples import Hypothesis

_LEAST_FLIGHT = 4.0  # s: least flight before an outage that the method can bridge
_LEAST_EPOCHS = 8  # least number of epochs to which the population's drag is adapted
REGIMES, ALONE = "regimes", "alone"
_HOVER_TIME = 2.0  # s over which the velocity of a hover counts as one draw
_WANDER_TIME = 15.0  # s over which its displacement does: it is half as large as ever after 5 to 20 s
_DRAW = 1.1  # errors this much larger than the simpler way's are still a draw
_WORSE = 1.5  # the same for giving up the network where coasting is about as good: chance makes a ratio of 1.2
_CLEARLY = 6.0  # coasting three times better at 30 s is a draw at 60 s; three rehearsals tell it to a factor of two


@dataclass(frozen=True, kw_only=True)
class RegimesGuide(AirVelocityGuide):
    """Two hypotheses for a vehicle that can hover; the model discriminates them and predicts the travelling one.

    ``hover_spread_psd`` [m^2/s]: as ``spread_psd``, from rehearsals in which the vehicle hovered. ``doubt`` [m^2/s^2]:
    the noise that the model states where the vehicle travels.
    """

    regimes: MotionRegimes
    hover_spread_psd: float = 0.0
    doubt: float = math.inf

    def hypotheses(self, recent: Array, prediction: AirPrediction | None) -> tuple[Hypothesis, ...]:
        """Travelling and hovering; travelling only for a vehicle that cannot hover."""
        # a car at constant speed is as calm as one at rest: of a ground vehicle only the direction of motion is known
        if self.model is not None and self.model.is_guided:
            return () if prediction is None else (travelling(prediction, self.spread_psd),)
        active = float(me.activity(recent)[-1])
        travel = self._travel(active, prediction)
        if self.regimes.can_hover:
            return travel, self._hover(float(recent[-1, me.TIME]), active, prediction)
        return (travel,)

    def _travel(self, active: float, prediction: AirPrediction | None) -> Hypothesis:
        regimes = self.regimes
        return Hypothesis(
            name=TRAVEL,
            probability=1.0 - regimes.hover_probability if regimes.can_hover else 1.0,
            velocity_var=regimes.travel_var if regimes.can_hover else None,  # a fixed wing's mean velocity is not zero
            air_noise=None if prediction is None else per_epoch(prediction.noise),
            log_likelihood=_log_density(active, regimes.travel_activity),
            # a prediction is better than the prior on the speed, which then only discriminates the hypotheses
            velocity_time=regimes.travel_time if prediction is None else None,
            place_var=regimes.place_var,
            doubt_psd=self.spread_psd,
        )

    def _hover(self, time: float, active: float, prediction: AirPrediction | None) -> Hypothesis:
        regimes, air_noise = self.regimes, None
        if prediction is not None:
            noise = prediction.hover_noise
            air_noise = per_epoch(prediction.noise + regimes.travel_var + 1.0 if noise is None else noise)
        begun = Hypothesis(
            name=HOVER,
            probability=regimes.hover_probability,
            velocity_var=regimes.hover_var,
            air_noise=air_noise,
            log_likelihood=_log_density(active, regimes.hover_activity),
            velocity_time=_HOVER_TIME,
            doubt_psd=self.hover_spread_psd + regimes.doubt_psd(time),
            air_corrects=False,  # a network errs by more than a hover moves
        )
        # a hover that goes on is held in its place: its velocity changes sign soon, and its displacement has a bound
        held = replace(begun, velocity_time=me.PERIOD, place_var=regimes.wander_var, place_time=_WANDER_TIME)
        return replace(begun, lasting=held)


class Best(Anfis):
    """No regret: of regimes alone and regimes with the network, what did best in rehearsals."""

    name = "best"
    summary = "hovering or travelling as in the flight so far, with the network where it has helped"

    @property
    def least_flight(self) -> float:
        """Population statistics are known before the flight; only that the vehicle moves has to be observed."""
        return _LEAST_FLIGHT

    def warm_up(self) -> None:
        """As for the network, and what tells regimes apart."""
        super().warm_up()
        me.activity(np.zeros((1, me.COLUMNS)))

    def ways(self, flight: Flight) -> dict[str, Guide]:
        """The regimes with the usual drag; once there is a network, also the regimes with it, and the network alone."""
        ways: dict[str, Guide] = {REGIMES: self._with_usual_drag(flight)}
        if flight.model is not None:
            ways[ALONE] = AirVelocityGuide(flight.model, flight.drift_variance, flight.spread.get(ALONE, 0.0))
            ways[NETWORK] = self.with_regimes(flight, flight.model, NETWORK)
        return ways

    def with_regimes(self, flight: Flight, model: AirVelocityModel | None, name: str) -> RegimesGuide:
        """The regimes of the flight with ``model``; ``name`` is the name of this way in rehearsals."""
        can_hover = self.beforehand.can_hover(flight.epochs)
        regimes = learn_regimes(flight.epochs, flight.usual, flight.decisions, can_hover)
        if can_hover is False and self.beforehand.by_flight(flight.epochs).vehicle_class != FIXED_WING:
            regimes = replace(regimes, place_var=None)  # a car or a boat need not stay near
        spread, hovering = (found.get(name, 0.0) for found in (flight.spread, flight.hover_spread))
        doubt = math.inf if model is None else expected_noise(model, flight.epochs)
        return RegimesGuide(
            model, flight.drift_variance, spread, regimes=regimes, hover_spread_psd=hovering, doubt=doubt
        )

    def _with_usual_drag(self, flight: Flight) -> RegimesGuide:
        """The regimes with the population's drag; without it for other vehicles than multirotors, or too few epochs."""
        guide = self.with_regimes(flight, None, REGIMES)
        if len(flight.epochs) < _LEAST_EPOCHS or not guide.regimes.can_hover or is_guided(flight.epochs):
            return guide
        model = with_usual_drag(flight.epochs, flight.usual.drag)
        return replace(guide, model=model, is_usual=True, doubt=expected_noise(model, flight.epochs))

    def choose(self, flight: Flight, scores: RehearsalScores) -> Guide | None:
        """The regimes with the network, unless a simpler way was better; None if that was far worse than coasting."""
        return self.chosen(self.ways(flight), NETWORK, scores)

    def chosen(self, ways: dict[str, Guide], network: str, scores: RehearsalScores) -> Guide | None:
        """Of ``ways`` the one named ``network``, unless rehearsals or its stated noise speak against it."""
        best = REGIMES if network not in ways or self._is_vaguer(ways, network, scores) else network
        if best == network and ALONE in ways and scores.is_worse(network, ALONE, _DRAW):
            best = ALONE
        return None if scores.is_worse(best, Coast.name, _CLEARLY) else ways[best]

    def _is_vaguer(self, ways: dict[str, Guide], network: str, scores: RehearsalScores) -> bool:
        """Whether the usual drag is to be preferred, by rehearsals or, if these are inconclusive, by stated noise."""
        if scores.is_worse(network, REGIMES, _WORSE):
            return True
        if scores.is_worse(REGIMES, network, _WORSE):
            return False
        return getattr(ways[REGIMES], "doubt", math.inf) < getattr(ways[network], "doubt", math.inf)


def _log_density(value: float, moments: tuple[float, float]) -> float:
    mean, variance = moments
    return -0.5 * ((value - mean) ** 2 / variance + math.log(variance))
