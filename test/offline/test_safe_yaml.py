"""YAML from strangers ends in plain data or in one line, soon."""

import os
import random

import pytest

from nav_pose_estimator.offline.safe_yaml import LARGEST_FILE, YamlError, parse_yaml, read_yaml

ALIASES = "a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]\n"
HOSTILE = {
    "alias bomb": (ALIASES, "refers to &a with an alias"),
    "brackets": ("[" * 100_000, "nested more than|nesting depth"),
    "dashes": ("- " * 100_000, "nested more than"),
    "indentation": ("\n".join(" " * i + "a:" for i in range(1000)), "nested more than"),
    "braces": ("{a: " * 100_000, "nested more than|nesting depth"),
    "many values": ("[" + "1," * 300_000 + "]", "more than 200000 values"),
    "impossible date": ("a: 2020-45-40", "cannot be read"),
    "endless number": ("a: " + "9" * 5000, "cannot be read"),
    "unhashable key": ("? [a]\n: b", "unhashable"),
    "tag": ("!!python/object/apply:os.system [ls]", "tag"),
    "unclosed": ("a: [1, 2", "expected"),
    "control characters": ("a: \x00\x1b", "not allowed"),
}


@pytest.mark.parametrize(("text", "words"), HOSTILE.values(), ids=HOSTILE)
def test_a_hostile_document_is_one_line(text, words):
    with pytest.raises(YamlError, match=words) as caught:
        parse_yaml(text)
    assert "\n" not in str(caught.value)


def test_files_that_are_none_or_too_large_are_refused(tmp_path):
    pipe = tmp_path / "pipe.yaml"
    os.mkfifo(pipe)
    large = tmp_path / "large.yaml"
    large.write_bytes(b"#" * (LARGEST_FILE + 1))
    latin = tmp_path / "latin.yaml"
    latin.write_bytes("a: ä".encode("latin-1"))
    for path, words in ((pipe, "not a file"), (large, "larger"), (latin, "UTF-8")):
        with pytest.raises(YamlError, match=words):
            read_yaml(path)
    with pytest.raises(FileNotFoundError):
        read_yaml(tmp_path / "absent.yaml")


def test_mutated_documents_end_as_data_or_one_line():
    """300 seeded mutations of a bag's metadata."""
    generator = random.Random(7)
    good = "rosbag2_bagfile_information:\n  version: 9\n  relative_file_paths:\n    - a_0.mcap\n  duration: {n: 1}\n"
    for _ in range(300):
        characters = list(good)
        for _ in range(generator.randint(1, 6)):
            characters[generator.randrange(len(characters))] = generator.choice("[]{}&*!|>%@`\"'#:,- \t\n\x00\x7f9e")
        told = ""
        try:
            parse_yaml("".join(characters))
        except YamlError as error:
            told = str(error)
        assert "\n" not in told
