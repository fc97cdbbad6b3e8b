"""The command line as a user meets it: help, exit codes, one sentence for what is wrong."""

import io
import os
import subprocess
import sys
import types

import pytest

from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline import command_line
from nav_pose_estimator.offline.benchmarks.command import PARTS
from nav_pose_estimator.offline.command_line import COMMANDS, main, run_command


@pytest.fixture
def fake(monkeypatch):
    """Puts ``run`` or a node's ``main`` in the place of the real module of every command."""

    def install(action):
        module = types.SimpleNamespace(
            add_arguments=lambda parser: parser.add_argument("--speed"), run=action, main=action
        )
        monkeypatch.setattr(command_line, "import_module", lambda name: module)

    return install


def raising(error):
    def action(_):
        raise error

    return action


def test_help_lists_every_command(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--help"])
    assert stop.value.code == 0
    text = capsys.readouterr().out
    assert all(name in text for name in COMMANDS)


def test_a_terminal_without_a_character_ends_no_run(fake, monkeypatch):
    output = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(output, encoding="ascii"))
    fake(lambda _: print("1.0 \N{EN DASH}"))
    assert run_command("replay", []) == 0
    sys.stdout.flush()
    assert output.getvalue() == b"1.0 ?\n"


def test_the_help_fits_into_any_terminal(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "1")
    with pytest.raises(SystemExit) as stop:
        main(["warm_up", "--help"])
    assert stop.value.code == 0
    assert capsys.readouterr().out


def test_without_a_command_the_help_is_wrong_use(capsys):
    assert main([]) == 2
    assert "replay" in capsys.readouterr().err


def test_an_unknown_command_is_named_with_the_nearest(capsys):
    assert main(["reply"]) == 2
    assert capsys.readouterr().err == "nav_pose_estimator: there is no command 'reply'; did you mean 'replay'?\n"


def test_an_unknown_option_is_one_sentence(fake, capsys):
    fake(lambda _: 0)
    assert run_command("replay", ["--sped", "3", "--loud"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_value_with_a_minus_is_told_how_to_give(fake, capsys):
    fake(lambda _: 0)
    assert run_command("replay", ["--speed", "-33.9,151.2"]) == 2
    assert "--option=-VALUE" in capsys.readouterr().err
    assert run_command("replay", ["--speed=-33.9,151.2"]) == 0


def test_options_reach_the_command(fake):
    seen = []
    fake(lambda arguments: seen.append(arguments.speed))
    assert run_command("replay", ["--speed", "3"]) == 0
    assert seen == ["3"]


def test_ros_arguments_reach_a_node_untouched(fake):
    seen = []
    fake(seen.append)
    given = ["--ros-args", "-p", "gnss.delay:=0.1", "-r", "__ns:=/drone", "--params-file", "a b.yaml"]
    assert main(["sins_node", *given]) == 0
    assert seen == [given]


def test_a_node_takes_no_other_arguments(fake, capsys):
    fake(lambda _: 0)
    assert run_command("sins_node", ["--ros-args", "-p", "a:=1", "--", "fast"]) == 2
    assert "fast" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "code", "says"),
    [
        (UserError("the bag holds no IMU"), 2, "the bag holds no IMU"),
        (FileNotFoundError(2, "No such file or directory", "flight.mcap"), 2, "flight.mcap: No such file or directory"),
        (ZeroDivisionError("division\nby zero"), 1, "failed: ZeroDivisionError: division by zero"),
        (ModuleNotFoundError("No module named 'rosbags'", name="rosbags"), 1, "package rosbags is not installed"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_what_goes_wrong_is_one_sentence_and_a_code(fake, capsys, error, code, says):
    fake(raising(error))
    assert run_command("replay", []) == code
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("replay: ")
    assert says in lines[0]


def test_debug_shows_the_traceback(fake, capsys, monkeypatch):
    monkeypatch.setenv("NAV_POSE_DEBUG", "1")
    fake(raising(ValueError("odd")))
    assert run_command("replay", []) == 1
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize("missing", ["rclpy", "std_srvs"])  # whichever is imported first
def test_without_ros_a_node_says_how_to_get_it(monkeypatch, capsys, missing):
    monkeypatch.setitem(sys.modules, "rclpy", None)
    error = ModuleNotFoundError(f"No module named {missing!r}", name=missing)
    monkeypatch.setattr(command_line, "import_module", raising(error))
    assert run_command("sins_node", []) == 2
    assert "make setup" in capsys.readouterr().err


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help_with_an_example(name, capsys):
    with pytest.raises(SystemExit) as stop:
        run_command(name, ["--help"])
    assert stop.value.code == 0
    assert "examples:" in capsys.readouterr().out


@pytest.mark.parametrize("part", PARTS)
def test_every_benchmark_explains_its_options(part, capsys):
    with pytest.raises(SystemExit) as stop:
        run_command("benchmark", [part, "--help"])
    assert stop.value.code == 0
    assert "options:" in capsys.readouterr().out


def test_help_loads_neither_ros_nor_the_compiler():
    code = (
        "import sys\n"
        "from nav_pose_estimator.offline.command_line import main\n"
        "try: main(['replay', '--help'])\n"
        "except SystemExit: pass\n"
        "heavy = {'rclpy', 'numba', 'scipy', 'matplotlib', 'numpy'} & set(sys.modules)\n"
        "sys.exit(f'loaded {heavy}' if heavy else 0)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=os.environ, check=False, timeout=300
    )
    assert done.returncode == 0, done.stderr
