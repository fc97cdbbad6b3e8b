"""A velocity in body axes with the usual mistakes: found by the IMU, left out, its effect undone."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from beamed import at_rate, in_body
from nav_pose_estimator.engine.samples import BodyVelocity, ImuBlock, Sample
from told import flight, silence, tell

pytestmark = pytest.mark.compiled
LOST, LENGTH, END = 50.0, 15.0, 70.0  # s
RATE, SD = 10.0, 0.05  # Hz, m/s
Change = Callable[[np.ndarray], np.ndarray]
Later = Callable[[float, np.ndarray], np.ndarray]
EVENT = "body_velocity.implausible"
TURNED = np.array([[0.5**0.5, -(0.5**0.5), 0.0], [0.5**0.5, 0.5**0.5, 0.0], [0.0, 0.0, 1.0]])


def with_body_velocity(
    change: Change, name: str, sd: float = SD, later: Later | None = None, lost: float = LOST, length: float = LENGTH
) -> Iterator[Sample]:
    """The flight without GNSS from ``lost`` on for ``length`` [s], and what a sensor would send of its velocity.

    ``change`` acts on the velocity in b, ``later`` on the time [s] and the result.
    """
    recording = flight(name, lost + length + END - LOST - LENGTH).with_faults(*silence(lost, length))
    truth, velocity, rng = recording.truth, in_body(recording), np.random.default_rng(3)
    for sample, t in at_rate(recording, RATE):
        yield sample
        if isinstance(sample, ImuBlock) and t is not None:
            measured = velocity[min(round(t / truth.dt), len(truth) - 1)] + rng.normal(0.0, sd, 3)
            sent = change(measured) if later is None else later(t, change(measured))
            yield BodyVelocity(int(sample.stamps_ns[-1]), tuple(sent.tolist()))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda v: v * [1.0, -1.0, -1.0], "Forward-Right-Down"),
        (lambda v: -v, "sign looks inverted"),
        (lambda v: v[[1, 0, 2]], "exchanged"),
        (lambda v: TURNED @ v, "turned by -45 deg"),
        (lambda v: 1.944 * v, "knots"),
        (lambda v: 2.237 * v, "mph"),
        (lambda v: 0.5 * v, "times the speed"),
    ],
    ids=["FRD", "inverted", "exchanged", "turned", "knots", "mph", "halved"],
)
def test_a_wrong_body_velocity_is_named_and_steers_nothing(change: Change, words: str) -> None:
    """GIVEN a velocity sensor with a usual mistake WHEN the vehicle manoeuvres under GNSS THEN the mistake is named
    before GNSS is lost, its effect is undone, and the outage is flown without the sensor, within three sigma."""
    told = tell(flight("stop_and_go", END), samples=with_body_velocity(change, "stop_and_go"), learner__enabled=False)
    assert words in told.event(EVENT).text
    assert told.when(EVENT)[0] < LOST
    inside = told.between(LOST, LOST + LENGTH)
    assert (told.off[inside] < np.maximum(3.0 * told.sigma[inside], 3.0)).all()
    assert told.off[inside].max() < 10.0


@pytest.mark.parametrize("name", ["stop_and_go", "fixed_wing"])
@pytest.mark.parametrize("sd", [SD, 0.3])
def test_a_sound_one_is_believed_however_noisy_it_is(name: str, sd: float) -> None:
    """GIVEN a sound sensor THEN nothing is said of it, and it holds the outage."""
    told = tell(flight(name, END), samples=with_body_velocity(lambda v: v, name, sd), learner__enabled=False)
    assert told.when(EVENT) == []
    assert told.count("body_velocity.rejected.axes") == 0
    inside = told.between(LOST, LOST + LENGTH)
    assert told.off[inside].max() < 5.0


def test_a_noisy_one_that_is_confirmed_stays_so_for_a_minute() -> None:
    """GIVEN a sound sensor with noise of 0.3 m/s WHEN an outage lasts for a minute THEN it holds it, and the chance of
    its noise does not make it suspect: sigma stays at metres."""
    samples = with_body_velocity(lambda v: v, "stop_and_go", 0.3, lost=60.0, length=60.0)
    told = tell(flight("stop_and_go", 125.0), samples=samples, learner__enabled=False)
    inside = told.between(60.0, 119.0)
    assert told.off[inside].max() < 4.0
    assert told.sigma[inside].max() < 6.0


def test_a_sound_one_that_pauses_in_an_outage_is_not_doubted() -> None:
    """GIVEN a sensor that is silent for most of an outage WHEN it is back THEN its correction was to be expected."""
    silent = np.full(3, np.nan)
    samples = with_body_velocity(
        lambda v: v, "hover", later=lambda t, v: silent if LOST + 1.0 < t < LOST + LENGTH - 2.0 else v
    )
    told = tell(flight("hover", END), samples=samples, learner__enabled=False)
    assert told.when("body_velocity.unfelt") == []


def test_an_axis_that_is_not_measured_leaves_the_others() -> None:
    """GIVEN a sensor of the forward speed alone, NaN otherwise THEN it holds the outage better than no sensor."""
    forward, nothing = np.array([0.0, np.nan, np.nan]), np.full(3, np.nan)
    one, none = (
        tell(
            flight("stop_and_go", END),
            samples=with_body_velocity(lambda v, unknown=unknown: v + unknown, "stop_and_go"),
            learner__enabled=False,
        )
        for unknown in (forward, nothing)
    )
    assert one.when(EVENT) == []
    inside = one.between(LOST, LOST + LENGTH)
    assert (one.off[inside] < 3.0 * one.sigma[inside]).all()
    assert one.sigma[inside].max() < 0.7 * none.sigma[inside].max()


@pytest.mark.parametrize("name", ["hover", "multirotor_light"])
def test_an_unconfirmed_one_steers_nothing_while_gnss_is_good(name: str) -> None:
    """GIVEN a sensor that sends a constant turn and scale WHEN no motion has confirmed it THEN the pose keeps to GNSS,
    and in an outage sigma covers what such a velocity may cause."""
    samples = with_body_velocity(lambda v: 1.5 * (TURNED @ TURNED @ v), name)
    told = tell(flight(name, END), samples=samples, learner__enabled=False)
    assert told.count("body_velocity.unproven") > 0
    flying = told.t > 10.0
    assert (told.off[flying] < np.maximum(3.0 * told.sigma[flying], 3.0)).all()


@pytest.mark.parametrize("size", [0.0, 0.5])
def test_a_velocity_that_changes_in_an_outage_without_a_force_is_doubted(size: float) -> None:
    """GIVEN a confirmed sensor WHEN it loses half of its size or stops in an outage THEN the doubt is told once, and
    the pose is seldom off by more than three sigma."""
    samples = with_body_velocity(lambda v: v, "stop_and_go", later=lambda t, v: v * (size if t > LOST else 1.0))
    told = tell(flight("stop_and_go", END), samples=samples, learner__enabled=False)
    assert len(told.when("body_velocity.unfelt", LOST)) == 1
    inside = told.between(LOST, LOST + LENGTH)
    assert (told.off[inside] < np.maximum(3.0 * told.sigma[inside], 3.0)).mean() > 0.8
