"""Pose estimation for drones that lose GNSS: conventions and public names.

Frames
    n   navigation frame, local level, East-North-Up (REP-103), origin at the vehicle.
    b   body frame, Forward-Left-Up (REP-103).
    e   Earth-fixed frame, i inertial frame.

Letters
    ``v_n`` is a vector resolved in n. ``C_nb`` and ``q_nb`` rotate b into n: ``v_n = C_nb @ v_b``.
    Quaternions are Hamilton, scalar first ``(w, x, y, z)``; ROS messages store ``(x, y, z, w)`` and are
    converted only in ``nav_pose_estimator.ros``.
    ``w_ib_b`` is the angular rate of b against i resolved in b (what a gyroscope measures, rad/s);
    ``f_b`` is specific force (what an accelerometer measures, m/s^2): at rest and level it reads (0, 0, +g).
    Positions are geodetic on WGS-84: latitude and longitude in radians, height above the ellipsoid in metres.
    Yaw is counter-clockwise from East (REP-103); compass heading = pi/2 - yaw.

Units
    SI and radians everywhere. A name that ends in ``_deg``, ``_hz``, ``_g`` ... says otherwise.
    Spread: ``_sd`` one standard deviation, ``_var`` variance, ``_cov`` covariance, ``_psd`` spectral density.
    Time: integer nanoseconds in samples (``stamp_ns``), float seconds since the engine's first stamp in kernels.

Error state (order and signs)
    ``[phi, dv, dp, bg, ba]`` in the n frame (phi, dv, dp) and the b frame (bg, ba), position in metres.
    Errors are estimate minus truth: ``v_hat = v + dv``, ``p_hat = p + dp``, ``C_hat = (I - [phi x]) C``.
    Bias states are what is still missing from the estimate: ``b = b_hat + state``.
    Code addresses the states by name (``core.filter.layout``), never by number.
"""

from importlib import import_module

__version__ = "0.1.0"

_PUBLIC = {
    "estimate_attitude": "nav_pose_estimator.engine.attitude.recorded",
    "Anfis": "nav_pose_estimator.core.learning.anfis",
}
__all__ = ["Anfis", "__version__", "estimate_attitude"]


def __getattr__(name: str):
    """Load the public names on first use, so that a node does not pay for what it does not need."""
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
