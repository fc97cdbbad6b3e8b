"""All engines in one: what `pose_estimator` and `replay` run."""
