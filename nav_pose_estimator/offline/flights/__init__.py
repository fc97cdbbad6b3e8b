"""Recorded and simulated flights in memory, outages in them, and what they are judged by."""
