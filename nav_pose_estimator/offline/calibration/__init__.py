"""Calibration of the sensors from recordings."""
