"""Reading ROS parameter files for replay: what is taken, what is ignored, what is refused and how."""

import pytest

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.errors import UserError
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
