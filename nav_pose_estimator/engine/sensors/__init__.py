"""One file for each sensor: from samples to observations of the filter."""
