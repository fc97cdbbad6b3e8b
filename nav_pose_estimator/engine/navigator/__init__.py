"""The strapdown navigator: filter on its time line, modes, start."""
