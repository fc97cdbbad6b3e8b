"""Velocities along beams: which of them are believed, and how far."""
