"""Imports without garbage collection: nothing that a module defines becomes garbage."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager

_done = False


@contextmanager
def without_garbage_collection() -> Iterator[None]:
    """Import modules for a command. All objects of that time are never searched for garbage later either.

    Otherwise the search takes a tenth of the time of the imports, and again as much in a flight. Only the first use in
    a process has this effect, so that nothing that is garbage by then is kept over and over again.
    """
    global _done
    if _done or not gc.isenabled():
        yield
        return
    _done = True
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()
