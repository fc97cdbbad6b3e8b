"""Magnetic declination from the World Magnetic Model, computed by the optional package pygeomag."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import GnssFix
from nav_pose_estimator.engine.solutions import Level
from nav_pose_estimator.errors import UserError

try:
    from pygeomag import GeoMag
except ImportError:  # reported when a declination is requested
    GeoMag = None

Say = Callable[[int, str, Level, str], None]
"""Takes stamp, name, level and sentence of an event."""


def model_declination(stamp_ns: int, lat: float, lon: float, alt: float) -> float:
    """Angle from true to magnetic North [rad], east positive, at the date of ``stamp_ns`` (Unix time).

    ``lat``, ``lon`` [rad]; ``alt`` [m] above ellipsoid or sea level, the difference does not matter here. The standard
    deviation is sqrt(0.26^2 + (5417 nT / H)^2) deg with the horizontal field H (error model of WMM2025): 0.4 deg at
    middle latitudes. Raises ``UserError`` with one clause where the model gives none.
    """
    if GeoMag is None:
        raise UserError("the package pygeomag is not installed")
    if not all(map(math.isfinite, (lat, lon, alt))):
        raise UserError("the position is not finite")
    year = _decimal_year(stamp_ns)
    try:
        model = GeoMag(base_year=int(year))
        field = model.calculate(math.degrees(lat), math.degrees(lon), 1e-3 * alt, year)
    except ValueError:
        raise UserError(f"pygeomag has no field model for the year {int(year)} of the stamps") from None
    if field.in_blackout_zone:
        raise UserError("a compass is useless this close to a magnetic pole")
    return math.radians(field.d)


def located(parameters: Parameters, fix: GnssFix, say: Say) -> Parameters:
    """``parameters`` with the model's declination at ``fix`` and ``declination_from_model`` cleared.

    Where the model gives none, ``aids.declination`` stays. An event reports either outcome.
    """
    declination = parameters.aids.declination
    try:
        declination = model_declination(fix.stamp_ns, fix.lat, fix.lon, fix.alt)
    except UserError as error:
        text = f"magnetic declination {math.degrees(declination):.1f} deg, from aids.declination: {error}"
        say(fix.stamp_ns, "mag.declination.fallback", Level.WARN, text)
    else:
        text = f"magnetic declination {math.degrees(declination):.1f} deg, from the World Magnetic Model"
        say(fix.stamp_ns, "mag.declination.model", Level.INFO, text)
    aids = replace(parameters.aids, declination=declination, declination_from_model=False)
    return replace(parameters, aids=aids)


def as_before(parameters: Parameters, before: Parameters) -> Parameters:
    """``parameters`` with the declination of ``before``, which may already be that of the model."""
    found = before.aids
    aids = replace(parameters.aids, declination=found.declination, declination_from_model=found.declination_from_model)
    return replace(parameters, aids=aids)


def _decimal_year(stamp_ns: int) -> float:
    """Unix time [ns] as a decimal year, as the model requires."""
    now = np.datetime64(stamp_ns, "ns")
    this_year = now.astype("datetime64[Y]")
    begin, end = (year.astype(now.dtype) for year in (this_year, this_year + np.timedelta64(1, "Y")))
    return float(1970 + this_year.astype(int) + (now - begin) / (end - begin))
