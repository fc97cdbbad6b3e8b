"""Signals that arrive in a callback from C, in which Python ignores exceptions."""

import ctypes
import signal
import sys
import time
from collections.abc import Callable

import pytest

from nav_pose_estimator.offline.ending_signals import interruptible, outside_callbacks
from nav_pose_estimator.offline.output_folder import OutputFolder

LONGEST = 10.0  # s that a signal may take


def in_callback(number: int) -> None:
    """``number`` arrives while code runs that C has called, under the name of llvmlite's."""

    def _raw_object_cache_notify() -> None:
        signal.raise_signal(number)

    ctypes.CFUNCTYPE(None)(_raw_object_cache_notify)()


def wait(is_over: Callable[[], bool] = lambda: False) -> None:
    end = time.monotonic() + LONGEST
    while not is_over() and time.monotonic() < end:
        time.sleep(0.001)


def await_after_callback(number: int) -> None:
    in_callback(number)
    wait()


@pytest.fixture
def ignored(monkeypatch) -> list[object]:
    """Exceptions that Python has ignored."""
    found: list[object] = []
    monkeypatch.setattr(sys, "unraisablehook", found.append)
    return found


def test_an_interrupt_in_a_callback_comes_after_it(ignored):
    with pytest.raises(KeyboardInterrupt), interruptible():
        await_after_callback(signal.SIGINT)
    assert not ignored
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_the_end_of_a_run_in_a_callback_comes_after_it(ignored, tmp_path):
    with pytest.raises(SystemExit), OutputFolder(tmp_path / "out", "replay"):
        await_after_callback(signal.SIGTERM)
    assert not ignored
    assert not list(tmp_path.iterdir())


def test_elsewhere_the_handler_is_called_at_once():
    calls: list[int] = []
    before = signal.signal(signal.SIGUSR1, outside_callbacks(lambda number, frame: calls.append(number)))
    try:
        signal.raise_signal(signal.SIGUSR1)
        assert calls == [signal.SIGUSR1]
        in_callback(signal.SIGUSR1)
        wait(lambda: len(calls) == 2)
    finally:
        signal.signal(signal.SIGUSR1, before)
    assert calls == [signal.SIGUSR1] * 2
