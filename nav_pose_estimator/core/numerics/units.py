"""Units in which drivers send what ROS wants in SI units."""

SPEEDS = {"knots": 1.944, "mph": 2.237, "ft/s": 3.281, "km/h": 3.6, "cm/s": 100.0, "mm/s": 1000.0}
"""Value of 1 m/s in that unit."""
