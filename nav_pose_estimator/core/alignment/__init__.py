"""The start: levelling, heading, rest, in motion and standing still."""
