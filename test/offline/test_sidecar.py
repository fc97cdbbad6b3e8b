"""NAME.json is found beside a recording, whatever dots its name has."""

import json
from pathlib import Path

import pytest

from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.sidecar import flight_name, sidecar, sidecar_path


@pytest.mark.parametrize(
    ("recording", "name"),
    [
        ("flight_bag", "flight"),
        ("flight.1_bag", "flight.1"),  # of flight.1.ulg, as ``convert`` names it in a folder of logs
        ("flight.1.ulg", "flight.1"),
        ("flight.mcap", "flight"),
        ("flight_bag.mcap", "flight"),
        ("bagged", "bagged"),
    ],
)
def test_the_name_of_a_flight(recording: str, name: str) -> None:
    assert flight_name(Path(recording)) == name


def test_a_link_has_the_sidecar_of_what_it_links_to(tmp_path: Path) -> None:
    """GIVEN two bags of one day and a link to one WHEN it is read THEN the data are those of that bag."""
    for number in (1, 2):
        (tmp_path / f"2026.01.0{number}_bag").mkdir()
        sidecar_path(tmp_path / f"2026.01.0{number}_bag").write_text(json.dumps({"group": f"day {number}"}))
    (tmp_path / "elsewhere").mkdir()
    link = tmp_path / "elsewhere" / "my_bag"
    link.symlink_to(tmp_path / "2026.01.02_bag")
    assert sidecar(link) == {"group": "day 2"}


@pytest.mark.parametrize("content", ["{", '{"gnss_latency_est_s": "late"}', '{"flight_window_s": [1.0]}'])
def test_a_damaged_sidecar_is_refused_by_name(tmp_path: Path, content: str) -> None:
    (tmp_path / "flight.json").write_text(content)
    with pytest.raises(UserError, match=r"flight\.json"):
        sidecar(tmp_path / "flight_bag")
