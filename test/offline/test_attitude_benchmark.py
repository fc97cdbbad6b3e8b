"""The attitude benchmark: its metric on hand-made cases, and the scores on real trials where they are at hand."""

import json

import numpy as np
import pytest

from nav_pose_estimator.core.numerics.rotation import quat_from_euler
from nav_pose_estimator.offline.benchmarks.attitude import benchmark
from nav_pose_estimator.offline.benchmarks.attitude.row import Row
from nav_pose_estimator.offline.benchmarks.attitude.trials import errors
from nav_pose_estimator.offline.command_line import main

BOUNDS = {"complementary": (0.58, 1.95), "two_stage": (0.72, 2.40)}
"""Inclination without and total with magnetometer [deg], mean of the trials: what must not get worse."""


def test_the_metric_tells_heading_from_inclination() -> None:
    reference = np.tile(quat_from_euler(0.3, -0.2, 1.0), (2, 1))
    turned = np.stack([quat_from_euler(0.3, -0.2, 1.1), quat_from_euler(0.3, -0.2, 1.0)])
    inclination, heading, total = errors(turned, reference)
    np.testing.assert_allclose(heading, [0.1, 0.0], atol=1e-9)
    np.testing.assert_allclose(inclination, [0.0, 0.0], atol=1e-7)
    np.testing.assert_allclose(total, [0.1, 0.0], atol=1e-7)


@pytest.mark.compiled
def test_scores_on_real_trials(shared_data, tmp_path) -> None:
    trials = sorted(str(path) for path in (shared_data / "broad").glob("*.npz"))
    if not trials:
        pytest.skip("no attitude trials beside the repository")
    assert main(["benchmark", "attitude", *trials, "--out", str(tmp_path)]) == 0
    means = {m["method"]: m for m in json.loads((tmp_path / "summary.json").read_text())["means"]}
    for method, (inclination, total) in BOUNDS.items():
        assert means[method]["inclination_deg"] <= inclination
        assert means[method]["total_deg"] <= total


def test_what_a_filter_does_not_state_is_null(tmp_path) -> None:
    """GIVEN a peer that states no deviation WHEN its row is written THEN the summary is JSON for every reader."""
    row = Row("recorded", "trial", "vqf", 0.7, 2.4, 2.5)
    benchmark.write_files(tmp_path, [row], [row], advance=0.0)
    (means,) = json.loads((tmp_path / "summary.json").read_text(), parse_constant=pytest.fail)["means"]
    assert means["tilt_in_95"] is None


@pytest.mark.parametrize("arguments", [["gone.npz"], ["--methods", "magic", "gone.npz"], []])
def test_wrong_use_ends_with_2(arguments, tmp_path, capsys) -> None:
    assert main(["benchmark", "attitude", *arguments, "--out", str(tmp_path)]) == 2
    assert "Traceback" not in capsys.readouterr().err
