"""The Earth: ellipsoid, gravity, atmosphere."""
