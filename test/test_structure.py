"""The house rules that a machine can check: who imports whom, how long a file is, what may not stand in it."""

import ast
import re
import subprocess
from collections.abc import Callable, Iterator
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
PACKAGE = REPOSITORY / "nav_pose_estimator"
NAME = PACKAGE.name
MODULES = sorted(PACKAGE.rglob("*.py"))
TESTS = sorted((REPOSITORY / "test").rglob("*.py"))

# Each room may import itself and these. A part is a room and all the rooms in it.
CORE = {"core.numerics", "core.earth"}
MAY_IMPORT: dict[str, set[str]] = {
    "core.numerics": set(),
    "core.earth": {"core.numerics"},
    "core.filter": CORE,
    "core.routine": {*CORE, "core.filter", "core.gnss"},
    "core.alignment": {*CORE, "core.filter"},
    "core.gnss": {*CORE, "core.filter"},
    "core.attitude": {"core.numerics"},
    "core.beams": {*CORE, "core.filter"},
    "core.learning": {"core.numerics"},
    "core.motion": {*CORE, "core.filter", "core.learning"},
    "engine": {"core"},  # samples, observations, solutions: what all engines speak of
    "engine.events": set(),
    "engine.outage.methods": {"core.earth", "core.motion", "engine"},
    "engine.parameters": {"core.filter", "core.motion", "engine.outage.methods"},  # their choices
    "engine.imu": {"core", "engine", "engine.parameters"},
    "engine.sensors": {"core", "engine", "engine.parameters", "engine.imu", "engine.sensors.*"},
    "engine.sensors.beams": {"core", "engine", "engine.imu", "engine.parameters"},
    "engine.sensors.magnetic": {"core", "engine", "engine.imu", "engine.parameters"},
    "engine.sensors.gyroscope": {"core", "engine", "engine.parameters", "engine.sensors"},
    "engine.sensors.gnss": {"core", "engine", "engine.events", "engine.parameters", "engine.sensors"},
    "engine.sensors.routine": {"core", "engine", "engine.parameters", "engine.sensors", "engine.sensors.gnss"},
    "engine.attitude": {"core", "engine", "engine.parameters", "engine.imu", "engine.sensors.*"},
    "engine.continuation": {"core", "engine", "engine.parameters"},
    "engine.navigator": {
        "core", "engine", "engine.parameters", "engine.imu", "engine.sensors.*", "engine.continuation"
    },
    "engine.outage": {
        "core", "engine", "engine.parameters", "engine.imu", "engine.sensors", "engine.navigator",
        "engine.outage.methods"
    },
    "engine.composed": {"core", "engine.*"},
    "ros.messages": {"core", "engine", "engine.parameters"},
    "ros": {"core", "engine.*", "ros.messages", "ros.load", "ros.middleware"},
    "ros.middleware": set(),
    "ros.load": {"engine", "engine.parameters", "ros", "ros.messages"},
    "ros.autopilot": {"core", "engine", "engine.parameters", "engine.navigator", "ros", "ros.messages"},
    "ros.continuation": {"core", "engine", "engine.parameters", "engine.composed", "ros"},
    "sim": {"core", "engine", "sim.vehicles"},
    "sim.vehicles": {"core", "sim"},
    "offline": {"core", "engine", "sim.*", "offline.bags"},  # the command line and what simulates
    "offline.archive": {"offline"},
    "offline.page": set(),
    "offline.bags": {"core", "engine", "engine.parameters", "ros.messages", "offline"},
    "offline.flights": {"core", "engine.*", "sim.*", "ros.messages", "offline", "offline.bags"},
    "offline.logs.formats": {"offline", "offline.bags"},
    "offline.logs": {
        "core", "engine.*", "offline", "offline.archive", "offline.bags", "offline.flights", "offline.logs.formats"
    },
    "offline.replay": {"core", "engine.*", "offline.*"},
    "offline.calibration": {"core", "engine", "offline", "offline.flights", "offline.logs"},
    "offline.training": {
        "core", "engine.*", "offline", "offline.archive", "offline.bags", "offline.flights", "offline.logs"
    },
    "offline.benchmarks": {"engine.outage", "offline.*"},
    "offline.benchmarks.outage": {"core", "engine.*", "offline.*"},
    "offline.benchmarks.attitude": {"core", "engine.*", "offline.*"},
    "offline.benchmarks.alignment": {"core", "engine.*", "sim.*", "offline.*"},
    "offline.benchmarks.beams": {"core", "engine.*", "sim.*", "offline.*"},
    "offline.benchmarks.archive": {"sim", "offline.*"},
    "offline.benchmarks.speed": {"core", "engine.*", "ros.messages", "offline.*"},
    "nodes": {"core", "engine.*", "sim.*", "ros", "ros.autopilot", "ros.continuation", "ros.messages"},
}  # fmt: skip
MUTUAL = {("sim", "sim.vehicles"), ("offline", "offline.bags"), ("ros", "ros.load")}
"""Rooms that may need each other: the simulator is one whole; the command line and helpers are everybody's;
what arrives at a node is half of the node."""
LARGEST_ROOM, LARGEST_CLASS = 15, 15
ROS_LIBRARIES = re.compile(r"^(rclpy|ament_index_python|\w+_msgs|rcl_interfaces|builtin_interfaces|std_srvs)(\.|$)")


