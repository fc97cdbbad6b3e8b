"""No message without cause and cure: the events of the code are those of the catalogue and of the page."""

import ast
import itertools
import re
from collections.abc import Iterator
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path

import pytest

import troubleshooting_docs
from nav_pose_estimator.core.alignment.aligner import Aligner
from nav_pose_estimator.core.gnss import reacquisition
from nav_pose_estimator.engine.attitude.engine import AttitudeEngine
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.events.catalogue import SECTIONS, find, in_words
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import flatten, update
from nav_pose_estimator.engine.samples import GnssFix, ImuSample, MagSample
from nav_pose_estimator.engine.solutions import Event, Mode
from nav_pose_estimator.ros import wording
from nav_pose_estimator.sim.scenarios import generate

PACKAGE = Path(__file__).resolve().parents[1] / "nav_pose_estimator"
NAMES = [entry.name for entries in SECTIONS.values() for entry in entries]
TELLS = {"Event", "say", "count", "_event", "_note", "_refuse", "Notice", "Decision", "Verdict"}
DOTTED = re.compile(r"(\*|[a-z_]+)(\.[a-z_0-9*]+)+")
PREFIXES = re.compile(
    r"[a-z_]+\.(rejected|position|velocity)|gnss\.(fuse|usable|reset|reacquired)"
)  # parts of names, no events


class Texts:
    """The strings of one module; f-strings in every form that the code spells out, with * for what it does not."""

    def __init__(self, path: Path) -> None:
        self.tree = ast.parse(path.read_text(encoding="utf-8"))
        self.tuples = {
            node.targets[0].id: node.value
            for node in self.tree.body
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
        }

    def of(self, node: ast.AST) -> list[str]:
        """What a string expression can be; empty for anything else."""
        if isinstance(node, ast.JoinedStr):
            return ["".join(parts) for parts in itertools.product(*(self.of(part) or ["*"] for part in node.values))]
        if isinstance(node, ast.FormattedValue):
            return self.of(node.value)
        if isinstance(node, ast.IfExp):
            return [*(self.of(node.body) or ["*"]), *(self.of(node.orelse) or ["*"])]
        if isinstance(node, ast.Subscript):
            values = self.tuples.get(getattr(node.value, "id", ""), node.value)
            return [t for item in getattr(values, "elts", ()) for t in self.of(item)]
        return [node.value] if isinstance(node, ast.Constant) and isinstance(node.value, str) else []

    def everywhere(self, tree: ast.AST | None = None) -> Iterator[str]:
        """All of them, those inside f-strings only as parts of these."""
        nodes = list(ast.walk(tree or self.tree))
        inside = {id(c) for n in nodes if isinstance(n, ast.JoinedStr) for c in ast.walk(n) if c is not n}
        yield from (text for n in nodes if id(n) not in inside for text in self.of(n))

    def told(self) -> Iterator[str]:
        """The dotted names that are arguments of what makes events."""
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Call):
                name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
                if name in TELLS:
                    yield from (text for a in node.args for text in self.of(a) if DOTTED.fullmatch(text))


def names_in_the_code() -> set[str]:
    modules = [
        Texts(path)
        for part in ("core", "engine", "ros", "nodes")
        for path in sorted((PACKAGE / part).rglob("*.py"))
        if path.parent.name != "events"
    ]
    direct = {name for module in modules for name in module.told()}
    families = {name.split(".")[0] for name in direct} - {"*"}
    everywhere = (s for module in modules for s in module.everywhere() if DOTTED.fullmatch(s))
    others = {s for s in everywhere if s.split(".")[0] in families}
    with_all_figures = PoseEstimator(update(Parameters(), {"gnss.error_states": True}))
    no_events = set(flatten(Parameters())) | set(with_all_figures.status().values)
    return {n for n in direct | others if not PREFIXES.fullmatch(n)} - (no_events - set(NAMES))


def meet(a: str, b: str) -> bool:
    """Whether two names with wildcards can be the same event."""
    return fnmatchcase(a, b) or fnmatchcase(b, a)


def test_the_scan_sees_names_of_every_kind():
    assert {"imu.rejected.nan", "gnss.waiting.hold", "mode.*", "imu.gap", "qos.incompatible"} <= names_in_the_code()


def test_every_event_in_the_code_has_cause_and_cure():
    missing = {name for name in names_in_the_code() if not any(meet(name, entry) for entry in NAMES)}
    assert missing == set(), "add them to engine/events and run make docs"


