"""A test that hangs costs that test, never the run.

A participant of DDS can hang in C++ with the interpreter's lock held: no exception and no other Python thread gets in
between. So a watchdog in C prints the stack of every thread and ends the process. xdist counts the test as failed and
goes on with another worker, for which its scheduler has to be ``worksteal``: ``loadfile`` of 3.8 runs the test again,
or waits for ever for the worker that is gone.
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
