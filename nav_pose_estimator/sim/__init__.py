"""Simulated vehicles and sensors."""
