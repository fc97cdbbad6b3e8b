"""Continuation after a restart or an IMU gap: the saved state of a navigator, and the warm start from it."""
