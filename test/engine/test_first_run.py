"""The first start on a machine: other processes compile the kernels, one start at a time, with a word of progress."""

import fcntl
import os
import sys
import threading

import pytest

from nav_pose_estimator.engine import first_run


@pytest.fixture
def said(tmp_path, monkeypatch) -> list[str]:
    """GIVEN a package without machine code, and in place of Python a program that says how it was called."""
    program = tmp_path / "python"
    program.write_text('#!/bin/sh\necho "[1/2] $*"\necho "[2/2] done"\n')
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))
    monkeypatch.setattr(first_run, "_FOLDER", tmp_path)
    monkeypatch.setattr(first_run, "is_first_run", lambda: True)
    return []


def test_the_first_start_has_the_kernels_compiled_and_says_how_far_it_is(said):
    first_run.compile_kernels(said.append)
    assert "takes a minute or two" in said[0]
    assert said[1:] == ["[1/2] -m nav_pose_estimator warm_up", "[2/2] done"]


def test_later_starts_say_nothing(said, monkeypatch):
    monkeypatch.setattr(first_run, "is_first_run", lambda: False)
    first_run.compile_kernels(said.append)
    assert said == []


def test_where_nothing_can_be_kept_nothing_is_compiled_ahead(said, monkeypatch):
    monkeypatch.setattr(os, "access", lambda path, mode: mode != os.W_OK)
    first_run.compile_kernels(said.append)
    assert said == []


def test_of_two_that_start_at_once_one_waits_and_finds_the_work_done(said, monkeypatch, tmp_path):
    """GIVEN a process that compiles WHEN another one starts THEN it says that it waits, and compiles nothing itself."""
    lock = os.open(tmp_path, os.O_RDONLY)
    fcntl.flock(lock, fcntl.LOCK_EX)
    waits = threading.Event()

    def tell(text: str) -> None:
        said.append(text)
        if "waiting" in text:
            waits.set()

    starting = threading.Thread(target=first_run.compile_kernels, args=(tell,))
    starting.start()
    assert waits.wait(20.0)
    monkeypatch.setattr(first_run, "is_first_run", lambda: False)
    os.close(lock)
    starting.join(20.0)
    assert not starting.is_alive()
    assert len(said) == 2


def test_a_compiler_that_fails_is_not_the_end(said, monkeypatch, tmp_path):
    (tmp_path / "python").write_text("#!/bin/sh\nexit 3\n")
    first_run.compile_kernels(said.append)
    assert len(said) == 1
