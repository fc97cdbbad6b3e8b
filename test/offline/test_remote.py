"""Recordings in object stores, here in the one that fsspec keeps in memory."""

import json
import sys
from pathlib import Path

import pytest

from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.archive.recordings import find
from nav_pose_estimator.offline.command_line import main
from nav_pose_estimator.offline.logs.open_recording import open_recording
from nav_pose_estimator.offline.logs.options import LogOptions
from nav_pose_estimator.offline.remote import at_hand, is_remote
from nav_pose_estimator.offline.training.flights import Reading, digest_of
from nav_pose_estimator.offline.training.work import identify


@pytest.fixture
def store(bag):
    """A bucket with two bags, beside one of them what is known of it, and a file that is no recording."""
    memory = pytest.importorskip("fsspec").filesystem("memory")
    memory.pipe({"/bucket/circles.json": b'{"gnss_latency_est_s": 0.25}', "/bucket/notes.md": b"windy"})
    for name in ("circles_bag", "again_bag"):
        for file in bag.iterdir():
            memory.pipe(f"/bucket/{name}/{file.name}", file.read_bytes())
    yield memory
    memory.rm("/bucket", recursive=True)


@pytest.mark.parametrize("hold", [True, False])
def test_a_bag_in_a_store_is_the_bag(store, bag, hold):
    """GIVEN a bag in a store WHEN it is opened THEN its samples are there, and no copy when they are done with."""
    here, there = (open_recording(path, LogOptions(), hold=hold) for path in (bag, Path("memory://bucket/circles_bag")))
    assert list(map(str, there.samples)) == list(map(str, here.samples))
    assert (there.name, there.duration, here.sidecar) == (here.name, here.duration, {})
    assert there.sidecar == {"gnss_latency_est_s": 0.25}
    copy = there.path
    assert copy.exists() is not hold
    del there
    assert not copy.exists()


def test_a_replay_takes_it(store, tmp_path, capsys):
    assert main(["replay", "memory://bucket/circles_bag", "--method", "coast", "--out", str(tmp_path / "out")]) == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert (summary["bag"], summary["gnss_delay_s"]) == ("circles_bag", 0.25)
    assert main(["replay", "memory://bucket/circles_bag", "--list"]) == 0
    assert "rosbag2" in capsys.readouterr().out


def test_recordings_there_are_told_apart_by_their_content(store, bag, tmp_path, capsys):
    """GIVEN a bag that is twice in a store, and another one WHEN identified THEN two recordings are left, with the
    digests that they have here; one that is not there is named."""
    for file in bag.iterdir():
        store.pipe(f"/bucket/other_bag/{file.name}", file.read_bytes() + b"0")
    names = [Path(f"memory://bucket/{name}_bag") for name in ("circles", "again", "other", "missing")]
    circles, other = identify(names, Reading())
    assert (circles.path, other.path) == (names[0], names[2])
    assert circles.digest == digest_of(bag) != other.digest
    said = capsys.readouterr().err
    assert "again_bag is the same recording" in said
    assert "missing_bag is left out: memory://bucket/missing_bag does not exist" in said


def test_patterns_and_lists_lead_into_a_store(store, bag, tmp_path):
    found = [str(path) for path in find(["memory://bucket/*_bag"])]
    assert found == ["memory:/bucket/again_bag", "memory:/bucket/circles_bag"]
    names = tmp_path / "flights.txt"
    names.write_text(f"memory://bucket/circles_bag\n{bag}\n")
    assert find([names]) == [Path("memory://bucket/circles_bag"), bag]
    with pytest.raises(UserError, match="holds no recording"):
        find(["memory://bucket/*_log"])


def test_what_is_local_stays_where_it_is(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("s3:", "bucket").mkdir(parents=True)
    for name in ("flight_bag", "/data/flight.ulg", "C:/data/flight.bin", "s3:/bucket", "a:b/c"):
        assert not is_remote(Path(name))
        with at_hand(Path(name)) as here:
            assert here == Path(name)


@pytest.mark.parametrize(
    ("url", "word"),
    [
        ("memory://bucket/missing_bag", "memory://bucket/missing_bag does not exist"),
        ("nosuchstore://bucket/flight_bag", "nosuchstore"),
    ],
)
def test_what_cannot_be_had_is_one_sentence(store, tmp_path, capsys, url, word):
    assert main(["replay", url, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert word in error
    assert "Traceback" not in error
    assert not (tmp_path / "out").exists()


def test_without_fsspec_the_sentence_names_it(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "fsspec.core", None)
    assert main(["replay", "s3://bucket/flight_bag", "--out", str(tmp_path / "out")]) == 2
    assert "s3://bucket/flight_bag is in an object store" in (error := capsys.readouterr().err)
    assert "pip install fsspec" in error
