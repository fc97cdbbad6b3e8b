"""Messages of beams that are none, or only in part: each costs itself, one sentence, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest

from beam_flight import LOST, Flown, on_velocities
from beamed import beam_directions, with_beams
from nav_pose_estimator.engine.samples import BeamVelocitySample

pytestmark = pytest.mark.compiled


@pytest.mark.parametrize(
    ("change", "reason", "words"),
    [
        ({"velocities": np.zeros(4)}, "zero", "exactly zero"),
        ({"velocities": np.full(4, np.nan)}, "lost", ""),
        ({"velocities": np.full(4, 1e9)}, "lost", ""),
        ({"ranges": np.zeros(4)}, "lost", ""),
        ({"valid": np.zeros(4, bool)}, "lost", ""),
        ({"variances": np.full(4, np.inf)}, "lost", ""),
        ({"velocities": np.array([0.1, -0.2, 0.3, 0.25])}, "stuck", "repeat to the last digit"),
        ({"directions": 2.0 * beam_directions()}, "direction", "beam 1 is not a unit vector (its length is 2)"),
        ({"directions": beam_directions()[[0, 1, 2, 1]]}, "duplicate", "beams 2 and 4 have the same direction"),
        ({"directions": beam_directions()[:3]}, "empty", "not as many directions as velocities"),
        ({"velocities": np.zeros(0), "directions": np.zeros((0, 3))}, "empty", "no beam"),
    ],
)
def test_a_bad_message_costs_itself_and_one_sentence(flight, without, change, reason, words):
    """GIVEN messages that cannot be used WHEN GNSS is away THEN the flight is the one without them."""
    flown = Flown(flight, with_beams(flight, lambda t, sample: replace(sample, **change)))
    assert flown.error == pytest.approx(without.error, rel=0.05)
    assert flown.counters[f"beam_velocity.rejected.{reason}"] > 300
    texts = flown.said(f"rejected.{reason}")
    assert len(texts) == (1 if words else 0)
    assert all(words in text for text in texts)


@pytest.mark.parametrize("no_direction", [np.zeros(3), np.full(3, np.nan)], ids=["zeros", "NaN"])
def test_a_beam_that_is_not_there_costs_no_other(flight, sound, no_direction):
    """GIVEN a driver that fills the place of a beam that it has lost, or never had, with zeros or NaN THEN the rest of
    the message is used."""

    def without_third(t: float, sample: BeamVelocitySample) -> BeamVelocitySample:
        directions, velocities = sample.directions.copy(), sample.velocities.copy()
        directions[2], velocities[2] = no_direction, no_direction[0]
        return replace(sample, directions=directions, velocities=velocities, variances=np.full(4, 1e-4))

    flown = Flown(flight, with_beams(flight, lambda t, s: without_third(t, s) if t > 40.0 else s))
    assert flown.error < 1.5 * sound.error + 0.2
    assert flown.counters["beam_velocity.3.lost"] > 50
    assert flown.said("rejected.direction") == flown.said("rejected.geometry") == []


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf, 1e9, 0.0])
def test_a_number_that_is_no_velocity_costs_its_own_beam(flight, sound, wrong):
    """GIVEN one beam that publishes something else than a velocity in the outage THEN the others hold it."""

    def spoil(t: float, velocities: np.ndarray) -> None:
        if t > LOST:
            velocities[1] = wrong

    flown = Flown(flight, with_beams(flight, on_velocities(spoil)))
    assert flown.error < 2.0 * sound.error + 0.2
    assert np.isfinite(flown.nav).all()
    assert flown.counters["beam_velocity.2.lost"] + flown.refused(2) > 150


def test_a_sensor_that_gets_stuck_does_not_lead_the_navigator(flight):
    """GIVEN a Doppler log whose numbers freeze in the outage THEN it is left out, and the drift is honest."""
    last: list[np.ndarray] = []

    def freeze(t: float, sample: BeamVelocitySample) -> BeamVelocitySample:
        if t < 65.0:
            last[:] = [sample.velocities]
        return replace(sample, velocities=last[0].copy())

    flown = Flown(flight, with_beams(flight, freeze))
    assert len(flown.said("rejected.stuck")) == 1
    assert flown.counters["beam_velocity.accusation"] == 0
    assert flown.error < 3.0 * flown.status.horizontal_sd


def test_a_stamp_that_repeats_is_believed_once(flight, sound):
    """GIVEN a driver that renews its stamp once a second only, in an outage THEN the others are refused, and it is
    said once."""
    first = [-1.0, 0]

    def stale(t: float, sample: BeamVelocitySample) -> BeamVelocitySample:
        if t < LOST or t - first[0] > 0.9:
            first[:] = [t, sample.stamp_ns]
        return replace(sample, stamp_ns=int(first[1]))

    flown = Flown(flight, with_beams(flight, stale))
    (told,) = flown.said("rejected.stamp")
    assert "stamp of the one before it" in told
    assert flown.error < 3.0 * flown.status.horizontal_sd
    assert flown.error < 3.0 * sound.error + 0.5


@pytest.mark.parametrize("unit", [1000.0, 100.0], ids=["mm/s", "cm/s"])
def test_velocities_in_another_unit_are_not_used(flight, without, unit):
    """GIVEN a driver that publishes millimetres or centimetres a second THEN no beam is used, and it is said."""
    flown = Flown(flight, with_beams(flight, lambda t, sample: replace(sample, velocities=unit * sample.velocities)))
    assert "no convention of directions and signs agrees" in flown.said("geometry.refused")[0]
    assert flown.counters["beam_velocity.used"] == 0
    assert flown.error == pytest.approx(without.error, rel=0.05)


@pytest.mark.parametrize("stamp_ns", [0, -5, 10**12, 2**62])
def test_stamps_of_no_time_are_refused_and_cost_nothing_else(flight, without, stamp_ns):
    """GIVEN messages with stamps from another clock THEN they are counted, not used, and the flight goes on."""
    flown = Flown(flight, with_beams(flight, lambda t, sample: replace(sample, stamp_ns=stamp_ns)))
    assert flown.error == pytest.approx(without.error, rel=0.05)
    refused = {name: n for name, n in flown.counters.items() if name.startswith("beam_velocity.rejected")}
    assert sum(refused.values()) > 300, flown.counters
    assert flown.counters["beam_velocity.used"] == 0
