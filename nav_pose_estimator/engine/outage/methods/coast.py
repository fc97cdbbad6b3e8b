"""Coasting: the Kalman filter alone, the reference of every other method."""

from nav_pose_estimator.engine.outage.methods.method import OutageMethod


class Coast(OutageMethod):
    """The navigator continues without evidence."""

    name = "coast"
    summary = "the Kalman filter alone"
    is_classical = True
    helps = False
