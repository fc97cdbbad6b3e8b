"""Constant velocity: extrapolation with the last one, a baseline of the benchmark."""

from nav_pose_estimator.engine.outage.methods.method import Array, Extrapolation


class ConstVelocity(Extrapolation):
    """The vehicle keeps its last velocity."""

    name = "const_velocity"
    summary = "the last velocity"
    is_classical = True

    def velocity(self, last: Array) -> Array:
        """The last one."""
        return last
