"""Recordings in any form: a rosbag2 folder or a single .mcap or .db3 file, compressed or not, complete or truncated."""

import heapq
import re
import stat
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory

import numpy as np
import yaml

from nav_pose_estimator.offline.bags import mcap_records
from nav_pose_estimator.offline.bags.mcap_file import McapFile
from nav_pose_estimator.offline.bags.raw_messages import BagError, RawBatch, Topic, from_payloads, merge_overlapping
from nav_pose_estimator.offline.bags.sqlite_file import SqliteFile
from nav_pose_estimator.offline.bags.unpacking import (
    LARGEST_CHUNK,
    LARGEST_MESSAGE,
    ZSTD_MAGIC,
    DamagedError,
    unpack,
    unpack_file,
)
from nav_pose_estimator.offline.safe_yaml import read_yaml

STORAGES: dict[str, type[McapFile] | type[SqliteFile]] = {".mcap": McapFile, ".db3": SqliteFile}
COMPRESSED = ".zstd"
_MAGIC: dict[bytes, type[McapFile] | type[SqliteFile]] = {
    mcap_records.MAGIC: McapFile,
    b"SQLite format 3\0": SqliteFile,
}
ROS1_MAGIC = b"#ROSBAG V"
_LONGEST_NAME = 512  # characters; ROS allows 255
_LARGEST_DEFINITION = 1 << 18  # characters
_FIXED_ARRAY = re.compile(r"\[\s*(\d+)\s*\]")
_LARGEST_ARRAY = 100_000  # elements of an array of fixed length, for all of which decoding allocates memory

AnyFile = McapFile | SqliteFile


class Bag:
    """A recording. ``topics`` by name; ``warnings`` lists what was damaged or assumed, once each."""

    def __init__(self, path: Path) -> None:
        """Open ``path``. Raises ``BagError`` if it is not a recording."""
        self.path = Path(path)
        self._warnings: list[str] = []
        self._stack = ExitStack()
        self._damaged_messages = 0
        try:
            self._files = self._open_all(self._find_files())
            self.topics = self._join_topics()
            self._refuse_ros1()
            self._groups = _overlapping(self._files)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> "Bag":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def warnings(self) -> list[str]:
        """Sentences about damage and assumptions so far; reading can add some."""
        found = self._warnings + [text for file in self._files for text in file.warnings]
        if self._damaged_messages:
            found.append(f"{self._damaged_messages} compressed messages cannot be unpacked and were left out")
        return found

    def close(self) -> None:
        """Close the files and remove temporary copies."""
        self._stack.close()

    def batches(self, names: list[str]) -> Iterator[RawBatch]:
        """Yield serialized messages of the topics ``names`` in receive-time order."""
        for group in self._groups:
            if len(group) == 1:
                merged = group[0].batches(names)
            else:
                merged = merge_overlapping(heapq.merge(*(_timed(file, names) for file in group), key=lambda p: p[0]))
            for batch in merged:
                if len(ready := self._unpacked(batch)):
                    yield ready

    def _find_files(self) -> list[Path]:
        if not self.path.exists():
            raise BagError(f"{self.path} does not exist")
        if self.path.is_file():
            return [self.path]
        if not self.path.is_dir():
            raise BagError(f"{self.path} is neither a file nor a folder")
        listed, found = self._listed_files(), _storage_files(self.path)
        missing = [file.name for file in listed if not file.exists()]
        if listed and not missing:
            return listed
        if missing:
            trouble = f"lacks {_some(missing)}, listed in metadata.yaml"
        elif found:
            trouble = "has no usable metadata.yaml"
        else:
            raise BagError(_no_bag(self.path))
        if not found:
            raise BagError(f"{self.path} {trouble}: it holds no recorded data")
        self._warnings.append(f"{self.path.name} {trouble}: reading the files found in it")
        return found

    def _listed_files(self) -> list[Path]:
        """Files that metadata.yaml lists, existing or not; empty if there is no such list."""
        metadata = self.path / "metadata.yaml"
        if not metadata.is_file():
            return []
        try:
            content = read_yaml(metadata)["rosbag2_bagfile_information"]
            files = [self.path / PurePath(name).name for name in content["relative_file_paths"]]
        except (yaml.YAMLError, KeyError, TypeError):
            return []
        return list(dict.fromkeys(files))

    def _open_all(self, paths: list[Path]) -> list[AnyFile]:
        """The files of a recording; of several, those that cannot be read are left out."""
        if len(paths) == 1:
            return [self._open(paths[0])]
        files, unreadable = [], []
        for path in paths:
            try:
                files.append(self._open(path))
            except BagError as error:
                unreadable.append(error)
        if not files:
            raise unreadable[0]
        self._warnings += [f"{error}: left out" for error in unreadable]
        return files

    def _open(self, path: Path) -> AnyFile:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):  # reading a pipe could block for ever
            raise BagError(f"{path} is not a file with data")
        with path.open("rb") as content:
            if content.read(len(ROS1_MAGIC)) == ROS1_MAGIC:
                raise BagError(f"{path} is a ROS 1 bag: {_ros1_cure(path.name)}")
        given, path = path, self._unpack(path) if path.suffix == COMPRESSED else path
        try:
            file = _storage_of(path)(path)
        except BagError as error:  # it may name the unpacked file, which is removed
            raise BagError(str(error).replace(str(path), str(given))) from None
        self._stack.callback(file.close)
        return file

    def _unpack(self, path: Path) -> Path:
        folder = self._stack.enter_context(TemporaryDirectory(prefix="nav_pose_estimator_"))
        target = Path(folder, path.stem)
        if damage := unpack_file(path, target):
            self._warnings.append(damage)
        return target

    def _unpacked(self, batch: RawBatch) -> RawBatch:
        """The batch with individually compressed messages unpacked; they are recognised by their first bytes."""
        long_enough = np.flatnonzero(batch.lengths >= len(ZSTD_MAGIC))
        first = np.frombuffer(batch.data, np.uint8)[batch.offsets[long_enough]]
        packed = set(long_enough[first == ZSTD_MAGIC[0]].tolist())  # serialized messages begin with zero
        if not packed:
            return batch
        room = LARGEST_CHUNK
        kept, payloads = [], []
        for i in range(len(batch)):
            payload = batch.payload(i)
            if i in packed and payload.startswith(ZSTD_MAGIC):
                try:
                    payload = unpack(payload, "zstd", min(room, LARGEST_MESSAGE))
                except DamagedError:
                    self._damaged_messages += 1
                    continue
                room -= len(payload)
            kept.append(i)
            payloads.append(payload)
        return from_payloads(batch.times[kept].tolist(), batch.topics[kept].tolist(), payloads)

    def _join_topics(self) -> dict[str, Topic]:
        joined: dict[str, Topic] = {}
        for topic in (topic for file in self._files for topic in file.topics):
            if len(topic.name) > _LONGEST_NAME or len(topic.type) > _LONGEST_NAME:
                self._warnings.append(f"a topic was left out: its name or type has over {_LONGEST_NAME} characters")
                continue
            count = topic.count + (joined[topic.name].count if topic.name in joined else 0)
            definition = topic.definition if _is_sound(topic.definition) else ""
            if topic.definition and not definition:
                self._warnings.append(f"the definition of {topic.type} is too large and was left out")
            joined[topic.name] = Topic(topic.name, topic.type, count, topic.encoding, definition)
        return joined

    def _refuse_ros1(self) -> None:
        kinds = self.topics.values()
        if kinds and all(topic.encoding == "ros1" or topic.type.count("/") == 1 for topic in kinds):
            raise BagError(f"{self.path} holds ROS 1 messages: {_ros1_cure('FLIGHT.bag')}")


