"""The root of every error that the user can mend, and the wording of errors.

The text of a ``UserError`` is one clear sentence; commands print it and exit with 2.
"""

import difflib
from collections.abc import Collection


class UserError(ValueError):
    """Bad input or wrong use."""


def unknown(what: str, name: str, known: Collection[str]) -> str:
    """Sentence about an unknown ``name`` of ``what``, with the closest of the ``known`` ones or with all of them."""
    close = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean {close[0]!r}?" if close else f"there are {', '.join(known)}"
    return f"there is no {what} {name!r}; {hint}"


def described(error: BaseException) -> str:
    """Type and text of an exception that was not foreseen, on one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
