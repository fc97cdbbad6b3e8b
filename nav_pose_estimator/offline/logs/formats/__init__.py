"""Flight logs as they stand in files, read into tables."""
