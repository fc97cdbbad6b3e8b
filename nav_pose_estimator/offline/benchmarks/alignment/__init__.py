"""Fine alignment with different measurement noise."""
