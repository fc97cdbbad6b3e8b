"""Damaged, cut off and foreign files: read as far as they go, else one sentence; never an error of Python's own."""

from pathlib import Path

import numpy as np
import pytest

from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.bags.raw_messages import BagError
from nav_pose_estimator.offline.command_line import main
from nav_pose_estimator.offline.logs.open_recording import open_recording, read_sensors
from nav_pose_estimator.offline.logs.options import LogOptions
from small_logs import ardupilot, flight, px4, write

SECONDS = 12.0
KINDS = ("ulg", "bin", "log")


@pytest.fixture(scope="module")
def contents() -> dict[str, bytes]:
    flown = flight(SECONDS)
    log = ardupilot(flown)
    return {"ulg": px4(flown).encode(), "bin": log.encode(), "log": log.text().encode()}


def test_garbage_between_messages_of_dataflash_is_counted_and_skipped(contents, tmp_path):
    """GIVEN 100 bytes of garbage before the thousandth message, THEN every message is still read."""
    whole = contents["bin"]
    place = [i for i in range(len(whole) // 2, len(whole)) if whole[i : i + 2] == b"\xa3\x95"][3]
    garbage = np.random.default_rng(1).integers(0, 160, 100, np.uint8).tobytes()  # without the bytes of a header
    path = write(tmp_path / "a.bin", whole[:place] + garbage + whole[place:])
    sound = read_sensors(write(tmp_path / "b.bin", whole))
    found = read_sensors(path)
    assert found.counters["log.garbage_bytes"] == 100
    assert any("100 bytes in 1 place" in text for text in found.notices)
    assert len(found.imus[0].time_us) == len(sound.imus[0].time_us)


def test_a_message_that_lost_bytes_is_left_out_and_the_next_one_is_read(contents, tmp_path):
    whole = contents["bin"]
    place = [i for i in range(len(whole) // 2, len(whole)) if whole[i : i + 2] == b"\xa3\x95"][3]
    found = read_sensors(write(tmp_path / "a.bin", whole[: place + 7] + whole[place + 11 :]))
    sound = read_sensors(write(tmp_path / "b.bin", whole))
    lost = sum(len(s.time_us) for s in (*sound.imus, *sound.gnss, *sound.others))
    lost -= sum(len(s.time_us) for s in (*found.imus, *found.gnss, *found.others))
    assert 0 <= lost <= 1
    assert found.counters["log.garbage_bytes"] > 0


def test_garbage_in_an_ulog_is_told(contents, tmp_path):
    whole = contents["ulg"]
    half = len(whole) // 2
    found = read_sensors(write(tmp_path / "a.ulg", whole[:half] + bytes(50) + whole[half:]))
    assert any("is damaged" in text for text in found.notices)
    assert len(found.imus[0].time_us) > 400


def test_lines_that_are_no_messages_are_counted(contents, tmp_path):
    lines = contents["log"].decode().splitlines()
    lines[500:500] = ["IMU, 17, 0.1", "nonsense", "IMU, x, 0, y, 0, 0, 0, 0, 0"]
    found = read_sensors(write(tmp_path / "a.log", "\n".join(lines)))
    assert any(text.startswith("3 lines") for text in found.notices)
    assert len(found.imus[0].time_us) == round(SECONDS * 100) + 1


@pytest.mark.parametrize("kind", KINDS)
def test_a_log_that_was_cut_off_is_read_to_its_end(contents, tmp_path, kind):
    whole = contents[kind]
    found = open_recording(write(tmp_path / f"a.{kind}", whole[: round(len(whole) * 0.8) + 3]), LogOptions())
    assert 0.6 * SECONDS < found.duration < SECONDS
    assert kind == "log" or any("ends in the middle of a message" in text for text in found.notices)


@pytest.mark.parametrize("kind", KINDS)
def test_no_damage_ends_in_an_error_of_pythons_own(contents, tmp_path, kind):
    """GIVEN files cut anywhere, with bytes changed, lost and repeated, THEN they are read, or one sentence says why."""
    random = np.random.default_rng(7)
    whole = np.frombuffer(contents[kind], np.uint8)
    refused = []
    for trial in range(60):
        data = whole[: random.integers(1, len(whole))] if trial % 3 == 0 else whole.copy()
        if trial % 3 == 1:
            places = random.integers(0, min(len(data), 4000 if trial % 2 else len(data)), 1 + trial)
            data[places] = random.integers(0, 256, len(places))
        if trial % 3 == 2:
            a, b = sorted(random.integers(0, len(data), 2).tolist())
            data = np.concatenate([data[:a], data[b:], data[a : a + 500]])
        path = write(tmp_path / f"damaged.{kind}", data.tobytes())
        try:
            open_recording(path, LogOptions())
        except UserError as error:
            refused.append(str(error))
    assert all(text.isprintable() for text in refused)
    assert len(refused) < 60


FOREIGN = {
    "empty.ulg": b"",
    "empty.bin": b"",
    "picture.ulg": b"\x89PNG\r\n\x1a\n" + bytes(100),
    "text.bin": b"this is no log\n" * 20,
    "other.log": b"2024-01-01 INFO started\n" * 20,
    "head_only.ulg": b"ULog\x01\x12\x35\x01",
    "header.bin": b"\xa3\x95\x80",
    "flight.tlog": bytes(100),
    "zeros.bin": bytes(5000),
}


@pytest.mark.parametrize("name", FOREIGN)
@pytest.mark.parametrize("command", ["replay", "convert", "benchmark", "list"])
def test_what_is_no_log_is_refused_in_one_sentence(tmp_path, capsys, name, command):
    path = str(write(tmp_path / name, FOREIGN[name]))
    assert main(_arguments(command, path, tmp_path)) == 2
    said = capsys.readouterr().err.strip()
    assert name in said
    assert "\n" not in said


@pytest.mark.parametrize("command", ["replay", "convert", "benchmark", "list"])
def test_a_missing_file_and_a_folder_are_refused(tmp_path, capsys, command):
    folder = tmp_path / "folder.ulg"
    folder.mkdir()
    for path in (tmp_path / "missing.ulg", folder):
        assert main(_arguments(command, str(path), tmp_path)) == 2
        assert capsys.readouterr().err.strip().count("\n") == 0


def _arguments(command: str, path: str, folder: Path) -> list[str]:
    return {
        "replay": ["replay", path, "--out", str(folder / "out")],
        "list": ["replay", path, "--list"],
        "convert": ["convert", path, str(folder / "bag")],
        "benchmark": ["benchmark", "outage", path, "--out", str(folder / "out")],
    }[command]


def test_without_pyulog_the_sentence_says_what_to_install(contents, tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pyulog", None)
    with pytest.raises(BagError, match="pip install pyulog"):
        read_sensors(write(tmp_path / "a.ulg", contents["ulg"]))
