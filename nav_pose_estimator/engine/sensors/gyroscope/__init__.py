"""The gyroscope as a sensor with a scale: watch over it, and the prior of its scale factors."""
