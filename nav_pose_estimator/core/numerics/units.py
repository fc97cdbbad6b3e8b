"""Units other than SI, in which drivers and data sheets give their numbers."""

STANDARD_GRAVITY = 9.80665
"""m/s^2: the unit g (CGPM, 1901), and the force of gravity where the latitude is not known."""

SPEEDS = {"knots": 1.944, "mph": 2.237, "ft/s": 3.281, "km/h": 3.6, "cm/s": 100.0, "mm/s": 1000.0}
"""Value of 1 m/s in that unit."""
