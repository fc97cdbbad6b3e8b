"""Entry of the event catalogue, and remedies that several entries share."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Entry:
    """One kind of event: ``meaning``, one clause for the user; ``cure``, the remedy, empty where nothing is wrong."""

    name: str
    meaning: str
    cure: str = ""


CLOCKS = "synchronise the clocks of driver and host (chrony, PX4 and MAVROS time sync)"
SENSOR = "check the driver and the wiring; a few are harmless"
WAIT = "wait; if it persists, check the count on the driver's topic"
