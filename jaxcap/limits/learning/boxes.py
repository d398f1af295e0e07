"""Angle ranges and boxes around samples: the usual limits, without coupling."""

from collections.abc import Iterable

import jax
import jax.numpy as jnp
import numpy as np

from ...arguments import checked
from ...body.skeleton import Skeleton
from ...geometry import rotation
from ..euler_boxes import EulerBox, EulerBoxes, make_euler_boxes, nearest_euler_angles
from ..ranges_and_cones import JointRanges, make_joint_ranges
from .samples import JointSamples


@checked
def learn_boxes(skeleton: Skeleton, samples: Iterable[JointSamples]) -> tuple[JointRanges, EulerBoxes]:
    """Compute the minimum and maximum of every angle.

    The result has ranges of joints with one angle or two, and boxes of Euler angles about the own axes of
    each other joint, the twist first.

    **Raises:** `ValueError` where the skeleton lacks a joint.
    """
    ranges, boxes = {}, {}
    for one in samples:
        if one.kind == "ball":
            frame = skeleton.orientations[skeleton.index(one.joint)]
            boxes[one.joint] = _box(one, np.asarray(rotation.to_matrix(frame), float))
        else:
            angles = _angles(skeleton, one)
            ranges[one.joint] = np.stack([angles.min(0), angles.max(0)], -1).tolist()
    return make_joint_ranges(skeleton, ranges), make_euler_boxes(skeleton, boxes)


def _box(samples: JointSamples, frame: np.ndarray) -> EulerBox:
    everywhere = jnp.full((1, 3), np.pi)
    frames = jnp.tile(rotation.from_matrix(jnp.asarray(frame)), (len(samples.rotations), 1))
    angles = np.asarray(
        nearest_euler_angles(jnp.asarray(samples.rotations), frames, -everywhere, everywhere), float
    )
    # each angle relative to its circular mean, so that a range may cross half a turn
    mean = np.angle(np.exp(1j * angles).mean(0))
    angles = mean + (angles - mean + np.pi) % (2 * np.pi) - np.pi
    return EulerBox(angles.min(0), angles.max(0), frame)


def _angles(skeleton: Skeleton, samples: JointSamples) -> np.ndarray:
    first, second = skeleton.axes[skeleton.index(samples.joint)]
    turned = jnp.asarray(samples.rotations)
    if samples.kind == "revolute":
        return np.asarray(jax.vmap(rotation.angle_about, (0, None))(turned, first))[:, None]
    return np.asarray(jax.vmap(rotation.angles_about, (0, None, None))(turned, first, second))
