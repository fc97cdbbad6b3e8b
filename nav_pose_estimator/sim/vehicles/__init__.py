"""Vehicles: how they move."""
