"""Flight in which nothing is unusual, in compiled code: IMU rows and the observations between them in one call."""
