"""Skinning: deformation of a surface by its bones."""

from .corrected import CorrectedSkin as CorrectedSkin
from .dual_quaternion import DualQuaternionSkin as DualQuaternionSkin
from .linear import LinearSkin as LinearSkin
from .pose_features import AbstractPoseFeatures as AbstractPoseFeatures
from .pose_features import QuaternionFeatures as QuaternionFeatures
from .pose_features import RotationMatrixFeatures as RotationMatrixFeatures
from .rigid import RigidSkin as RigidSkin
from .skin import AbstractSkin as AbstractSkin
from .stretched import StretchedSkin as StretchedSkin
from .swing_twist import SwingTwistSkin as SwingTwistSkin
from .swing_twist import swing_twist_from as swing_twist_from
