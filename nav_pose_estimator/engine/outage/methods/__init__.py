"""Outage methods, one file each; ``method`` is their interface, and ``registry`` lists them."""
