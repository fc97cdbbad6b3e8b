"""Parameters as a ROS user meets them: files, types, ranges, changes in flight."""

from pathlib import Path

import pytest
from rclpy.parameter import Parameter

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import ParameterError, flatten, specs
from nav_pose_estimator.engine.solutions import Mode
from nav_pose_estimator.nodes.synthetic_sensors import SyntheticSensors
from nav_pose_estimator.ros.estimator_node import EstimatorNode
from nav_pose_estimator.ros.parameters import LiveParameters, unaddressed


class NoEngine:
    """Takes everything and does nothing."""

    mode = Mode.WAITING_IMU
    origin = None

    def __init__(self, parameters: Parameters) -> None:
        self.parameters = parameters

    def warm_up(self) -> None:
        pass

    def set_parameters(self, parameters: Parameters) -> None:
        self.parameters = parameters


def make_node() -> EstimatorNode:
    return EstimatorNode("some_node", NoEngine)


def test_every_parameter_is_declared_with_unit_range_and_meaning(started):
    node = started(make_node)
    for spec in specs(Parameters()):
        value = node.get_parameter(spec.key).value
        assert value == (list(spec.default) if isinstance(spec.default, tuple) else spec.default), spec.key
        described = node.describe_parameter(spec.key)
        assert described.description.startswith(spec.description)
        assert not spec.unit or described.description.endswith(f"[{spec.unit}]")
        assert described.read_only is not spec.mutable
        if isinstance(spec.default, float) and spec.minimum is not None and spec.maximum is not None:
            (span,) = described.floating_point_range
            assert (span.from_value, span.to_value) == (spec.minimum, spec.maximum)


def test_the_shipped_file_suits_every_executable(started, repository):
    """GIVEN the parameter file with the key /** WHEN synthetic_sensors gets it, too THEN it starts, with its own."""
    shipped = str(repository / "config" / "nav_pose_estimator.yaml")
    node = started(SyntheticSensors, "--params-file", shipped, "-p", "duration:=1.0")
    assert node.get_parameter("duration").value == 1.0
    assert not node.has_parameter("gnss.delay")


def test_a_name_that_is_in_no_tree_stops_synthetic_sensors(started):
    with pytest.raises(ParameterError, match="there is no parameter 'durations'; did you mean 'duration'"):
        started(SyntheticSensors, "-p", "durations:=1.0")


@pytest.mark.parametrize(
    ("argument", "sentence"),
    [
        ("gnss.dely:=0.1", "there is no parameter 'gnss.dely'; did you mean 'gnss.delay'?"),
        ("gnss.delay:=7.5", "gnss.delay: 7.5 is above the maximum 1 s"),
        ("gnss.delay:=soon", "gnss.delay: 'soon' is not a number"),
        ("gnss.gate.min_satellites_enter:=6.5", "gnss.gate.min_satellites_enter: 6.5 is not a whole number"),
        ("imu.convention:=ned", "imu.convention: 'ned' is not one of flu, frd"),
        ("imu.mounting_rpy:=[0.0, 1.0]", "imu.mounting_rpy: needs 3 numbers, not 2"),
        ("ros.frames.publish_tf:=1", "ros.frames.publish_tf: 1 is not true or false"),
        ("ros.frames.map:=odom", "ros.frames: map, odom and base_link need three different names"),
        ("ros.frames.map:=''", "ros.frames: map, odom and base_link need three different names"),
    ],
)
def test_a_wrong_override_stops_the_node_with_one_sentence(started, argument, sentence):
    with pytest.raises(ParameterError) as error:
        started(make_node, "-p", argument)
    assert str(error.value) == sentence


def test_whole_numbers_do_where_numbers_are_wanted(started):
    node = started(make_node, "-p", "gnss.delay:=1", "-p", "gnss.lever_arm:=[1, 0, 2]")
    assert node.parameters.gnss.delay == 1.0
    assert node.get_parameter("gnss.delay").value == 1.0
    assert node.parameters.gnss.lever_arm == (1.0, 0.0, 2.0)


def test_a_file_with_an_unknown_key_stops_the_node(started, tmp_path: Path):
    file = tmp_path / "some.yaml"
    file.write_text("/**:\n  ros__parameters:\n    gnss:\n      gate:\n        min_satelites_enter: 6\n")
    with pytest.raises(ParameterError, match=r"did you mean 'gnss\.gate\.min_satellites_enter'"):
        started(make_node, "--params-file", str(file))


@pytest.mark.parametrize(
    ("section", "is_ours"),
    [
        ("/**", True),
        ("/*", False),
        ("/drone1/*", True),
        ("/drone1/some_node", True),
        ("/**/some_node", True),
        ("some_node", False),
        ("drone1:\n  some_node", True),
        ("drone2:\n  some_node", False),
        ("other_node", False),
    ],
)
def test_a_file_for_other_nodes_is_told(tmp_path: Path, section, is_ours):
    file = tmp_path / "some.yaml"
    indent = "    " if "\n" in section else "  "
    file.write_text(f"{section}:\n{indent}ros__parameters:\n{indent}  gnss.delay: 0.1\n")
    told = unaddressed(["--ros-args", "--params-file", str(file)], "/drone1/some_node")
    assert told == [] if is_ours else f"{file} sets nothing for /drone1/some_node: it is for " in told[0]


@pytest.mark.parametrize("text", ["", "a: !unknown 1", "[", "7"])
def test_a_file_that_says_nothing_is_for_nobody_in_particular(tmp_path: Path, text):
    file = tmp_path / "some.yaml"
    file.write_text(text)
    assert unaddressed(["--params-file", str(file)], "/some_node") == []


def test_what_rclpy_itself_understands_is_no_unknown_key(started):
    node = started(
        make_node, "-p", "use_sim_time:=true", "-p", "qos_overrides./diagnostics.publisher.reliability:=best_effort"
    )
    assert node.get_parameter("use_sim_time").value is True
    assert node.parameters == Parameters()


def test_a_mutable_parameter_changes_in_flight_and_reaches_the_engine(started):
    node = started(make_node)
    (result,) = node.set_parameters([Parameter("gnss.gate.min_satellites_enter", value=9)])
    assert result.successful
    assert node.engine.parameters.gnss.gate.min_satellites_enter == 9
    assert node.parameters.gnss.gate.min_satellites_enter == 9


@pytest.mark.parametrize(
    ("key", "value"), [("gnss.delay", 0.2), ("gnss.gate.hold", 1e4), ("gnss.gate.hold", "long")], ids=str
)
def test_read_only_and_wrong_values_are_refused_in_flight(started, key, value):
    node = started(make_node)
    (result,) = node.set_parameters([Parameter(key, value=value)])
    assert not result.successful
    assert result.reason
    assert node.engine.parameters == Parameters()


def test_changes_come_all_together_or_not_at_all(started):
    node = started(make_node)
    result = node.set_parameters_atomically(
        [Parameter("gnss.gate.hold", value=3.0), Parameter("gnss.gate.max_age", value=-1.0)]
    )
    assert not result.successful
    assert flatten(node.engine.parameters) == flatten(Parameters())


def test_a_choice_is_checked_where_rclpy_does_not_know_it(started):
    node = started(make_node)
    live = LiveParameters(node, Parameters(), lambda parameters: None)
    assert "not one of" in live._check([Parameter("gnss.reacquisition.policy", value="hope")]).reason
