"""Earth's magnetic field: its declination, the calibration of what measures it, and whether the heading agrees."""
