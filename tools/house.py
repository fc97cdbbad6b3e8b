"""Size and shape of the package: rooms (sub-packages), their modules, imports between them, classes, lines.

python tools/house.py               # of this checkout
python tools/house.py OTHER_CHECKOUT
"""

import ast
import statistics
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

NAME = "nav_pose_estimator"
MANY_METHODS = 12  # number of methods from which a class is listed


def imported(tree: ast.AST) -> Iterator[str]:
    """Yield the dotted names that a module imports."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def room_of(package: Path, name: str) -> str:
    """The room of a dotted name; empty for other packages and for what is at the top of this one."""
    first, *rest = name.split(".")
    while first == NAME and rest and not package.joinpath(*rest).is_dir():
        rest.pop()
    return ".".join(rest) if first == NAME else ""


def main(checkout: Path) -> None:
    """Print the figures."""
    package = checkout / NAME
    rooms: Counter[str] = Counter()
    arrows: set[tuple[str, str]] = set()
    methods: list[int] = []
    lines = 0
    for path in sorted(package.rglob("*.py")):
        room = ".".join(path.relative_to(package).parts[:-1])
        text = path.read_text(encoding="utf-8")
        tree = ast.parse(text)
        lines += len(text.splitlines())
        if room and path.name != "__init__.py":
            rooms[room] += 1
        arrows |= {(room, target) for name in imported(tree) if (target := room_of(package, name)) not in ("", room)}
        classes = (node for node in ast.walk(tree) if isinstance(node, ast.ClassDef))
        methods += [sum(isinstance(part, ast.FunctionDef) for part in node.body) for node in classes]
    arrows = {arrow for arrow in arrows if arrow[0]}
    both_ways = sum((b, a) in arrows for a, b in arrows) // 2
    sizes = list(rooms.values())
    print(f"lines {lines}, modules {sum(sizes)}, rooms {len(sizes)}")
    print(f"modules in a room: median {statistics.median(sizes):.0f}, largest {max(sizes)}")
    print(f"arrows between rooms: {len(arrows)}, both ways between {both_ways} pairs")
    large = sum(count > MANY_METHODS for count in methods)
    print(f"classes: {len(methods)}, {large} with over {MANY_METHODS} methods, largest {max(methods)}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parents[1])
