"""Pressure and height in the ICAO standard atmosphere (ISO 2533) below 11 km, and under water; scalars and arrays."""

from typing import TypeVar

from numpy.typing import NDArray

Numbers = TypeVar("Numbers", float, NDArray)

_SEA_LEVEL_PRESSURE = 101_325.0  # Pa
_SEA_LEVEL_TEMPERATURE = 288.15  # K
_LAPSE_RATE = 0.0065  # K/m
_GAS_CONSTANT = 287.053  # J/(kg K), of dry air
_EXPONENT = 0.190263  # R L / (g M)


def pressure_height(pressure: Numbers) -> Numbers:
    """Pressure altitude [m] of the static ``pressure`` [Pa]."""
    return _SEA_LEVEL_TEMPERATURE / _LAPSE_RATE * (1.0 - (pressure / _SEA_LEVEL_PRESSURE) ** _EXPONENT)


def air_density(pressure: Numbers) -> Numbers:
    """Density [kg/m^3] of dry air at the static ``pressure`` [Pa] and the temperature of the standard atmosphere."""
    temperature = _SEA_LEVEL_TEMPERATURE - _LAPSE_RATE * pressure_height(pressure)
    return pressure / (_GAS_CONSTANT * temperature)


def height_pressure(height: Numbers) -> Numbers:
    """Static pressure [Pa] at a pressure altitude ``height`` [m]; the inverse of ``pressure_height``."""
    return _SEA_LEVEL_PRESSURE * (1.0 - height * _LAPSE_RATE / _SEA_LEVEL_TEMPERATURE) ** (1.0 / _EXPONENT)


def water_height(pressure: Numbers, density: float, gravity: float) -> Numbers:
    """Height [m] above the water surface (negative below it) of the absolute ``pressure`` [Pa].

    The water has ``density`` [kg/m^3]; ``gravity`` [m/s^2].
    """
    return (_SEA_LEVEL_PRESSURE - pressure) / (density * gravity)
