"""Opening a recording in any form: a rosbag2 folder, a bare .mcap or .db3 file, compressed or not, whole or not."""

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path, PurePath
from shutil import copyfileobj
from tempfile import TemporaryDirectory

import yaml

from nav_pose_estimator.offline.bags.mcap_file import McapFile, zstandard
from nav_pose_estimator.offline.bags.raw_messages import BagError, RawBatch, Topic, from_payloads
from nav_pose_estimator.offline.bags.sqlite_file import SqliteFile

STORAGES: dict[str, type[McapFile] | type[SqliteFile]] = {".mcap": McapFile, ".db3": SqliteFile}
COMPRESSED = ".zstd"


class Bag:
    """A recording. ``topics`` by name; ``warnings`` lists what was damaged or assumed, once each."""

    def __init__(self, path: Path) -> None:
        """Open ``path``. Raises ``BagError`` with one sentence when that is no recording."""
        self.path = Path(path)
        self._warnings: list[str] = []
        self._stack = ExitStack()
        self._compressed_messages = False
        try:
            self._files = [self._open(file) for file in self._find_files()]
        except BaseException:
            self.close()
            raise
        self.topics = self._join_topics()

    def __enter__(self) -> "Bag":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def warnings(self) -> list[str]:
        """What was damaged or assumed so far; reading can add to it."""
        return self._warnings + [text for file in self._files for text in file.warnings]

    def close(self) -> None:
        """Release files and temporary copies."""
        self._stack.close()

    def batches(self, names: list[str]) -> Iterator[RawBatch]:
        """Serialized messages of the topics ``names`` in receive-time order."""
        for file in self._files:
            for batch in file.batches(names):
                yield self._decompress(batch) if self._compressed_messages else batch

    def _find_files(self) -> list[Path]:
        if not self.path.exists():
            raise BagError(f"{self.path} does not exist")
        if self.path.is_file():
            return [self.path]
        files = self._listed_files()
        if files is None:
            endings = (*STORAGES, *(ending + COMPRESSED for ending in STORAGES))
            files = sorted(file for file in self.path.iterdir() if file.name.endswith(endings))
            if not files:
                raise BagError(f"{self.path} is no rosbag2: it holds neither metadata.yaml nor a .mcap or .db3 file")
            self._warnings.append(f"{self.path.name} has no usable metadata.yaml: reading the files found in it")
        return files

    def _listed_files(self) -> list[Path] | None:
        """The files that metadata.yaml names; None if there is no such list."""
        metadata = self.path / "metadata.yaml"
        if not metadata.is_file():
            return None
        try:
            loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
            content = yaml.load(metadata.read_text(encoding="utf-8"), loader)["rosbag2_bagfile_information"]
            files = [self.path / PurePath(name).name for name in content["relative_file_paths"]]
        except (yaml.YAMLError, KeyError, TypeError, UnicodeDecodeError):
            return None
        if missing := [file.name for file in files if not file.exists()]:
            raise BagError(f"{self.path} is incomplete: {', '.join(missing)} is missing")
        if str(content.get("compression_mode", "")).lower() == "message":
            self._compressed_messages = True
        return files or None

    def _open(self, path: Path) -> McapFile | SqliteFile:
        if path.suffix == COMPRESSED:
            path = self._unpack(path)
        if path.suffix not in STORAGES:
            raise BagError(f"{path} is no rosbag2: give a bag folder, a .mcap or a .db3 file")
        if path.stat().st_size == 0:
            raise BagError(f"{path} is empty")
        file = STORAGES[path.suffix](path)
        self._stack.callback(file.close)
        return file

    def _unpack(self, path: Path) -> Path:
        zstd = zstandard()
        folder = self._stack.enter_context(TemporaryDirectory(prefix="nav_pose_estimator_"))
        target = Path(folder, path.stem)
        try:
            with path.open("rb") as packed, zstd.open(packed, "rb") as source, target.open("wb") as out:
                copyfileobj(source, out, 1 << 20)
        except (zstd.ZstdError, EOFError) as error:
            self._warnings.append(f"{path.name} is damaged ({error}): reading what could be unpacked")
        return target

    def _decompress(self, batch: RawBatch) -> RawBatch:
        decompress = zstandard().decompress
        payloads = [decompress(batch.payload(i)) for i in range(len(batch))]
        return from_payloads(batch.times.tolist(), batch.topics.tolist(), payloads)

    def _join_topics(self) -> dict[str, Topic]:
        joined: dict[str, Topic] = {}
        for topic in (topic for file in self._files for topic in file.topics):
            count = topic.count + (joined[topic.name].count if topic.name in joined else 0)
            joined[topic.name] = Topic(topic.name, topic.type, count, topic.encoding, topic.definition)
        return joined
