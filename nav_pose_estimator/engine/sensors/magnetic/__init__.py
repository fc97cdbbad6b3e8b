"""Magnetic heading: declination, calibration of the magnetometer, and the check of the heading in motion."""
