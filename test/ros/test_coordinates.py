"""~/from_ll and ~/to_ll with the fields of robot_localization's definitions, and set_origin as messages bring it."""

import math
from types import SimpleNamespace

import pytest
from sensor_msgs.msg import NavSatFix

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import SetOrigin
from nav_pose_estimator.ros import services
from nav_pose_estimator.ros.messages import message_table

ORIGIN = math.radians(47.0), math.radians(8.0), 500.0


class Node:
    """Offers services and keeps what is said."""

    def __init__(self, origin: tuple[float, float, float] | None) -> None:
        self.engine = SimpleNamespace(origin=origin)
        self.services: dict[str, object] = {}
        self.said: list[str] = []

    def create_service(self, kind, name, callback) -> None:
        self.services[name] = callback

    def say(self, name, level, text) -> None:
        self.said.append(name)


@pytest.fixture
def offered(monkeypatch):
    """``offered(origin)``: a node beside an installed robot_localization."""
    kinds = SimpleNamespace(FromLL=object(), ToLL=object())
    monkeypatch.setattr(services.importlib, "import_module", {"robot_localization.srv": kinds}.__getitem__)

    def make(origin):
        node = Node(origin)
        services.offer_coordinates(node)
        return node

    return make


def from_ll(node: Node, latitude: float, longitude: float, altitude: float) -> SimpleNamespace:
    request = SimpleNamespace(ll_point=SimpleNamespace(latitude=latitude, longitude=longitude, altitude=altitude))
    return node.services["~/from_ll"](request, SimpleNamespace(map_point=SimpleNamespace())).map_point


def to_ll(node: Node, x: float, y: float, z: float) -> SimpleNamespace:
    request = SimpleNamespace(map_point=SimpleNamespace(x=x, y=y, z=z))
    return node.services["~/to_ll"](request, SimpleNamespace(ll_point=SimpleNamespace())).ll_point


def test_from_ll_and_to_ll_are_each_others_inverse(offered):
    """GIVEN an origin WHEN a place goes to map and back THEN it is the same, and North is y."""
    node = offered(ORIGIN)
    point = from_ll(node, 47.01, 8.0, 500.0)
    assert point.y == pytest.approx(1111.7, abs=1.0)
    assert point.x == pytest.approx(0.0, abs=1e-6)
    place = to_ll(node, point.x, point.y, point.z)
    assert (place.latitude, place.longitude, place.altitude) == pytest.approx((47.01, 8.0, 500.0), abs=1e-7)
    assert from_ll(node, 47.0, 8.0, math.nan).z == pytest.approx(0.0, abs=1e-6), "no height: that of the origin"


def test_before_there_is_an_origin_the_answer_is_not_a_number_and_the_log_says_why(offered):
    node = offered(None)
    assert math.isnan(from_ll(node, 47.0, 8.0, 500.0).x)
    assert math.isnan(to_ll(node, 1.0, 2.0, 3.0).latitude)
    assert node.said == ["coordinates.no_origin"] * 2


def test_without_robot_localization_there_are_no_such_services(monkeypatch):
    def missing(name):
        raise ImportError(name)

    monkeypatch.setattr(services.importlib, "import_module", missing)
    node = Node(ORIGIN)
    services.offer_coordinates(node)
    assert node.services == {}


def test_both_messages_set_the_same_origin():
    """GIVEN a NavSatFix and a GeoPointStamped of one place THEN they are one sample, by ros.input.set_origin."""
    fix = NavSatFix(latitude=47.0, longitude=8.0, altitude=500.0)
    stamp = SimpleNamespace(sec=0, nanosec=0)
    position = SimpleNamespace(latitude=47.0, longitude=8.0, altitude=500.0)
    point = SimpleNamespace(header=SimpleNamespace(stamp=stamp), position=position)
    wanted = update(Parameters(), {"ros.input.set_origin": "geopoint"})
    sources = [message_table.SET_ORIGIN.source(parameters) for parameters in (Parameters(), wanted)]
    assert [source.type for source in sources] == ["sensor_msgs/msg/NavSatFix", "geographic_msgs/msg/GeoPointStamped"]
    assert [source.adapter(m) for source, m in zip(sources, (fix, point), strict=True)] == [
        (SetOrigin(0, *ORIGIN),)
    ] * 2
