"""Reading ROS parameter files for replay: what is taken, what is ignored, what is refused and how."""

import itertools
import math

import pytest

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.flights import ros_yaml
from nav_pose_estimator.offline.flights.config_file import load_parameters


@pytest.fixture
def load(tmp_path):
    def from_text(text: str) -> Parameters:
        path = tmp_path / "drone.yaml"
        path.write_text(text, encoding="utf-8")
        return load_parameters(path)

    return from_text


def test_no_file_and_an_empty_file_are_the_defaults(load):
    assert load_parameters(None) == Parameters()
    assert load("# nothing yet\n") == Parameters()


@pytest.mark.parametrize(
    "text",
    [
        "/**: {ros__parameters: {gnss: {delay: 0.2}}}",
        "/**: {ros__parameters: {gnss.delay: 0.2}}",
        "sins_node: {ros__parameters: {gnss: {delay: 0.2}}}",
        "/drone/sins_node: {ros__parameters: {gnss: {delay: 0.2}}}",
        "drone: {sins_node: {ros__parameters: {gnss: {delay: 0.2}}}}",
        "/**/sins_*: {ros__parameters: {gnss: {delay: 0.2}}}",
        "gnss: {delay: 0.2}",
    ],
)
def test_every_way_to_write_a_parameter(load, text):
    assert load(text).gnss.delay == 0.2


def test_the_more_particular_section_wins(load):
    text = """
    pose_estimator: {ros__parameters: {gnss: {delay: 0.3}}}
    sins_node: {ros__parameters: {gnss: {delay: 0.2, position_sd: 2.0}}}
    /**: {ros__parameters: {gnss: {delay: 0.1, position_sd: 1.0, vertical_sd: 9.0}}}
    """
    gnss = load(text).gnss
    assert (gnss.delay, gnss.position_sd, gnss.vertical_sd) == (0.3, 2.0, 9.0)


def test_other_nodes_and_what_ros_itself_reads_are_left_alone(load):
    text = """
    mavros: {ros__parameters: {conn: {timeout: 10.0}}}
    /**:
      ros__parameters:
        use_sim_time: true
        qos_overrides: {/imu/data_raw: {subscription: {depth: 5}}}
        gnss: {delay: 0.2}
    """
    assert load(text).gnss.delay == 0.2


def test_whole_numbers_serve_as_numbers(load):
    value = load("gnss: {delay: 1}").gnss.delay
    assert isinstance(value, float)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("/**: {ros__parameters: {gnss: {dely: 0.2}}}", "'gnss.dely'; did you mean 'gnss.delay'?"),
        ("/**: {ros__parameters: {gnss: {delay: fast}}}", "gnss.delay: 'fast' is not a number"),
        ("/**: {ros__parameters: {gnss: {delay: 99}}}", "gnss.delay: 99 is above the maximum 1 s"),
        ("/**: {ros__parameters: {gnss: {delay: .nan}}}", "gnss.delay: NaN is not a value"),
        ("/**: {ros__parameters: 3}", "ros__parameters of /** is not a mapping"),
        ("mavros: {ros__parameters: {a: 1}}", "has no section for"),
        ("/**: {ros_parameters: {gnss: {delay: 0.2}}}", "its section '/**' has no 'ros__parameters'"),
        ("sins_node: {ros_parameters: {gnss: {delay: 0.2}}}", "'sins_node' has no 'ros__parameters'"),
        ("/drone1/sins_node: {gnss: {delay: 0.2}}", "'/drone1/sins_node' has no 'ros__parameters'"),
        ("- 1\n- 2\n", "holds no parameters"),
        ("gnss: [1, 2\n", "is not valid YAML"),
        ("gnss: \t{delay: 1}\n\t- x", "is not valid YAML"),
    ],
)
def test_what_does_not_fit_is_one_sentence_with_file_and_key(load, text, says):
    with pytest.raises(UserError) as refusal:
        load(text)
    assert says in str(refusal.value)
    assert "drone.yaml" in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_two_nodes_that_disagree_are_refused(load):
    text = """
    sins_node: {ros__parameters: {imu: {max_gap: 1.0}}}
    anfis_node: {ros__parameters: {imu: {max_gap: 2.0}}}
    """
    with pytest.raises(UserError, match=r"imu\.max_gap differs between sins_node and anfis_node"):
        load(text)


def test_a_missing_file_and_a_folder_are_said_so(tmp_path):
    with pytest.raises(UserError, match="cannot be read"):
        load_parameters(tmp_path / "nowhere.yaml")
    with pytest.raises(UserError, match="cannot be read"):
        load_parameters(tmp_path)


