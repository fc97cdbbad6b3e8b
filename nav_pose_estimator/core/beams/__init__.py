"""Velocities along beams: how they lie, which of them are sound, how noisy they are."""
