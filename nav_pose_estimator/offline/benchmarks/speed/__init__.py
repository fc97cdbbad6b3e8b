"""What the estimators cost."""
