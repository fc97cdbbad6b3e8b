"""Models of vehicle motion, learned in aided flight: epochs, regimes, velocity through the air, wind, priors."""
