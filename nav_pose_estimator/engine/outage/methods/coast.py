"""Nothing but the Kalman filter: what every other method is measured against."""

from nav_pose_estimator.engine.outage.methods.method import OutageMethod


class Coast(OutageMethod):
    """The navigator continues alone."""

    name = "coast"
    summary = "the Kalman filter alone"
    is_classical = True
    helps = False
