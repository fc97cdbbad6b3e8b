"""Pure numerics: arrays in, arrays out. No ROS, no files, no clock, no logging."""
