"""PX4's clock and the reference of its local frame, by the messages vehicle_local_position that PX4 publishes."""

from collections import deque
from dataclasses import dataclass
from typing import Any

_SAME_CLOCK_US = 1_000_000  # largest difference of stamps of the same clock
_REMEMBERED = 50  # messages: one second at PX4's 50 Hz


class Px4Clock:
    """Converts stamps of this computer to those that PX4 expects on /fmu/in.

    With UXRCE_DDS_SYNCT 1 (the default) the client converts all stamps between PX4's clock and the companion's, so that
    both sides use the companion's time and the stamps need no conversion. Where PX4's stamps differ by more than a
    second (UXRCE_DDS_SYNCT 0, a bag, a simulator), they are of another clock. The offset is the smallest difference of
    the last messages, which is that of the message with the smallest delay.
    """

    def __init__(self) -> None:
        self._differences: deque[int] = deque(maxlen=_REMEMBERED)

    def note(self, px4_us: int, own_ns: int) -> None:
        """Store the stamp of a message by PX4; ``own_ns`` is the newest stamp of this computer."""
        difference = own_ns // 1000 - px4_us
        if self._differences and abs(difference - self._differences[-1]) > _SAME_CLOCK_US:
            self._differences.clear()  # one of the two clocks started again
        self._differences.append(difference)

    def stamp_us(self, own_ns: int) -> int:
        """The stamp ``own_ns`` of this computer in PX4's time [us]."""
        offset = min(self._differences, default=0)
        return own_ns // 1000 - (offset if abs(offset) > _SAME_CLOCK_US else 0)


@dataclass(frozen=True, slots=True)
class Px4Reference:
    """Origin of PX4's local frame: latitude, longitude [deg], height above mean sea level [m] (None: unknown).

    ``set_at_us`` distinguishes references that were set at the same place at different times.
    """

    set_at_us: int
    lat_deg: float
    lon_deg: float
    height_amsl: float | None


def reference(message: Any) -> Px4Reference | None:
    """The reference in a px4_msgs/VehicleLocalPosition; None while PX4 has none."""
    if not message.xy_global:
        return None
    height = float(message.ref_alt) if message.z_global else None
    return Px4Reference(int(message.ref_timestamp), float(message.ref_lat), float(message.ref_lon), height)
