"""Parameters of the local frame's origin."""

import math
from dataclasses import dataclass

from nav_pose_estimator.engine.parameters.schema import ParameterError, param

UNSET = -1000.0
"""Value of latitude, longitude and height that are not set."""


@dataclass(frozen=True)
class OriginParameters:
    """The origin of map: a fixed place, the same at every start, or the first trusted position."""

    latitude: float = param(UNSET, "deg", "Latitude of the origin of map; -1000: first trusted position", UNSET, 90.0)
    longitude: float = param(UNSET, "deg", "Its longitude, East positive; -1000: first trusted position", UNSET, 360.0)
    height: float = param(
        UNSET,
        "m",
        "Its height above the WGS84 ellipsoid; -1000: first trusted position",
        UNSET,
        1e4,
    )

    def place(self) -> tuple[float, float, float] | None:
        """Latitude, longitude [rad] and height [m], None where nothing is set; ``ParameterError`` for half a place."""
        values = {"latitude": self.latitude, "longitude": self.longitude, "height": self.height}
        missing = [name for name, value in values.items() if value == UNSET]
        if len(missing) == len(values):
            return None
        if missing:
            raise ParameterError(f"origin.{missing[0]} is missing: latitude, longitude and height go together")
        if self.latitude < -90.0 or self.longitude < -180.0:
            raise ParameterError(f"origin: {self.latitude:g}, {self.longitude:g} is no latitude and longitude")
        return math.radians(self.latitude), math.radians(self.longitude), self.height
