"""The bags of the repository are what their script makes, small, and readable."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import BeamVelocitySample, GnssFix, ImuBlock, MagSample, PressureSample
from nav_pose_estimator.offline.bags.storage import Bag
from nav_pose_estimator.offline.command_line import main
from nav_pose_estimator.offline.flights.recording import Recording, load

NAMES = ("multirotor_outage", "fixed_wing", "road_vehicle", "drone_over_water", "hover_sqlite3")


def recipes(repository: Path) -> dict[str, list[str]]:
    """Arguments of ``simulate`` by the name of the bag, as make_bags.sh gives them."""
    script = (repository / "bags" / "make_bags.sh").read_text()
    common = re.search(r'"\$\{@:2\}" (.*)', script).group(1)
    lines = re.findall(r"^simulate (\w+) (.*)$", script, re.MULTILINE)
    return {name: shlex.split(f"{own} {common}") for name, own in lines}


def columns(recording: Recording) -> dict[str, np.ndarray]:
    """What the sensors measured, as arrays."""
    blocks = [sample for sample in recording.samples if isinstance(sample, ImuBlock)]
    found = {
        name: np.concatenate([getattr(block, name) for block in blocks]) for name in ("gyro", "accel", "stamps_ns")
    }
    found["fix"] = np.array([(fix.lat, fix.lon, fix.alt) for fix in recording.fixes])
    found["velocity"] = np.array([velocity.vel_enu for velocity in recording.velocities])
    found["field"] = np.array([sample.field for sample in recording.samples if isinstance(sample, MagSample)])
    found["pressure"] = np.array([s.pressure for s in recording.samples if isinstance(s, PressureSample)])
    beams = [sample.velocities for sample in recording.samples if isinstance(sample, BeamVelocitySample)]
    if beams:
        found["beams"] = np.array(beams)
    found["truth"] = recording.truth.position
    return found


def test_every_shipped_bag_has_a_recipe(repository: Path) -> None:
    folders = {item.name for item in (repository / "bags").iterdir() if item.is_dir()}
    assert folders == set(NAMES) == set(recipes(repository))
    readme = (repository / "bags" / "README.md").read_text()
    for name in NAMES:
        own = " ".join(word for word in recipes(repository)[name] if word not in ("--seed", "1", "--force"))
        assert f"| `{name}` | `{own.replace(' --truth-rate 10', '')}` |" in readme


def test_bags_are_small(repository: Path) -> None:
    sizes = {name: sum(f.stat().st_size for f in (repository / "bags" / name).iterdir()) for name in NAMES}
    assert max(sizes.values()) < 2e6
    assert sum(sizes.values()) < 5e6


@pytest.mark.parametrize("name", NAMES)
def test_bag_has_all_topics(repository: Path, name: str) -> None:
    with Bag(repository / "bags" / name) as bag:
        counts = {topic.name: topic.count for topic in bag.topics.values()}
        assert not bag.warnings
    assert counts.pop("/ground_truth/origin") == 1
    assert set(counts) == {
        *(["/beam_velocity"] if name == "drone_over_water" else []),
        *("/imu/data_raw", "/imu/mag", "/baro"),
        *("/gps/fix", "/gps/vel", "/gps/satellites", "/ground_truth/odom"),
    }
    assert min(counts.values()) >= 100


@pytest.mark.compiled
@pytest.mark.parametrize("name", NAMES)
def test_recipe_makes_the_bag_again(repository: Path, tmp_path: Path, name: str) -> None:
    recipe = [word for word in recipes(repository)[name] if word != "--small"]
    assert main(["simulate", str(tmp_path / "again"), *recipe]) == 0
    parameters = update(Parameters(), {"aids.beam_velocity_source": "pointcloud2"})
    shipped, made = (load(path, parameters=parameters) for path in (repository / "bags" / name, tmp_path / "again"))
    assert ("beams" in columns(shipped)) == (name == "drone_over_water")
    again = columns(made)
    for what, values in columns(shipped).items():
        assert values.shape == again[what].shape
        # Another libm may round a value to the next step of its sensor, rarely.
        scale = max(float(np.std(values)), 1e-12)
        assert np.mean(np.abs(values - again[what]) > 1e-6 * scale) < 1e-3, what
    assert isinstance(shipped.fixes[0], GnssFix)
