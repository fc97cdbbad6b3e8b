"""Catalogue of all events: meaning and remedy."""
