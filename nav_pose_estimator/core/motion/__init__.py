"""How vehicles move: epochs, regimes, velocity through the air, wind."""
