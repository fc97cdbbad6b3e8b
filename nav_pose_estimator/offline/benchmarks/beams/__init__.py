"""Beam velocities without GNSS while beams fail, in simulation."""
