"""Compiled kernels are found again on disk, and never when something that went into them has changed."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from nav_pose_estimator.core.numerics import jit
from nav_pose_estimator.core.numerics.jit import COMPILED, numba

PACKAGE = Path(__file__).resolve().parents[2] / "nav_pose_estimator"
NUMBERS = """from nav_pose_estimator.core.numerics.jit import kernel
PLACE = {place}

@kernel
def double(x):
    return {factor} * x
"""
USER = """from nav_pose_estimator.core.numerics.jit import kernel
from numbers_of_others import PLACE, double

@kernel
def outer(x):
    return double(x) + PLACE

print(outer(10.0), sum(outer.stats.cache_hits.values()))
"""


def run(folder: Path, before: str = "") -> str:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(folder / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
    environment["PYTHONPATH"] = os.pathsep.join([str(folder), str(Path(__file__).resolve().parents[2])])
    command = [sys.executable, "-c", f"{before}\nimport user"]
    return subprocess.run(
        command, env=environment, check=True, capture_output=True, text=True, timeout=300
    ).stdout.strip()


@pytest.mark.compiled
def test_a_cached_kernel_is_used_until_a_number_or_a_kernel_in_it_changes(tmp_path):
    (tmp_path / "user.py").write_text(USER)
    others = tmp_path / "numbers_of_others.py"
    others.write_text(NUMBERS.format(place=3, factor=2.0))
    assert run(tmp_path) == "23.0 0"
    assert run(tmp_path) == "23.0 1"
    others.write_text(NUMBERS.format(place=4, factor=2.0))
    assert run(tmp_path) == "24.0 0"
    others.write_text(NUMBERS.format(place=4, factor=5.0))
    assert run(tmp_path) == "54.0 0"
    assert run(tmp_path) == "54.0 1"


@pytest.mark.compiled
def test_a_kernel_cached_with_one_numpy_is_not_used_with_another(tmp_path):
    (tmp_path / "user.py").write_text(USER)
    (tmp_path / "numbers_of_others.py").write_text(NUMBERS.format(place=3, factor=2.0))
    assert run(tmp_path) == "23.0 0"
    assert run(tmp_path) == "23.0 1"
    assert run(tmp_path, before="import numba, numpy; numpy.__version__ = '2.99.0'") == "23.0 0"


CONSTANTS = """from nav_pose_estimator.core.numerics.jit import inlined, kernel

@kernel
def power(x, n):
    return x**n

@inlined
def part(x, start):
    return x[start]

@kernel
def outer(x):
    return power(x[0], 2) + power(x[0], 3) + part(x, 0) + part(x, start=1)

import numpy
print(outer(numpy.array((2.0, 5.0))), len(power.signatures), len(part.signatures))
"""


@pytest.mark.compiled
def test_a_kernel_is_compiled_once_for_all_constants(tmp_path):
    (tmp_path / "user.py").write_text(CONSTANTS)
    assert run(tmp_path) == "19.0 1 1"


LIGHT = """import sys
import numba, numpy
from nav_pose_estimator.core.numerics.jit import kernel

@kernel
def half(x):
    return 0.5 * x

@numba.njit
def product(a, b):
    return numpy.dot(a, b)

half(1.0)
print("scipy.linalg" in sys.modules, product(numpy.eye(2), numpy.full(2, 3.0))[1])
from scipy.linalg import lu_factor
print(lu_factor(numpy.eye(2))[0].tolist())
"""


@pytest.mark.compiled
def test_kernels_need_no_scipy_linalg_and_leave_it_whole(tmp_path):
    """GIVEN a process with kernels WHEN others use BLAS in compiled code, and scipy.linalg THEN both work."""
    (tmp_path / "user.py").write_text(LIGHT)
    assert run(tmp_path).split("\n") == ["False 3.0", "[[1.0, 0.0], [0.0, 1.0]]"]


def test_mode_follows_the_environment():
    expected = numba is not None and os.environ.get("NUMBA_DISABLE_JIT", "0") in ("", "0")
    assert expected == COMPILED


@pytest.mark.compiled
def test_the_first_run_is_known_by_the_absence_of_machine_code(tmp_path, monkeypatch):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(jit, "_FOLDER", str(tmp_path))
    assert jit.is_first_run()
    (tmp_path / "core" / "filter" / "__pycache__").mkdir(parents=True)
    (tmp_path / "core" / "filter" / "__pycache__" / "kalman.correct-1.py312.nbi").touch()
    assert not jit.is_first_run()


CHANGES = {
    "earth/ellipsoid.py": lambda text: text.replace("6378137.0", "6378138.0"),
    "filter/layout.py": lambda text: text.replace("LAT, LON, ALT = 0, 1, 2", "LAT, LON, ALT = 1, 0, 2"),
}
STAMP = "from nav_pose_estimator.core.filter import memory; print(memory.run_block.source_stamp)"


@pytest.mark.compiled
def test_a_number_of_another_room_makes_the_machine_code_stale(tmp_path):
    package = tmp_path / "nav_pose_estimator"
    shutil.copytree(PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__"))
    environment = os.environ | {"PYTHONPATH": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-c", STAMP]

    def stamp() -> str:
        return subprocess.run(
            command, cwd=tmp_path, env=environment, check=True, capture_output=True, text=True, timeout=300
        ).stdout

    first = stamp()
    for number in CHANGES:
        path = package / "core" / number
        before = path.read_text()
        path.touch()
        assert stamp() == first, "a touched file is the same file"
        path.write_text(CHANGES[number](before))
        assert stamp() != first
        path.write_text(before)
    assert stamp() == first
