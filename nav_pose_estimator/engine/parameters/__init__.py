"""All parameters of the package with default, unit, range and description, each written once.

The tree has the structure of the YAML file: ``gnss.delay`` is ``Parameters().gnss.delay``.
"""

from dataclasses import dataclass, field

from nav_pose_estimator.engine.parameters.aids import AidParameters
from nav_pose_estimator.engine.parameters.alignment import AlignmentParameters
from nav_pose_estimator.engine.parameters.attitude import AttitudeParameters
from nav_pose_estimator.engine.parameters.gnss import GnssParameters
from nav_pose_estimator.engine.parameters.imu import ImuParameters
from nav_pose_estimator.engine.parameters.learner import LearnerParameters
from nav_pose_estimator.engine.parameters.navigator import NavigatorParameters
from nav_pose_estimator.engine.parameters.origin import OriginParameters
from nav_pose_estimator.engine.parameters.ros import RosParameters


@dataclass(frozen=True)
class Parameters:
    """The whole parameter tree."""

    imu: ImuParameters = field(default_factory=ImuParameters)
    gnss: GnssParameters = field(default_factory=GnssParameters)
    attitude: AttitudeParameters = field(default_factory=AttitudeParameters)
    alignment: AlignmentParameters = field(default_factory=AlignmentParameters)
    navigator: NavigatorParameters = field(default_factory=NavigatorParameters)
    origin: OriginParameters = field(default_factory=OriginParameters)
    aids: AidParameters = field(default_factory=AidParameters)
    learner: LearnerParameters = field(default_factory=LearnerParameters)
    ros: RosParameters = field(default_factory=RosParameters)
