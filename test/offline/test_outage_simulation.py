"""``benchmarks/outage_simulation.py``: its plan, its file, and the figures in its tables, on rows made up."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from nav_pose_estimator.offline.benchmarks.outage.statistics import Row

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "outage_simulation.py"


@pytest.fixture(scope="module")
def program() -> ModuleType:
    spec = importlib.util.spec_from_file_location("outage_simulation", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # where dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def row(program, flight, way: str, start: float, error: float, status: str = "ok", length: float = 60.0) -> Row:
    return Row(flight.name, way, length, start, error, 0.5 * error, error, 0.0, 0.5 * error, 100.0, status)


def rows_of(program, errors: dict[str, float], seeds=(1, 2)) -> list[Row]:
    """Two outages in each flight of every IMU in calm air, with the same error by each method."""
    return [
        row(program, program.Flight(grade, "calm", seed), way, start, error)
        for grade in program.GRADES
        for seed in seeds
        for start in (300.0, 365.0)
        for way, error in errors.items()
    ]


ERRORS = {"coast15": 40.0, "coast": 20.0, "best": 4.0, "anfis": 8.0, "drag": 10.0}


def test_the_tables_say_how_methods_compare_with_coasting(program: ModuleType) -> None:
    """GIVEN a method with a tenth of coasting's error WHEN reported THEN its ratio is 0.10 and the goal is met."""
    text = program.report(rows_of(program, ERRORS), program.GRADES, list(program.WINDS))
    assert "| bmi088, calm | 2 | 40.0 (100 %, 2.00) | 20.0 = 0.50 [0.50, 0.50] (100 %, 2.00) | 4.0 = 0.10" in text
    assert "| calm | best | 0.10 [0.10, 0.10] | 0.10 | 0.20 | met |" in text
    assert "Road" not in text
    assert "30 s" not in text


def test_a_goal_missed_by_one_imu_is_not_met(program: ModuleType) -> None:
    """GIVEN one IMU on which the method fails WHEN reported THEN the table says on how many it does not."""
    rows = [
        row(program, program.Flight("mpu6000", "calm", 1), r.method, r.start_s, 30.0)
        if r.bag == "mpu6000-calm-1" and r.method == "best"
        else r
        for r in rows_of(program, ERRORS, seeds=(1,))
    ]
    text = program.wind_table(rows, 60.0, program.GRADES, ["calm"])
    assert "| 2 of 3 |" in text
    assert "[" not in text, "one flight has no interval"


def test_an_outage_lost_by_one_method_is_left_out_for_all_and_said(program: ModuleType) -> None:
    """GIVEN an outage without an estimate WHEN reported THEN no method is judged on it, and the text says so."""
    rows = rows_of(program, ERRORS)
    flight = program.Flight("bmi088", "calm", 1)
    rows += [row(program, flight, way, 430.0, 1e3) for way in list(ERRORS)[1:]]
    rows.append(row(program, flight, "coast15", 430.0, float("nan"), "no_estimate"))
    text = program.report(rows, program.GRADES, ["calm"])
    assert text.startswith("1 outages were left out")
    assert "| bmi088, calm | 2 | 40.0 (100 %, 2.00) |" in text


def test_rows_survive_the_file(program: ModuleType, tmp_path: Path) -> None:
    """GIVEN rows written in two parts WHEN read THEN they are the same: the next run goes on where one ended."""
    rows = rows_of(program, ERRORS)
    assert program.read(tmp_path / "none.csv") == []
    program.append(tmp_path / "rows.csv", rows[:7])
    program.append(tmp_path / "rows.csv", rows[7:])
    assert program.read(tmp_path / "rows.csv") == rows


def test_seeds_are_the_outer_loop(program: ModuleType) -> None:
    """GIVEN two flights a cell WHEN planned THEN all cells of one seed come before the next seed."""
    arguments = SimpleNamespace(first_seed=7, flights=2, winds=["calm", "walk"], grades=["bmi088"], road=True)
    planned = [flight.name for flight in program.plan(arguments)]
    assert planned == [
        *("bmi088-calm-7", "bmi088-walk-7", "icm42688-road_vehicle-7"),
        *("bmi088-calm-8", "bmi088-walk-8", "icm42688-road_vehicle-8"),
    ]
