"""GNSS: reception, position, velocity, and what its loss does."""
