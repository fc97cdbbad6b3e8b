"""What outlives a restart: the state of a navigator as plain numbers, and how the next one continues from it."""
