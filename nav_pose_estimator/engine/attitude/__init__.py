"""The attitude engine around the attitude filters."""
