"""Conversion of every exception while reading a damaged or hostile file to one sentence for the user."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from nav_pose_estimator.errors import UserError, described


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Context in which the recording ``path`` is read; any exception in it becomes a ``UserError``.

    Explicit checks in the readers give better sentences; this context covers what they do not.
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
        raise UserError(f"{path} is damaged or in an unsupported format ({described(error)})") from error
