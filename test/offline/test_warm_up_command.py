"""``warm_up``: every part is compiled, and says so."""

from nav_pose_estimator.core.numerics.jit import COMPILED
from nav_pose_estimator.offline.command_line import main
from nav_pose_estimator.offline.replay.warm_up_command import remove_stale


def test_the_progress_is_told_part_by_part(capsys):
    assert main(["warm_up"]) == 0
    said = capsys.readouterr().out
    if COMPILED:
        assert "[1/4] attitude filters" in said
        assert "[4/4] the whole estimator" in said
    else:
        assert "plain Python" in said


def test_what_is_left_of_earlier_kernels_is_removed(tmp_path):
    """GIVEN machine code of kernels that are there, moved on, or gone with their module, and another's file
    WHEN stale files are removed THEN only that of moved and gone ones is."""
    (tmp_path / "gate.py").write_text("from jit import kernel\n\n\n@kernel\ndef bound(x):\n    return x\n")
    cache = tmp_path / "__pycache__"
    cache.mkdir()
    kept = ["gate.bound-4.py312.nbi", "gate.bound-4.py312.1.nbc", "gate.bound-4.py311.nbi", "gate.cpython-312.pyc"]
    stale = ["gate.bound-3.py312.nbi", "gate.bound-3.py312.1.nbc", "gone.bound-4.py312.nbi", "gate.limit-4.py312.nbi"]
    for name in (*kept, *stale):
        (cache / name).touch()
    assert remove_stale(tmp_path) == len(stale)
    assert {path.name for path in cache.iterdir()} == set(kept)
