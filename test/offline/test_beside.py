"""Work in a copy of the process beside this one: it is done once the body is, whatever becomes of the copy."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from nav_pose_estimator.offline.replay.beside import beside

needs_two_cores = pytest.mark.skipif(
    not hasattr(os, "sched_getaffinity") or len(os.sched_getaffinity(0)) < 2, reason="there is one core"
)


@pytest.fixture
def told(tmp_path) -> Path:
    return tmp_path / "process"


def tell(told: Path, here: int | None = None) -> None:
    """Write the process that works; one other than ``here`` is killed before."""
    if here not in (None, os.getpid()):
        os.kill(os.getpid(), signal.SIGKILL)
    told.write_text(str(os.getpid()))


@needs_two_cores
def test_work_is_done_in_another_process(told):
    with beside(lambda: tell(told)):
        pass
    assert int(told.read_text()) != os.getpid()


def test_with_one_core_work_is_done_here_after_the_body(told, monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0}, raising=False)
    with beside(lambda: tell(told)):
        assert not told.exists()
    assert int(told.read_text()) == os.getpid()


@needs_two_cores
def test_work_whose_copy_is_killed_is_done_here(told):
    here = os.getpid()
    with beside(lambda: tell(told, here)):
        pass
    assert int(told.read_text()) == here


def test_what_the_work_raises_is_raised(tmp_path):
    """GIVEN work that cannot be done WHEN the body ends THEN the reason is raised here, with its text."""
    with pytest.raises(FileNotFoundError) as raised, beside(lambda: tell(tmp_path / "missing" / "process")):
        pass
    assert raised.value.filename.endswith("missing/process")


@needs_two_cores
def test_a_body_that_fails_ends_the_copy(told):
    """GIVEN a copy in the middle of its work WHEN the body fails THEN the work is ended, and not begun again."""
    reader, writer = os.pipe()

    def work() -> None:
        os.write(writer, b"begun")
        signal.sigtimedwait([], 20.0)
        tell(told)

    def fail_meanwhile() -> None:
        os.close(writer)
        assert os.read(reader, 5) == b"begun"
        raise ValueError("the body")

    with pytest.raises(ValueError, match="the body"), beside(work):
        fail_meanwhile()
    os.close(reader)
    assert not told.exists()


def test_only_the_copy_imports_rosbags():
    """GIVEN the modules that read and fly a bag THEN they do without rosbags, which takes 0.1 s to import."""
    modules = "import nav_pose_estimator.offline.bags.reader, nav_pose_estimator.offline.replay.report"
    code = f"{modules}, sys; print('rosbags' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True, timeout=300)
    assert done.stdout == "False\n"
