"""PX4's time and PX4's local frame, from the vehicle_local_position that PX4 sends."""

from collections import deque
from dataclasses import dataclass
from typing import Any

_SAME_CLOCK_US = 1_000_000
_REMEMBERED = 50  # messages: one second at PX4's 50 Hz


class Px4Clock:
    """Turns our stamps into those that PX4 expects on /fmu/in.

    With UXRCE_DDS_SYNCT 1 (the default) the client moves all stamps between PX4's clock and that of the companion: both
    sides write the companion's time and nothing is to be done. Where PX4's stamps are more than a second from ours
    (UXRCE_DDS_SYNCT 0, a bag, a simulator) they are another clock, and the smallest difference of the last messages,
    that of the message that was least late, is taken off.
    """

    def __init__(self) -> None:
        self._differences: deque[int] = deque(maxlen=_REMEMBERED)

    def hear(self, px4_us: int, own_ns: int) -> None:
        """A message with PX4's stamp has come; ``own_ns`` is the newest stamp of ours."""
        difference = own_ns // 1000 - px4_us
        if self._differences and abs(difference - self._differences[-1]) > _SAME_CLOCK_US:
            self._differences.clear()  # one of the two has started again
        self._differences.append(difference)

    def stamp_us(self, own_ns: int) -> int:
        """Our stamp in PX4's time."""
        offset = min(self._differences, default=0)
        return own_ns // 1000 - (offset if abs(offset) > _SAME_CLOCK_US else 0)


@dataclass(frozen=True, slots=True)
class Px4Reference:
    """Where PX4's local frame has its zero: latitude, longitude [deg], height above the sea [m] (None: not known).

    A zero that is set again is another reference, also at the same place: ``set_at_us`` tells them apart.
    """

    set_at_us: int
    lat_deg: float
    lon_deg: float
    height_amsl: float | None


def reference(message: Any) -> Px4Reference | None:
    """That of a px4_msgs/VehicleLocalPosition; None while PX4 has none."""
    if not message.xy_global:
        return None
    height = float(message.ref_alt) if message.z_global else None
    return Px4Reference(int(message.ref_timestamp), float(message.ref_lat), float(message.ref_lon), height)
