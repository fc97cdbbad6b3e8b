"""The strapdown navigator: engine, filter on its time line, start-up, modes and status."""