def test_the_catalogue_holds_nothing_that_is_not_in_the_code():
    code = names_in_the_code() | {"reset", "aligned", "set_pose", "set_origin"}
    assert [name for name in NAMES if not any(meet(name, known) for known in code)] == []


def test_names_are_unique_and_words_are_there():
    assert len(NAMES) == len(set(NAMES))
    assert all(entry.meaning and not entry.meaning.endswith(".") for entries in SECTIONS.values() for entry in entries)


def test_the_page_is_up_to_date(repository):
    written = (repository / troubleshooting_docs.PAGE).read_text(encoding="utf-8")
    assert written == troubleshooting_docs.page_text(), "run make docs"


def test_every_sentence_that_a_node_waits_with_is_on_the_page():
    page = troubleshooting_docs.page_text()
    module = Texts(PACKAGE / "core" / "alignment" / "aligner.py")
    functions = (node for node in ast.walk(module.tree) if isinstance(node, ast.FunctionDef))
    (waiting,) = (node for node in functions if node.name == Aligner.waiting_for.__name__)
    sentences = [s for s in module.everywhere(waiting) if s[:1].isupper() and s != ast.get_docstring(waiting)]
    beginnings = {re.split(r"[*;:]", s)[0].strip() for s in sentences}
    assert len(beginnings) > 5
    assert [s for s in beginnings if s not in page] == []
    engine = AttitudeEngine()
    assert engine.status().waiting_for in page


@pytest.mark.parametrize("mode", Mode)
def test_every_mode_and_every_key_of_the_status_is_on_the_page(mode):
    page, status = troubleshooting_docs.page_text(), replace(PoseEstimator().status(), mode=mode)
    assert f"| `{mode.value}` | {wording.MEANINGS[mode]} |" in page
    assert [key for key, _ in wording.facts(status) if key not in page] == []
    assert [key for key in PoseEstimator().outage_aid.status() if key not in page] == []
    assert [key for key, _ in wording.facts(AttitudeEngine().status()) if key not in page] == []


def test_everything_that_a_bad_flight_counts_is_in_the_catalogue():
    """GIVEN a flight with broken samples of every kind WHEN it is flown THEN each counter has its entry."""
    engine = PoseEstimator()
    flight = generate("hover", duration=40.0, seed=1, imu_rate=50.0)
    engine.feed(GnssFix(flight.start_ns, 0.8, 0.1, 0.0))
    seen: set[str] = set()
    for i, sample in enumerate(flight.samples(blocks=False)):
        bad = []
        if isinstance(sample, ImuSample) and i % 50 == 0:
            nan = (float("nan"),) * 3
            bad = [
                replace(sample, gyro=nan),
                replace(sample, stamp_ns=0),
                replace(sample, accel=(0.0, 0.0, 900.0)),
                sample,
            ]
        elif isinstance(sample, GnssFix) and i % 7 == 0:
            bad = [replace(sample, status=-2), replace(sample, lat=float("nan")), replace(sample, stamp_ns=0)]
            bad += [replace(sample, stamp_ns=sample.stamp_ns - 10**10), replace(sample, lat=sample.lat + 1e-3)]
        elif isinstance(sample, MagSample) and i % 9 == 0:
            bad = [replace(sample, field=(0.0, 0.0, 0.0)), replace(sample, stamp_ns=sample.stamp_ns + 5 * 10**9)]
        outputs = [o for s in [*bad, sample] for o in engine.feed(s)]
        seen |= {o.name for o in outputs if isinstance(o, Event)}
    seen |= set(engine.status().counters) | set(engine.attitude.status().counters)
    assert len(seen) > 12
    assert [name for name in sorted(seen) if find(name) is None] == []
    assert not in_words("gnss.rejected.age").startswith("gnss.")


@pytest.mark.parametrize("why", ["doubtful", *reacquisition._ZONES])
def test_every_reason_of_the_guard_of_the_return_has_a_sentence(why):
    for name in (f"gnss.waiting.{why}", f"gnss.rejected.{why}"):
        assert not in_words(name).startswith("gnss.")


def test_every_recommended_echo_shows_the_whole_sentence(repository):
    """GIVEN the commands of README and docs WHEN ~/status is echoed THEN nothing of it is cut or missed."""
    pages = [repository / "README.md", *(repository / "docs").glob("*.md")]
    text = " ".join(" ".join(page.read_text(encoding="utf-8").split()) for page in pages)
    echoes = re.findall(r"ros2 topic echo[^`#]*?/status", text)
    assert len(echoes) >= 3
    wanted = ("--full-length", "--qos-durability transient_local", "--qos-reliability reliable")
    assert [echo for echo in echoes if not all(option in echo for option in wanted)] == []
