"""Services around an engine: restart, outage drill, decision about a held return of GNSS, conversion of coordinates."""

import importlib
import math
from collections.abc import Callable
from functools import partial
from typing import Any

from std_srvs.srv import SetBool, Trigger

from nav_pose_estimator.core.earth.ellipsoid import enu_to_lla, lla_to_enu
from nav_pose_estimator.engine.samples import ReturnDecision
from nav_pose_estimator.engine.solutions import Event, Level


def offer_reset(node: Any) -> None:
    """Offer the service ~/reset: discard the solution and align again."""

    def reset() -> str:
        node.reset("requested by a service call")
        return "restarted"

    node.create_service(Trigger, "~/reset", partial(_serve, node, "~/reset", reset))


def offer_gnss(node: Any) -> None:
    """Offer ~/use_gnss (outage drill), and ~/accept_return, ~/refuse_return (``gnss.reacquisition.policy: hold``)."""

    def use_gnss(request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        node.engine.set_use_gnss(request.data)
        response.success = True
        response.message = "GNSS is used" if request.data else "GNSS is not used until it is switched on again"
        node.say("mode.use_gnss", Level.WARN, f"operator: {response.message}")
        return response

    node.create_service(SetBool, "~/use_gnss", use_gnss)
    for name, accept in (("~/accept_return", True), ("~/refuse_return", False)):
        node.create_service(Trigger, name, partial(_serve, node, name, partial(_decide, node, accept)))


def offer_coordinates(node: Any) -> None:
    """Offer ~/from_ll and ~/to_ll as robot_localization defines them, where it is installed.

    Heights are above the ellipsoid; NaN stands for the height of the origin. As the response has no field for a
    failure, it is NaN before there is an origin, and the log gives the reason.
    """
    try:
        kinds = importlib.import_module("robot_localization.srv")
    except ImportError:
        return
    node.create_service(kinds.FromLL, "~/from_ll", partial(_from_ll, node))
    node.create_service(kinds.ToLL, "~/to_ll", partial(_to_ll, node))


def _from_ll(node: Any, request: Any, response: Any) -> Any:
    """Convert latitude, longitude [deg] and height [m] to a point in map [m]."""
    place, origin = request.ll_point, _known_origin(node, "~/from_ll")
    height = origin[2] if math.isnan(place.altitude) else place.altitude
    position = lla_to_enu(math.radians(place.latitude), math.radians(place.longitude), height, *origin)
    point = response.map_point
    point.x, point.y, point.z = position.tolist()
    return response


def _to_ll(node: Any, request: Any, response: Any) -> Any:
    """Convert a point in map [m] to latitude, longitude [deg] and height [m]."""
    point, origin = request.map_point, _known_origin(node, "~/to_ll")
    lat, lon, height = enu_to_lla((point.x, point.y, point.z), *origin)
    place = response.ll_point
    place.latitude, place.longitude, place.altitude = math.degrees(lat), math.degrees(lon), float(height)
    return response


def _known_origin(node: Any, service: str) -> tuple[float, float, float]:
    origin: tuple[float, float, float] | None = node.engine.origin
    if origin is None:
        node.say("coordinates.no_origin", Level.WARN, f"{service}: there is no origin yet, the answer is NaN")
        return math.nan, math.nan, math.nan
    return origin


def _decide(node: Any, accept: bool) -> str:
    outputs = node.engine.feed(ReturnDecision(node.newest_ns, accept))
    node.deliver(outputs)
    events = [output for output in outputs if isinstance(output, Event) and output.name.startswith("gnss.return.")]
    if not events or events[-1].name == "gnss.return.none":
        raise ValueError(events[-1].text if events else "the navigator is not running")
    return events[-1].text


def _serve(
    node: Any, name: str, action: Callable[[], str], request: Trigger.Request, response: Trigger.Response
) -> Trigger.Response:
    """Call ``action`` and respond with its sentence; an exception is reported and does not end the node."""
    try:
        response.success, response.message = True, action()
    except ValueError as refusal:
        response.success, response.message = False, str(refusal)
    except Exception as error:
        node.note_failure(name, error)
        response.success, response.message = False, str(error)
    return response
