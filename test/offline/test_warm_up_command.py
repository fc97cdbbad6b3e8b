"""``warm_up``: every part is compiled, and says so."""

from nav_pose_estimator.core.numerics.jit import COMPILED
from nav_pose_estimator.offline.command_line import main


def test_the_progress_is_told_part_by_part(capsys):
    assert main(["warm_up"]) == 0
    said = capsys.readouterr().out
    if COMPILED:
        assert "[1/4] attitude filters" in said
        assert "[4/4] the whole estimator" in said
    else:
        assert "plain Python" in said
