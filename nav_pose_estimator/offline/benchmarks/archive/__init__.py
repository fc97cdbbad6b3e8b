"""What archives of recordings cost, and what a killed process loses."""
