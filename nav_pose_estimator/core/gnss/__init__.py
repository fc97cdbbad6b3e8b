"""Integrity of GNSS: quality gate, return after an outage, and tests of positions, velocities and heights."""
