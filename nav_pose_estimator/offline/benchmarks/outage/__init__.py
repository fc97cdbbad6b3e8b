"""Outages over many flights and methods."""
