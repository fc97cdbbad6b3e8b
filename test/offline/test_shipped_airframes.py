"""The airframe files in ``config``: what they say of their origin is true."""

from pathlib import Path

import pytest

from nav_pose_estimator.core.motion.vehicle_class import FIXED_WING, MULTIROTOR
from nav_pose_estimator.engine.outage.airframe_file import load_airframe
from nav_pose_estimator.offline.simulated_bag import write_recording
from nav_pose_estimator.offline.training.airframe import made_with
from nav_pose_estimator.offline.training.flights import digest_of
from nav_pose_estimator.sim.scenarios import generate

CONFIG = Path(__file__).parents[2] / "config"
SEEDS = range(11, 17)
WING = "sim_wing"


@pytest.mark.parametrize(
    ("name", "scenario", "vehicle_class"),
    [(WING, "fixed_wing", FIXED_WING), ("sim_multirotor", "multirotor_moderate", MULTIROTOR)],
)
def test_a_shipped_file_names_the_flights_that_its_script_makes(name, scenario, vehicle_class) -> None:
    airframe = load_airframe(CONFIG / f"{name}.airframe")
    assert (airframe.vehicle_class, airframe.is_one_aircraft) == (vehicle_class, True)
    assert airframe.made_with.startswith("nav_pose_estimator ")
    assert [flight.name for flight in airframe.flights] == [f"{name}_{seed}" for seed in SEEDS]
    script = (CONFIG / "make_airframes.sh").read_text(encoding="utf-8")
    assert f"make_airframe {name} {scenario} {vehicle_class}\n" in script
    assert f"for seed in {' '.join(map(str, SEEDS))}; do" in script


def test_a_flight_of_a_shipped_file_can_be_made_again(tmp_path) -> None:
    """GIVEN the file of the wing WHEN its first flight is simulated again, by the same NumPy with the same vector
    instructions, THEN the recording has the digest that the file names."""
    airframe = load_airframe(CONFIG / f"{WING}.airframe")
    if airframe.made_with != made_with():
        pytest.skip(f"the file was made with {airframe.made_with}: other last bits of GNSS and magnetometer")
    first = airframe.flights[0]
    write_recording(tmp_path / first.name, generate("fixed_wing", 300.0, SEEDS[0]))
    assert digest_of(tmp_path / first.name) == first.digest
