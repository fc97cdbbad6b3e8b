"""A method that the package does not have: one class and one registration, and every tool knows it."""

import ast
import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import parameter_docs
from flight_bag import write_flight_bag
from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.outage.methods.method import (
    Advice,
    Flight,
    Guide,
    OutageMethod,
    RehearsalScores,
    TrainingJob,
    TrainingPlan,
    TrainingResult,
    newest_time,
)
from nav_pose_estimator.engine.outage.methods.registry import all_methods, registered
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import ParameterError, specs, update
from nav_pose_estimator.engine.samples import BodyVelocity, VelocityError
from nav_pose_estimator.offline.command_line import main
from nav_pose_estimator.offline.flights import methods
from nav_pose_estimator.offline.flights.recording import load

PACKAGE = Path(__file__).resolve().parents[2] / "nav_pose_estimator"


@dataclass(frozen=True)
class UsualMotion:
    """Mean velocity (3,) in b, and how many epochs it has followed."""

    velocity: np.ndarray
    followed: int = 0

    def follow(self, epoch: np.ndarray) -> "UsualMotion":
        return UsualMotion(self.velocity, self.followed + 1)

    def advise(self, stamp_ns: int, recent: np.ndarray, external: VelocityError | None = None) -> Advice:
        assert len(recent) <= Toy.history
        assert (recent[:, me.COLUMNS :] == 7.0).all(), "its own column comes with every epoch"
        east, north, up = self.velocity.tolist()
        return Advice((BodyVelocity(stamp_ns, (east, north, up), 0.04 * np.eye(3), is_learned=True),))


@dataclass(frozen=True)
class Averaging:
    epochs: np.ndarray

    @property
    def until(self) -> float:
        return newest_time(self.epochs)

    def run(self) -> TrainingResult:
        return TrainingResult(UsualMotion(self.epochs[:, me.BODY_VELOCITY : me.VELOCITY].mean(axis=0)), self.until)


class Toy(OutageMethod):
    """Speaks as a velocity sensor would: what it says goes through the filter's usual door."""

    name = "usual_motion"
    summary = "a made-up velocity sensor that says what was usual"
    trains = True
    history = 9

    def columns(self, output, rows) -> np.ndarray:
        assert 0 < len(rows) <= 51, "up to a second at 50 Hz"
        return np.array([7.0])

    def job(self, epochs: np.ndarray, plan: TrainingPlan) -> TrainingJob:
        assert epochs.shape[1] == me.COLUMNS + 1
        assert (epochs[:, me.COLUMNS :] == 7.0).all()
        return Averaging(epochs)

    def scores(self, model: UsualMotion) -> dict[str, float]:
        return {"learner.followed": float(model.followed)}

    def ways(self, flight: Flight) -> dict[str, Guide]:
        return {} if flight.model is None else {"usual": flight.model}

    def choose(self, flight: Flight, scores: RehearsalScores) -> Guide | None:
        return flight.model


@pytest.fixture
def toy():
    with registered(Toy()):
        yield Toy.name


@pytest.fixture(scope="module")
def bag(tmp_path_factory) -> Path:
    """Circles at constant speed: the usual motion is the motion."""
    path = tmp_path_factory.mktemp("flight") / "circles_bag"
    write_flight_bag(path, 130.0, imu_hz=50.0)
    return path


def choices() -> tuple[str, ...]:
    return next(spec.choices for spec in specs(Parameters()) if spec.key == "learner.method")


def test_a_new_method_is_a_choice_and_stands_in_the_docs_as_long_as_it_is_registered() -> None:
    assert Toy.name not in choices()
    with registered(Toy()):
        assert choices()[-1] == Toy.name
        assert update(Parameters(), {"learner.method": Toy.name}).learner.method == Toy.name
        assert f"| `{Toy.name}` | {Toy.summary} | everywhere |" in parameter_docs.page_text()
        assert f"{Toy.name}: {Toy.summary}" in parameter_docs.yaml_text().replace("\n      #  ", "")
    with pytest.raises(ParameterError, match=r"'usual_motion' is not one of coast, "):
        update(Parameters(), {"learner.method": Toy.name})
    assert Toy.name not in parameter_docs.page_text()


def test_two_methods_of_one_name_are_refused(toy) -> None:
    with pytest.raises(ValueError, match=f"there is a method '{toy}' already"), registered(Toy()):
        pass
    assert choices().count(toy) == 1


@pytest.mark.compiled
def test_the_benchmark_flies_a_new_method(toy, bag: Path, tmp_path: Path) -> None:
    """GIVEN a vehicle that flies as ever WHEN GNSS is lost THEN a method that says so ends nearer than coasting."""
    options = ["--lengths", "30", "--every", "200", "--first", "60", "--methods", f"{toy},coast", "--gnss-delay", "0"]
    assert main(["benchmark", "outage", str(bag), *options, "--out", str(tmp_path)]) == 0
    with (tmp_path / "outages.csv").open() as file:
        errors = {row["method"]: float(row["end_error_m"]) for row in csv.DictReader(file)}
    assert errors[toy] < 0.5 * errors["coast"]


@pytest.mark.compiled
def test_a_replay_flies_a_new_method_which_learns_and_rehearses(toy, bag: Path, tmp_path: Path) -> None:
    """GIVEN two minutes of flight WHEN they are replayed THEN the method was trained, followed and rehearsed."""
    assert main(["replay", str(bag), "--method", toy, "--outage", "80:20", "--out", str(tmp_path)]) == 0
    estimator = PoseEstimator(methods.apply(Parameters(), toy))
    for sample in load(bag).samples:
        estimator.feed(sample)
    status = estimator.outage_aid.status()
    assert status["learner.followed"] > 10.0
    assert status["rehearsal.rms_30_s.usual"] < status["rehearsal.rms_30_s.coast"]


def test_no_method_is_compared_by_its_name() -> None:
    """The registry asks a method; nothing else looks what it is called."""
    names = {method.name for method in all_methods()}
    rooms = ("engine/outage", "engine/composed", "engine/parameters", "offline/flights", "offline/benchmarks", "ros")
    found = [
        f"{path.relative_to(PACKAGE)}:{node.lineno}"
        for room in rooms
        for path in sorted((PACKAGE / room).rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Compare)
        for part in ast.walk(node)
        if isinstance(part, ast.Constant) and part.value in names
    ]
    assert found == []
