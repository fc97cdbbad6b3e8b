"""Text for a terminal: names come from untrusted files and may hold what a terminal takes as commands."""

from collections.abc import Sequence

LONGEST = 4000  # characters of one message


def printable(text: str) -> str:
    """``text`` on one line, control characters as escapes, the middle of very long texts left out."""
    if len(text) > LONGEST:
        text = f"{text[: LONGEST * 3 // 4]} ... {text[-LONGEST // 4 :]}"
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """A table of texts, header first, as lines: columns flush right."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return ["  ".join(text.rjust(width) for text, width in zip(row, widths, strict=True)) for row in rows]
