"""Constant position: extrapolation for a hovering vehicle, a baseline of the benchmark."""

from nav_pose_estimator.engine.outage.methods.method import Array, Extrapolation


class Hold(Extrapolation):
    """The vehicle stays where it was."""

    name = "hold"
    summary = "the last position"
    is_classical = True

    def velocity(self, last: Array) -> Array:
        """Zero."""
        return 0.0 * last
