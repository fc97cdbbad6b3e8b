"""The house rules that a machine can check: who imports whom, how long a file is, what may not stand in it."""

import ast
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
PACKAGE = REPOSITORY / "nav_pose_estimator"
NAME = PACKAGE.name
MODULES = sorted(PACKAGE.rglob("*.py"))

# Each part may import itself, these other parts, and what stands at the top (conventions, errors).
MAY_IMPORT = {
    "core": set(),
    "engine": {"core"},
    "ros": {"core", "engine"},
    "sim": {"core", "engine"},
    "offline": {"core", "engine", "sim", "ros"},
    "nodes": {"core", "engine", "sim", "ros"},
}
NUMERICS_ONLY = {"numpy", "scipy", "numba"}
ROS_LIBRARIES = re.compile(r"^(rclpy|ament_index_python|\w+_msgs|rcl_interfaces|builtin_interfaces|std_srvs)(\.|$)")


def imports(path: Path) -> Iterator[tuple[int, str]]:
    """(line, dotted name) of every import in a file, wherever in the file it stands."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: relative import"
            yield node.lineno, node.module or ""
            yield from ((node.lineno, f"{node.module}.{alias.name}") for alias in node.names)


def part(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0]


def relative(path: Path) -> str:
    return path.relative_to(REPOSITORY).as_posix()


@pytest.mark.parametrize("path", [p for p in MODULES if part(p) in MAY_IMPORT], ids=relative)
def test_dependencies_point_inwards(path):
    allowed = MAY_IMPORT[part(path)] | {part(path)}
    for line, name in imports(path):
        pieces = name.split(".")
        if pieces[0] == NAME and len(pieces) > 1 and pieces[1] in MAY_IMPORT:
            assert pieces[1] in allowed, f"{relative(path)}:{line} imports {name}"


@pytest.mark.parametrize("path", sorted((PACKAGE / "core").rglob("*.py")), ids=relative)
def test_core_is_pure_numerics(path):
    forbidden = {"logging", "time", "datetime", "yaml", "pathlib", "io", "os", "rclpy", "random"}
    if path.name == "jit.py":
        forbidden -= {"os"}  # whether to compile is read from the environment, once
    for line, name in imports(path):
        assert name.split(".")[0] not in forbidden, f"{relative(path)}:{line} imports {name}"


@pytest.mark.parametrize("path", [p for p in MODULES if part(p) in {"core", "engine", "sim", "offline"}], ids=relative)
def test_ros_stays_outside(path):
    for line, name in imports(path):
        assert not ROS_LIBRARIES.match(name), f"{relative(path)}:{line} imports {name}"


@pytest.mark.parametrize("path", sorted((PACKAGE / "engine").rglob("*.py")), ids=relative)
def test_engines_ask_no_clock(path):
    for line, name in imports(path):
        assert name.split(".")[0] not in {"time", "datetime"}, f"{relative(path)}:{line} imports {name}"


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
    assert PACKAGE / "ros" / "convert.py" in reached


@pytest.mark.parametrize("path", [*MODULES, *sorted((REPOSITORY / "test").rglob("*.py"))], ids=relative)
def test_a_file_has_at_most_400_lines(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 400


def functions(path: Path) -> Iterator[ast.FunctionDef]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            yield node


@pytest.mark.parametrize("path", MODULES, ids=relative)
def test_public_functions_of_modules_have_docstrings(path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    assert ast.get_docstring(tree) is not None or not tree.body, f"{relative(path)} has no docstring"
    for node in tree.body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_"):
            assert ast.get_docstring(node), f"{relative(path)}:{node.lineno}: {node.name} has no docstring"


def test_nothing_spins_forever():
    """``spin()`` of rclpy's wheels does not end on a signal; loops of ``spin_once(timeout_sec=...)`` do."""
    for path in MODULES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                assert node.func.attr != "spin", f"{relative(path)}:{node.lineno}"


def tracked_text_files() -> list[Path]:
    listing = subprocess.run(["git", "ls-files", "-z"], cwd=REPOSITORY, capture_output=True, text=True, check=False)
    if listing.returncode != 0:
        pytest.skip("not a git checkout")
    binary = {".mcap", ".db3", ".npz", ".png", ".zstd"}
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
