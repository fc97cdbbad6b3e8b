"""Bags: storage, decoding, reading, writing."""
