"""The state on disk: written in flight, read at the start."""