# --- numbers as ROS reads them ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("5e-4", 5e-4),  # 09_yaml_exponent: PyYAML takes it for a text
        ("2e-2", 2e-2),
        ("3e3", 3e3),
        (".5", 0.5),
        ("+1", 1),
        ("1.", 1.0),
        ("1E+3", 1e3),
        ("010", 8),
        ("0x10", 16),
        ("0x1p-1", 0.5),
        ("99999999999999999999", 1e20),
        ("-.inf", -math.inf),
        ("infinity", math.inf),
        ("y", True),
        ("off", False),
        ("1:30", "1:30"),
        ("1_000", "1_000"),
        ("2024-01-01", "2024-01-01"),
        ("1e999", "1e999"),
        ("~", "~"),
        ("5e", "5e"),
    ],
)
def test_a_value_is_what_ros_takes_it_for(text, value):
    got = ros_yaml.parse(f"a: {text}")["a"]
    assert (got, type(got)) == (value, type(value))


def test_what_is_quoted_is_a_text():
    assert ros_yaml.parse("{a: '5e-4', b: \"true\"}") == {"a": "5e-4", "b": "true"}


def test_the_node_takes_the_same_values(started_parser):
    """The parser of rcl itself, where ROS is installed, reads what is read here."""
    values = ["5e-4", "+1", ".5", "1.", "010", "0x10", "y", "off", "1:30", "1_000", "2024-01-01", "~", ".NaN", "1e999"]
    expected = {f"p{i}": ros_yaml.scalar(text) for i, text in enumerate(values)}
    got = started_parser({f"p{i}": text for i, text in enumerate(values)})
    assert {name: repr(value) for name, value in got.items()} == {n: repr(value) for n, value in expected.items()}


@pytest.fixture
def started_parser(ros_domain, tmp_path):
    """``parse(names to texts)``: what a node with these parameters in its file gets."""
    rclpy = pytest.importorskip("rclpy")

    def parse(values: dict[str, str]) -> dict:
        lines = "".join(f"    {name}: {text}\n" for name, text in values.items())
        (tmp_path / "node.yaml").write_text(f"/**:\n  ros__parameters:\n{lines}")
        rclpy.init(args=["--ros-args", "--params-file", str(tmp_path / "node.yaml")])
        node = rclpy.create_node("reader", automatically_declare_parameters_from_overrides=True)
        try:
            return {name: node.get_parameter(name).value for name in values}
        finally:
            node.destroy_node()
            rclpy.shutdown()

    return parse


BOMB = "a: &a [x, x]\n" + "".join(f"{c}: &{c} [*{b}, *{b}]\n" for b, c in itertools.pairwise("abcdefghijklmnopqr"))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (BOMB, "holds the alias *a in line 2, which ROS does not read"),
        ("x: &x 1\ngnss: {delay: *x}\n", "holds the alias *x in line 2"),
        ("a: " + "[" * 5000 + "]" * 5000, "is nested deeper than 20 levels in line 1"),
        ("a: " + "{b: " * 5000 + "1" + "}" * 5000, "is nested deeper than 20 levels in line 1"),
        ("gnss: {lever_arm: [0, 0.5, 1]}", "mixes 0 and 0.5 in the list in line 1"),
        ("gnss: {lever_arm: [0.0, 0.5]}", "gnss.lever_arm: needs 3 numbers, not 2"),
        ("gnss: {lever_arm: '123'}", "gnss.lever_arm: '123' is not a list of numbers"),
        ("gnss: {lever_arm: [true, true, false]}", "is not a list of numbers"),
        ("gnss: {delay: '5e-4'}", "gnss.delay: '5e-4' is not a number"),
        ("? [1, 2]\n: 3\n", "has a key that is not a name in line 1"),
        ("gnss: {delay: }", "gnss.delay: None is not a number"),
        ("gnss:\n  delay: 0.1\nimu: {}\ngnss:\n  delay: 0.2\n", "has 'gnss' a second time in line 4"),
        ("# " + "x" * (1 << 20), "is not a parameter file: it is larger than 1 MiB"),
    ],
    ids=range(13),
)
def test_a_hostile_or_careless_file_is_one_sentence(load, text, says):
    with pytest.raises(UserError) as refusal:
        load(text)
    assert says in str(refusal.value)
    assert "\n" not in str(refusal.value)
    assert len(str(refusal.value)) < 400
