"""Routine flight in compiled code: IMU rows and the expected observations between them in one call."""
