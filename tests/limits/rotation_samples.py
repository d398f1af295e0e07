"""Samples of the rotations of one joint, for tests of joint limits."""

import numpy as np
from scipy.spatial.transform import Rotation

from jaxcap.limits.learning.samples import JointSamples


def quaternions(rotations: Rotation) -> np.ndarray:
    return rotations.as_quat(scalar_first=True, canonical=True)


def samples_of(rotations: Rotation, kind: str = "ball") -> JointSamples:
    turned = quaternions(rotations)
    return JointSamples("joint", kind, np.eye(3)[:2], turned, np.zeros(len(turned), int))
