"""Services around an engine: restart, an outage drill, and the operator's decision on a return of GNSS."""

from collections.abc import Callable
from functools import partial
from typing import Any

from std_srvs.srv import SetBool, Trigger

from nav_pose_estimator.engine.samples import ReturnDecision
from nav_pose_estimator.engine.solutions import Event, Level


def offer_reset(node: Any) -> None:
    """Service ~/reset: forget the solution and align again."""

    def reset() -> str:
        node.reset("requested by a service call")
        return "restarted"

    node.create_service(Trigger, "~/reset", partial(_serve, node, "~/reset", reset))


def offer_gnss(node: Any) -> None:
    """Services ~/use_gnss (outage drill), ~/accept_return and ~/refuse_return (``gnss.reacquisition.policy: hold``)."""

    def use_gnss(request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        node.engine.set_use_gnss(request.data)
        response.success = True
        response.message = "GNSS is used" if request.data else "GNSS is not used until it is switched on again"
        node.say("mode.use_gnss", Level.WARN, f"operator: {response.message}")
        return response

    node.create_service(SetBool, "~/use_gnss", use_gnss)
    for name, accept in (("~/accept_return", True), ("~/refuse_return", False)):
        node.create_service(Trigger, name, partial(_serve, node, name, partial(_decide, node, accept)))


def _decide(node: Any, accept: bool) -> str:
    outputs = node.engine.feed(ReturnDecision(node.newest_ns, accept))
    node.deliver(outputs)
    said = [output for output in outputs if isinstance(output, Event) and output.name.startswith("gnss.return.")]
    if not said or said[-1].name == "gnss.return.none":
        raise ValueError(said[-1].text if said else "the navigator is not running")
    return said[-1].text


def _serve(
    node: Any, name: str, action: Callable[[], str], request: Trigger.Request, response: Trigger.Response
) -> Trigger.Response:
    """Whatever goes wrong is reported, and the node lives on."""
    try:
        response.success, response.message = True, action()
    except ValueError as refusal:
        response.success, response.message = False, str(refusal)
    except Exception as error:
        node.note_failure(name, error)
        response.success, response.message = False, str(error)
    return response
