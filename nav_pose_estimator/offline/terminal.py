"""Text for a terminal; names from untrusted files may contain control sequences of terminals."""

import sys
from collections.abc import Sequence

LONGEST = 4000  # characters of one message


def printable(text: str) -> str:
    """``text`` on one line with control characters escaped, and without the middle if it is very long."""
    if len(text) > LONGEST:
        text = f"{text[: LONGEST * 3 // 4]} ... {text[-LONGEST // 4 :]}"
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def note_left_out(name: str, why: str) -> None:
    """Tell the user on stderr that the recording ``name`` is left out."""
    print(f"note: {printable(f'{name} is left out: {why}')}", file=sys.stderr)


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table of texts, header first, with right-aligned columns."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return ["  ".join(text.rjust(width) for text, width in zip(row, widths, strict=True)) for row in rows]
