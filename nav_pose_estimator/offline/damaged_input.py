"""Turns whatever a damaged or hostile file leads to into one sentence for the user."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from nav_pose_estimator.errors import UserError


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Around all reading of the recording ``path``: raises ``UserError`` for anything that goes wrong inside.

    Checks where a file is read give better sentences; this one makes sure that none is missing.
    """
    try:
        yield
    except UserError:
        raise
    except OSError as error:
        raise UserError(f"{error.filename or path} cannot be read ({error.strerror or error})") from error
    except MemoryError as error:
        raise UserError(
            f"{path} needs more memory than is available: it is damaged, or too long for this machine"
        ) from error
    except Exception as error:
        what = f"{type(error).__name__}: {error}"
        raise UserError(f"{path} is damaged or in an unsupported format ({what})") from error
