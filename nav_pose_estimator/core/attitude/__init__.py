"""Attitude filters: complementary and two-stage Kalman."""
