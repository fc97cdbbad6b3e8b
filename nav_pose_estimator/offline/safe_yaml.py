"""Parsing of untrusted YAML (the metadata of bags), without aliases, deep nesting and huge documents.

Aliases can expand to a tree that doubles with each line, and deep nesting overflows the stack of libyaml. Both are
detected in the stream of events, before any object is created.
"""

import stat
from pathlib import Path
from typing import Any

import yaml

LARGEST_FILE = 4 << 20  # bytes
DEEPEST = 64  # levels of nested collections
MOST_NODES = 200_000


class YamlError(yaml.YAMLError):
    """The document is not YAML, or exceeds a limit. The text is one line."""


_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # libyaml may be absent


def read_yaml(path: Path) -> Any:
    """Parse the file ``path``. Raises ``YamlError``, and ``OSError`` for a file that cannot be read."""
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):  # reading a pipe could block for ever
        raise YamlError("it is not a file")
    if status.st_size > LARGEST_FILE:
        raise YamlError(f"it is larger than {LARGEST_FILE >> 20} MB")
    try:
        return parse_yaml(path.read_text(encoding="utf-8"))
    except UnicodeDecodeError as error:
        raise YamlError(f"it is not UTF-8 ({error.reason} at byte {error.start})") from None


def parse_yaml(text: str) -> Any:
    """Parse the document ``text``. Raises ``YamlError``."""
    try:
        _check(text)
        return yaml.load(text, _Loader)
    except YamlError:
        raise
    except yaml.YAMLError as error:
        raise YamlError(" ".join(str(error).split())) from None
    except (ValueError, OverflowError, RecursionError) as error:  # the 40th of May, or a number with 5000 digits
        raise YamlError(f"a value cannot be read ({error})") from None


def _check(text: str) -> None:
    depth = nodes = 0
    for event in yaml.parse(text, _Loader):
        nodes += isinstance(event, yaml.NodeEvent)
        if isinstance(event, yaml.AliasEvent):
            raise YamlError(f"it refers to &{event.anchor} with an alias, which is not allowed here")
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if depth > DEEPEST:
            raise YamlError(f"it is nested more than {DEEPEST} levels deep")
        if nodes > MOST_NODES:
            raise YamlError(f"it has more than {MOST_NODES} values")
