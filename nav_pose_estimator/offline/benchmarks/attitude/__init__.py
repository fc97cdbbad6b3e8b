"""Attitude filters against optical truth."""