def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def imports(path: Path) -> list[tuple[int, str]]:
    """(line, dotted name) of every import in a file, wherever in the file it stands."""
    found: list[tuple[int, str]] = []
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.Import):
            found += ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: relative import"
            found.append((node.lineno, node.module or ""))
            found += ((node.lineno, f"{node.module}.{alias.name}") for alias in node.names)
    return found


def part(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0]


def room(path: Path) -> str:
    return ".".join(path.relative_to(PACKAGE).parts[:-1])


def room_of_import(name: str) -> str | None:
    """The room that a dotted name of this package lies in; None for other packages and for what stands at the top."""
    pieces = name.split(".")[1:] if name.split(".")[0] == NAME else []
    while pieces and not (PACKAGE / Path(*pieces)).is_dir():
        pieces.pop()
    return ".".join(pieces) or None


def is_allowed(target: str, allowed: set[str]) -> bool:
    """``engine`` is that room alone, ``engine.*`` it and all in it; ``core`` is open with all its rooms."""
    whole = {entry.removesuffix(".*") for entry in allowed if entry.endswith(".*")} | (allowed & {"core"})
    return target in allowed or any(target == one or target.startswith(f"{one}.") for one in whole)


def relative(path: Path) -> str:
    return path.relative_to(REPOSITORY).as_posix()


def offending_imports(parts: set[str], is_forbidden: Callable[[Path, str], bool]) -> list[str]:
    return [
        f"{relative(path)}:{line} imports {name}"
        for path in MODULES
        if part(path) in parts
        for line, name in imports(path)
        if is_forbidden(path, name)
    ]


def arrows() -> dict[tuple[str, str], str]:
    """(room, room that it imports) -> one place where it does."""
    found: dict[tuple[str, str], str] = {}
    for path in MODULES:
        for line, name in imports(path):
            target = room_of_import(name)
            if target is not None and target != room(path) and room(path):
                found.setdefault((room(path), target), f"{relative(path)}:{line}")
    return found


def test_rooms_import_only_what_they_may():
    strangers = {place: arrow for arrow, place in arrows().items() if not is_allowed(arrow[1], MAY_IMPORT[arrow[0]])}
    assert strangers == {}


def test_rooms_do_not_need_each_other():
    found = set(arrows())
    both_ways = {(a, b) for a, b in found if (b, a) in found and a < b}
    assert both_ways <= MUTUAL


def test_every_room_is_in_the_table_and_small_enough():
    files: dict[str, int] = {}
    for path in MODULES:
        if path.name != "__init__.py" and room(path):
            files[room(path)] = files.get(room(path), 0) + 1
    assert set(files) == set(MAY_IMPORT)
    assert {name: count for name, count in files.items() if count > LARGEST_ROOM} == {}


def test_a_class_has_at_most_15_methods():
    large = {
        f"{relative(path)}: {node.name}": count
        for path in MODULES
        for node in ast.walk(parsed(path))
        if isinstance(node, ast.ClassDef)
        and (count := sum(isinstance(part, ast.FunctionDef) for part in node.body)) > LARGEST_CLASS
    }
    assert large == {}


def test_core_is_pure_numerics():
    forbidden = {"logging", "time", "datetime", "yaml", "pathlib", "io", "random"}
    assert offending_imports({"core"}, lambda path, name: name.split(".")[0] in forbidden) == []


def test_core_reads_the_environment_only_to_learn_whether_to_compile():
    assert {relative(p) for p in MODULES if part(p) == "core" and ("os" in {n for _, n in imports(p)})} <= {
        f"{NAME}/core/numerics/jit.py"
    }


def test_ros_stays_outside():
    inside = {"core", "engine", "sim", "offline"}
    assert offending_imports(inside, lambda path, name: ROS_LIBRARIES.match(name) is not None) == []


def test_engines_ask_no_clock():
    assert offending_imports({"engine"}, lambda path, name: name.split(".")[0] in {"time", "datetime"}) == []


def test_offline_reaches_no_rclpy_by_detours():
    """What offline imports of ros must itself be free of rclpy."""
    reached: set[Path] = set()
    queue = sorted((PACKAGE / "offline").rglob("*.py"))
    while queue:
        path = queue.pop()
        if path in reached:
            continue
        reached.add(path)
        for line, name in imports(path):
            assert not name.startswith("rclpy"), f"{relative(path)}:{line} imports {name}"
            candidate = REPOSITORY / Path(*name.split(".")).with_suffix(".py")
            if candidate.is_file():
                queue.append(candidate)
    assert PACKAGE / "ros" / "messages" / "convert.py" in reached


