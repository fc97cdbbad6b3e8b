"""Compiled and plain kernels are one filter: the same flight gives the same numbers in both."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exact_motion import survey, times_of

from filter_start import initial_covariance
from imu_run import run_imu
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter import strapdown
from nav_pose_estimator.core.filter.blocks import GYRO_MATRIX, GaussMarkov
from nav_pose_estimator.core.filter.constants import make_constants
from nav_pose_estimator.core.filter.kalman import gated_correct, predicted_horizontal_sd
from nav_pose_estimator.core.filter.strapdown import flush_covariance


def beginning() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """``nav``, P and constants of a filter with a gyroscope's matrix, and the IMU rows of ten seconds of flight."""
    numbers = make_constants(
        gyro_noise=2e-4,
        accel_noise=3e-3,
        gyro_bias_sd=1e-4,
        gyro_bias_tau=300.0,
        accel_bias_sd=1e-2,
        accel_bias_tau=300.0,
        covariance_period=0.02,
        gap_dt=0.5,
        gap_rate_sd=0.3,
        gap_accel_sd=2.0,
        blocks={GYRO_MATRIX: GaussMarkov(1e-6)},
    )
    P = initial_covariance(
        numbers,
        misalignment_sd=(0.02, 0.02, 0.1),
        velocity_sd=0.5,
        position_sd=2.0,
        gyro_bias_sd=1e-3,
        accel_bias_sd=0.05,
        block_sd={GYRO_MATRIX: 0.005},
    )
    return survey().nav(0.0), P, numbers, survey().imu_rows(times_of(10.0, 100.0))


def fly() -> dict[str, list[float]]:
    """Ten seconds of flight with a fix each second: state, deviations, NIS and outlook."""
    nav, P, numbers, rows = beginning()
    H = np.zeros((3, len(P)))
    H[:, at.DPOS : at.DPOS + 3] = np.eye(3)
    values = []
    for i in range(10):
        run_imu(nav, P, numbers, rows[100 * i : 100 * (i + 1)], np.empty((100, at.OUT_COLUMNS)))
        flush_covariance(nav, P, numbers)
        values.append(gated_correct(nav, P, numbers, np.array([0.5, -0.3 * i, 0.2]), H, np.eye(3), 0.5, 100.0)[1])
    values.append(predicted_horizontal_sd(nav, P, numbers, 30.0))
    return {"nav": nav.tolist(), "sd": np.sqrt(np.diag(P)).tolist(), "values": [float(v) for v in values]}


def increments() -> list[str]:
    """Names of the types of the numbers with which the mechanization advances the state over a row."""
    nav, P, numbers, rows = beginning()
    seen: list[object] = []
    navigate = strapdown._navigate
    strapdown._navigate = lambda nav, turn, push, dt: (seen.extend((*turn, *push, dt)), navigate(nav, turn, push, dt))
    strapdown.propagate(nav, P, numbers, rows[1])
    return sorted({type(one).__name__ for one in seen})


def in_plain_python(call: str) -> Any:
    """The result of ``call``, a function of this module, in a process without compiled kernels."""
    here = Path(__file__).resolve().parent
    folders = (here, here.parent / "helpers", here.parents[1])
    path = os.pathsep.join([*map(str, folders), os.environ.get("PYTHONPATH", "")])
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": path}
    program = f"import json, test_modes; print(json.dumps(test_modes.{call}()))"
    result = subprocess.run(
        [sys.executable, "-c", program], env=environment, check=True, capture_output=True, text=True, timeout=300
    )
    return json.loads(result.stdout)


def test_the_plain_mechanization_computes_with_floats():
    # with one of numpy's scalars all that follows from it are such, and take three times as long
    assert in_plain_python("increments") == ["float"]


@pytest.mark.compiled
def test_compiled_and_plain_kernels_agree():
    plain, compiled = in_plain_python("fly"), fly()
    # The covariance step takes another form of equal order without a compiler: a few 1e-5 of a deviation.
    for name, tolerance in (("sd", 1e-5), ("values", 1e-4)):
        assert np.allclose(plain[name], compiled[name], rtol=tolerance), name
    for start, length, tolerance in ((at.LAT, 2, 1e-10), (at.ALT, 4, 1e-3), (at.QUAT, 4, 1e-5)):
        assert np.allclose(
            plain["nav"][start : start + length], compiled["nav"][start : start + length], atol=tolerance
        )
