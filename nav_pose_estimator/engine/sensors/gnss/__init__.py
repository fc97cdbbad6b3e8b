"""GNSS: reception, position, velocity, their monitors, and the loss of GNSS."""
