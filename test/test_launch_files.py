"""Launch files: they load, and name only executables, files, parameters and topics that exist."""

import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import flatten
from nav_pose_estimator.offline.command_line import COMMANDS
from nav_pose_estimator.ros.messages.message_table import INPUTS

REPOSITORY = Path(__file__).resolve().parents[1]
FILES = sorted((REPOSITORY / "launch").glob("*.launch.py"))
OUTPUTS = {"autopilot/odometry", "autopilot/gps_input"}
PUBLIC = {
    "launch": ("LaunchDescription",),
    "launch.actions": ("DeclareLaunchArgument",),
    "launch.substitutions": ("LaunchConfiguration", "PathJoinSubstitution"),
    "launch_ros.actions": ("Node",),
    "launch_ros.parameter_descriptions": ("ParameterValue",),
    "launch_ros.substitutions": ("FindPackageShare",),
}


def described(path: Path) -> Any:
    spec = importlib.util.spec_from_file_location(path.name.replace(".", "_"), path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.generate_launch_description()


@pytest.fixture
def stand_ins(monkeypatch) -> None:
    """The names of launch that the files use, which only remember what they were given."""

    def remember(kind: str) -> Any:
        return lambda *given, **named: SimpleNamespace(kind=kind, given=given, **named)

    for name, kinds in PUBLIC.items():
        module = ModuleType(name)
        for kind in kinds:
            setattr(module, kind, remember(kind))
        monkeypatch.setitem(sys.modules, name, module)


def nodes(description: Any) -> Iterator[Any]:
    yield from (item for item in description.given[0] if item.kind == "Node")


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_a_launch_file_names_only_what_exists(stand_ins, path):
    description = described(path)
    arguments = {item.given[0] for item in description.given[0] if item.kind == "DeclareLaunchArgument"}
    used, found = set(), list(nodes(description))
    assert found
    for node in found:
        assert node.executable in COMMANDS
        assert COMMANDS[node.executable].is_node
        assert {ours for ours, _ in getattr(node, "remappings", [])} <= {i.topic for i in INPUTS} | OUTPUTS
        for item in node.parameters:
            if isinstance(item, dict):
                assert item.keys() <= {*flatten(Parameters()), "use_sim_time"}
            elif item.kind == "PathJoinSubstitution":
                assert (REPOSITORY / Path(*item.given[0][1:])).is_file()
        used |= {thing.given[0] for thing in everything(vars(node)) if thing.kind == "LaunchConfiguration"}
    assert used == arguments


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_a_restart_is_quick_and_goes_on_from_the_state_file(stand_ins, path):
    """GIVEN a launch file WHEN its node dies THEN it is back within a second, with the state of before; one node only,
    the navigator, writes the file that ``state_file`` names."""
    found = list(nodes(described(path)))
    assert all(node.respawn_delay < 1.0 for node in found)
    keepers = {
        node.executable
        for node in found
        for given in node.parameters
        if isinstance(given, dict)
        and "ros.state.file" in given
        and [thing.given[0] for thing in everything(given["ros.state.file"])][-1] == "state_file"
    }
    assert keepers in ({"pose_estimator"}, {"sins_node"})


def everything(thing: Any) -> Iterator[Any]:
    """All stand-ins in what a node was given."""
    if isinstance(thing, SimpleNamespace):
        yield thing
        yield from everything(vars(thing))
    elif isinstance(thing, dict):
        yield from (x for value in thing.values() for x in everything(value))
    elif isinstance(thing, (list, tuple)):
        yield from (x for value in thing for x in everything(value))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_a_launch_file_is_one_for_launch_itself(path):
    launch = pytest.importorskip("launch", reason="needs launch and launch_ros (they are not among the wheels)")
    pytest.importorskip("launch_ros", reason="needs launch_ros")
    description = described(path)
    assert isinstance(description, launch.LaunchDescription)
    assert description.entities
