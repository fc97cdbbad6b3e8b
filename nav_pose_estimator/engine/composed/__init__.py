"""The composed estimator of `pose_estimator` and `replay`: attitude filter, navigator and outage aid."""
