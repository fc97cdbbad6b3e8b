"""Flight logs as they lie on disk: tables of numbers by message."""
