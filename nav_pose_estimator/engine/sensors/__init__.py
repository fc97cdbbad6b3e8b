"""Sensors of the navigator, one file each: from samples to observations of the filter."""
