"""The IMU: its samples checked, named and turned into the body."""