def names_of(library: str, path: Path) -> Iterator[tuple[int, str]]:
    """(line, dotted name) of what a file takes from ``library``: ``np.linalg.norm`` is ``numpy.linalg.norm``."""
    if not any(name.split(".")[0] == library for _, name in imports(path)):
        return
    tree = parsed(path)
    known = {
        alias.asname or alias.name: alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.Import)
        for alias in node.names
        if alias.name.split(".")[0] == library
    }
    yield from ((line, name) for line, name in imports(path) if name.split(".")[0] == library)
    for node in ast.walk(tree):
        pieces: list[str] = []
        part: ast.AST = node
        while isinstance(part, ast.Attribute):
            pieces.insert(0, part.attr)
            part = part.value
        if pieces and isinstance(part, ast.Name) and part.id in known:
            yield node.lineno, ".".join([known[part.id], *pieces])


def exists(name: str) -> bool:
    """Whether the installed library has ``name``; what stands behind a constant (``numpy.pi.real``) does not matter."""
    found, *rest = name.split(".")
    thing = import_module(found)
    for piece in rest:
        found += f".{piece}"
        if not hasattr(thing, piece):
            try:
                thing = import_module(found)
            except ImportError:
                return False
        else:
            thing = getattr(thing, piece)
    return True


# Names of the module numpy that the 1.26 of Ubuntu 24.04 does not have (dir(numpy) of 2.5 without that of 1.26).
NUMPY_2_ONLY = re.compile(
    r"^numpy\.(acosh?|asinh?|atan[2h]?|astype|bitwise_(count|invert|left_shift|right_shift)|bool|concat|cumulative_prod|"
    r"cumulative_sum|isdtype|u?long|matrix_transpose|matvec|permute_dims|pow|strings|trapezoid|unique_all|unique_counts|"
    r"unique_inverse|unique_values|unstack|vecdot|vecmat)(\.|$)"
)


def test_the_package_does_without_names_that_only_numpy_2_has():
    found = [
        f"{relative(path)}:{line}: {name}"
        for path in MODULES
        for line, name in names_of("numpy", path)
        if NUMPY_2_ONLY.match(name)
    ]
    assert found == []


@pytest.mark.parametrize("library", ["numpy", "scipy"])
def test_every_name_of_a_library_exists_in_the_installed_version(library):
    """Of use because this file runs with the versions of Ubuntu 24.04 as well (make test-jazzy)."""
    programs = sorted((REPOSITORY / "benchmarks").rglob("*.py"))
    named = {name: (path, line) for path in [*MODULES, *TESTS, *programs] for line, name in names_of(library, path)}
    assert len(named) > 10 or library == "scipy"
    assert {name: f"{relative(path)}:{line}" for name, (path, line) in named.items() if not exists(name)} == {}


def test_a_file_has_at_most_400_lines():
    lengths = {relative(path): len(path.read_text(encoding="utf-8").splitlines()) for path in [*MODULES, *TESTS]}
    assert {path: length for path, length in lengths.items() if length > 400} == {}


def undocumented(path: Path) -> Iterator[str]:
    tree = parsed(path)
    if tree.body and not ast.get_docstring(tree):
        yield relative(path)
    definitions = (node for node in tree.body if isinstance(node, (ast.FunctionDef, ast.ClassDef)))
    for node in definitions:
        if not node.name.startswith("_") and not ast.get_docstring(node):
            yield f"{relative(path)}:{node.lineno}: {node.name}"


def test_modules_and_their_public_names_have_docstrings():
    assert [missing for path in MODULES for missing in undocumented(path)] == []


def test_nothing_spins_forever():
    """``spin()`` of rclpy's wheels does not end on a signal; loops of ``spin_once(timeout_sec=...)`` do."""
    for path in MODULES:
        for node in ast.walk(parsed(path)):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                assert node.func.attr != "spin", f"{relative(path)}:{node.lineno}"


def tracked_text_files() -> list[Path]:
    listing = subprocess.run(
        ["git", "ls-files", "-z"], cwd=REPOSITORY, capture_output=True, text=True, check=False, timeout=300
    )
    if listing.returncode != 0:
        pytest.skip("not a git checkout")
    binary = {".mcap", ".db3", ".npz", ".png", ".zstd", ".airframe"}
    files = (REPOSITORY / name for name in listing.stdout.split("\0") if name)
    return [path for path in files if path.suffix not in binary and path.is_file()]


def test_no_path_of_a_machine_and_no_unfinished_business_stands_in_a_file():
    folders = "|".join(["work", "root", "tmp", "home/[a-z]+"])
    words = "|".join(["TO" + "DO", "FIX" + "ME", "X" * 3])
    hosts = "|".join(["pypi\\.org", "pythonhosted\\.org", "npmjs\\.org"])
    pattern = re.compile(rf"(?<![\w.$}}])/(?:{folders})/|\b(?:{words})\b|{hosts}")
    found = [
        f"{relative(path)}:{number}: {line.strip()}"
        for path in tracked_text_files()
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if pattern.search(line) and path.name != ".gitignore"
    ]
    assert not found, "\n".join(found)
