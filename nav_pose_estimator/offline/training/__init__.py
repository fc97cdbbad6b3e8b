"""What recordings of past flights teach before the next one: ``train``."""
