"""Published attitude filters, run in the same process on the same arrays. Each is optional.

Every function takes ``(trial, with_mag)`` and returns (N, 4) quaternions, body to ENU.
"""

import math
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec

import numpy as np

from nav_pose_estimator.core.numerics.rotation import quat_multiply_many
from nav_pose_estimator.offline.benchmarks.attitude.trials import Trial

_G = 9.81
_NWU_TO_ENU = np.array([math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)])


def _vqf(trial: Trial, with_mag: bool, **settings: float) -> np.ndarray:
    from vqf import VQF

    arrays = (np.ascontiguousarray(x) for x in (trial.gyro, trial.accel, trial.mag))
    out = VQF(1.0 / trial.rate, **settings).updateBatch(*arrays)
    return out["quat9D" if with_mag else "quat6D"]


def _imufusion(trial: Trial, with_mag: bool, gain: float, acceleration: float, magnetic: float) -> np.ndarray:
    import imufusion

    settings = imufusion.AhrsSettings()
    settings.convention = imufusion.CONVENTION_ENU  # the constructor's argument of that name has no effect
    settings.gain, settings.gyroscope_range, settings.sample_rate = gain, 2000.0, trial.rate
    settings.acceleration_rejection, settings.magnetic_rejection = acceleration, magnetic
    settings.rejection_timeout = int(5 * trial.rate)
    ahrs, bias, bias_settings = imufusion.Ahrs(), imufusion.Bias(), imufusion.BiasSettings()
    bias_settings.sample_rate = trial.rate
    ahrs.set_settings(settings)
    ahrs.set_sample_period(1.0 / trial.rate)
    bias.set_settings(bias_settings)
    gyro, accel, mag = (x.astype(np.float32) for x in (np.degrees(trial.gyro), trial.accel / _G, trial.mag))
    out = np.empty((len(gyro), 4))
    for i in range(len(gyro)):
        rate = bias.update(gyro[i])
        if with_mag:
            ahrs.update(rate, accel[i], mag[i])
        else:
            ahrs.update_no_magnetometer(rate, accel[i])
        out[i] = ahrs.get_quaternion()
    return out


def _madgwick(trial: Trial, with_mag: bool, **settings: float) -> np.ndarray:
    from ahrs.filters import Madgwick

    mag = trial.mag if with_mag else None
    q = Madgwick(gyr=trial.gyro, acc=trial.accel, mag=mag, frequency=trial.rate, **settings).Q
    return quat_multiply_many(_NWU_TO_ENU, q)


def _mahony(trial: Trial, with_mag: bool, **settings: float) -> np.ndarray:
    from ahrs.filters import Mahony

    mag = trial.mag if with_mag else None
    return Mahony(gyr=trial.gyro, acc=trial.accel, mag=mag, frequency=trial.rate, **settings).Q


Peer = Callable[[Trial, bool], np.ndarray]
PEERS: dict[str, tuple[str, Peer]] = {
    "vqf": ("vqf", _vqf),
    "vqf_tau_mag_20": ("vqf", partial(_vqf, tauMag=20.0)),
    "imufusion": ("imufusion", partial(_imufusion, gain=0.5, acceleration=10.0, magnetic=10.0)),
    "imufusion_tuned": ("imufusion", partial(_imufusion, gain=0.2, acceleration=20.0, magnetic=10.0)),
    "madgwick": ("ahrs", _madgwick),
    "madgwick_tuned": ("ahrs", partial(_madgwick, gain=0.03)),
    "mahony": ("ahrs", _mahony),
    "mahony_tuned": ("ahrs", partial(_mahony, k_P=0.3, k_I=0.001)),
}
"""(Python package, filter) by name, with the settings of their authors; ``_tuned``: by a grid search on BROAD."""


def installed() -> list[str]:
    """Names of the peers whose packages are installed."""
    return [name for name, (package, _) in PEERS.items() if find_spec(package) is not None]
