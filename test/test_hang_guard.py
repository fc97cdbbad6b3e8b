"""The watchdog of the tests: what hangs is one failed test with its stack, and the run goes on to its end."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("xdist", reason="needs pytest-xdist (requirements-dev.txt)")
HANGING = """
import ctypes
import pytest

@pytest.mark.parametrize("i", range(3))
def test_before(i):
    pass

def test_hangs():
    ctypes.PyDLL(None).sleep(1000)  # PyDLL keeps the interpreter's lock, as the creation of a participant does

@pytest.mark.parametrize("i", range(3))
def test_after(i):
    pass
"""
HOOK = "from hang_guard import pytest_runtest_protocol as pytest_runtest_protocol\n"


def test_a_test_that_hangs_in_c_costs_itself_and_not_the_run(tmp_path: Path, repository: Path) -> None:
    """GIVEN a test that hangs in C with the interpreter's lock held WHEN the suite runs as ``make test`` runs it
    THEN that test fails, its stack is on the terminal, and every other test runs once."""
    (tmp_path / "test_hanging.py").write_text(HANGING)
    (tmp_path / "conftest.py").write_text(HOOK)
    scheduler = (repository / "Makefile").read_text().split("--dist ")[1].split()[0]
    environment = dict(os.environ, PYTHONPATH=str(repository / "test" / "helpers"), NAV_POSE_TEST_LIMIT="5")
    call = [sys.executable, "-m", "pytest", "-q", "-n", "2", "--dist", scheduler, "-p", "no:cacheprovider", "."]
    done = subprocess.run(call, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=200)
    assert "1 failed, 6 passed" in done.stdout, done.stdout + done.stderr
    assert "crashed while running 'test_hanging.py::test_hangs'" in done.stdout
    assert "in test_hangs" in done.stderr
