"""The command `replay` and the files it writes."""
