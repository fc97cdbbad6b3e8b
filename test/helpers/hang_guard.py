"""Watchdog for tests that hang, so that only such a test fails and not the whole run.

A DDS participant can hang in C++ while it holds the interpreter's lock, so that neither exceptions nor Python threads
can interrupt it. Therefore a watchdog in C prints the stacks of all threads and ends the process. xdist counts the test
as failed and continues with another worker. This needs its scheduler ``worksteal``: ``loadfile`` of 3.8 runs the test
again, or waits for ever for the lost worker.
"""

import faulthandler
import os
from collections.abc import Iterator

import pytest
from _pytest.faulthandler import fault_handler_stderr_fd_key

LONGEST = float(os.environ.get("NAV_POSE_TEST_LIMIT", "600"))  # s that a test with its fixtures may take


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Watch ``item``; the stacks go to the terminal, not to what pytest captures."""
    faulthandler.dump_traceback_later(LONGEST, exit=True, file=item.config.stash[fault_handler_stderr_fd_key])
    try:
        return (yield)
    finally:
        faulthandler.cancel_dump_traceback_later()
