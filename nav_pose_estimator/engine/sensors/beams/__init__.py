"""Parts of the beam velocity sensor: messages, conventions, agreement with the navigator, compensation."""