def _storage_files(folder: Path) -> list[Path]:
    """The files in ``folder`` with recorded data, by their names; not both a file and its compressed copy."""
    endings = (*STORAGES, *(ending + COMPRESSED for ending in STORAGES))
    files = sorted((file for file in folder.iterdir() if file.name.endswith(endings)), key=_natural)
    return [file for file in files if file.suffix != COMPRESSED or file.with_suffix("") not in files]


def _storage_of(path: Path) -> type[AnyFile]:
    """Reader of ``path``, by the first bytes, or else by the name. Raises ``BagError``."""
    with path.open("rb") as content:
        head = content.read(max(map(len, _MAGIC)))
    for magic, storage in _MAGIC.items():
        if head.startswith(magic):
            return storage
    if path.suffix not in STORAGES:
        raise BagError(f"{path} is neither a rosbag2 (folder, .mcap, .db3) nor a PX4 or ArduPilot log")
    if not head:
        raise BagError(f"{path} is empty")
    return STORAGES[path.suffix]


def _no_bag(folder: Path) -> str:
    bags = sorted(path.parent.name for path in folder.glob("*/metadata.yaml"))
    where = f"; give one of the bags below it: {_some(bags)}" if bags else ""
    return f"{folder} is not a rosbag2: it holds neither metadata.yaml nor a .mcap or .db3 file{where}"


def _some(names: list[str]) -> str:
    """Clause that names the first of ``names`` and counts the others."""
    return names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more"


def _ros1_cure(name: str) -> str:
    stem = name.removesuffix(".bag")
    return (
        "convert the original .bag to ROS 2, for example with "
        f"'rosbags-convert --src {stem}.bag --dst {stem} --dst-typestore ros2_jazzy'"
    )


def _is_sound(definition: str) -> bool:
    if len(definition) > _LARGEST_DEFINITION:
        return False
    return all(len(size) < 10 and int(size) <= _LARGEST_ARRAY for size in _FIXED_ARRAY.findall(definition))


def _natural(path: Path) -> list[tuple[int, str]]:
    """Sort key of file names that puts bag_2 before bag_10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d{1,18})", path.name)]


def _timed(file: AnyFile, names: list[str]) -> Iterator[tuple[int, RawBatch]]:
    return ((int(batch.times[0]), batch) for batch in file.batches(names) if len(batch))


def _overlapping(files: list[AnyFile]) -> list[list[AnyFile]]:
    """Files in order of time, grouped where they overlap; files without times keep their place."""
    if len(files) == 1:  # its time range is not needed, and may take long to find
        return [files]
    before, spans = 0, []
    for file in files:
        start, end = file.span or (before, before)
        spans.append((start, end, file))
        before = start
    groups: list[list[AnyFile]] = []
    reach = 0
    for start, end, file in sorted(spans, key=lambda span: span[0]):
        if groups and start < reach:
            groups[-1].append(file)
        else:
            groups.append([file])
        reach = max(reach, end)
    return groups
