"""Python client of Driftless: maps, poses with covariances, and recorded runs as numpy arrays.

Poses are named parent_from_child. Rotations are Hamilton quaternions, w first. Every covariance is over [dtheta, dp] in the
parent frame (rad, m). Times are integer nanoseconds of the sensor's clock.
"""

from .errors import DriftlessError, NoAnswer, Refused, Unreadable
from .features import extract_features
from .fleet import Fleet
from .messages import FeatureKind, Keyframe, Localization, MapInfo, PossiblePlace, RobotOdometry, RobotPose, RobotStatus
from .poses import Pose
from .runs import Run
from .subscription import Subscription
from .tracks import Errors, Track

__all__ = [
    "DriftlessError",
    "Errors",
    "FeatureKind",
    "Fleet",
    "Keyframe",
    "Localization",
    "MapInfo",
    "NoAnswer",
    "Pose",
    "PossiblePlace",
    "Refused",
    "RobotOdometry",
    "RobotPose",
    "RobotStatus",
    "Run",
    "Subscription",
    "Track",
    "Unreadable",
    "extract_features",
]
