"""Numerics that every other room uses: compiled kernels, 3-vectors, rotations, checks of numbers."""
