"""The file of usual motion: what is written is read, the shipped one is sound, and what no vehicle does is refused."""

from pathlib import Path

import pytest

from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.outage.methods.usual_file import as_toml, load_usual_motion
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.errors import UserError

OTHER = Path(__file__).resolve().parents[1] / "helpers" / "other_prior.toml"


def test_what_is_written_is_read(tmp_path) -> None:
    usual = load_usual_motion(str(OTHER))
    (tmp_path / "again.toml").write_text(as_toml(usual))
    assert load_usual_motion(str(tmp_path / "again.toml")) == usual
    assert usual.hover.activity == (-0.5, 0.5)


def test_the_shipped_prior_knows_that_wings_are_faster() -> None:
    usual = load_usual_motion()
    assert usual.hover.speed < usual.multirotor.speed < usual.fixed_wing.speed
    assert usual.hover.activity[0] < usual.hover.travel_activity[0]


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("speed = 9.0", "speed = 900.0", "beyond what a vehicle can do"),
        ("speed = 9.0", "speed = nan", "beyond what a vehicle can do"),
        ("speed = 9.0", 'speed = "fast"', "beyond what a vehicle can do"),
        ("activity = [-0.5, 0.5]", "activity = [-0.5, 0.0]", "beyond what a vehicle can do"),
        ("activity = [-0.5, 0.5]", "activity = -0.5", "beyond what a vehicle can do"),
        ("missed = 0.5\n", "", "must have"),
        ("[hover]", "[hovering]", "must have"),
        ("version = 1", "version = 2", "make it again"),
        ("version = 1", "version = ", "not a prior"),
    ],
)
def test_what_no_training_writes_is_refused(tmp_path, before: str, after: str, message: str) -> None:
    """GIVEN a file with one thing wrong WHEN the estimator is made THEN one sentence names the file and the fault."""
    path = tmp_path / "wrong.toml"
    path.write_text(OTHER.read_text().replace(before, after, 1))
    with pytest.raises(UserError, match=message) as refused:
        PoseEstimator(update(Parameters(), {"learner.prior": str(path)}))
    assert "wrong.toml" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_file_that_is_not_there_or_no_text_is_refused(tmp_path) -> None:
    with pytest.raises(UserError, match="cannot read"):
        load_usual_motion(str(tmp_path / "absent.toml"))
    (tmp_path / "noise").write_bytes(bytes(range(256)))
    with pytest.raises(UserError, match="not a prior"):
        load_usual_motion(str(tmp_path / "noise"))
