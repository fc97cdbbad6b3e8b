"""Observations about which nothing is unusual, on their way through compiled code."""
