"""SARA, the symmetrical axis of rotation approach (Ehrig, Taylor, Duda, Heller 2007)."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .estimator_parts import MAX_REWEIGHTINGS, geman_mcclure_weights

#: a joint is a hinge if the rotation off the axis is below this share of that about it, both root mean
#: square
MAX_WOBBLE_RATIO = 0.18
#: and below this, radians
MAX_WOBBLE = np.radians(7.0)
#: and the rotation about it is above this, root mean square, radians: less is possible at any joint
MIN_ROTATION = np.radians(8.0)


class Hinge(NamedTuple):
    """The common axis of rotation of two segments."""

    #: unit axis in both frames
    in_parent: Float[np.ndarray, "3"]
    in_child: Float[np.ndarray, "3"]
    #: root mean square angle between the axis in the two segments, radians
    wobble: float
    #: root mean square rotation about the axis from its mean, radians
    rotation_deviation: float
    #: range of the rotation about the axis, radians
    swept_angle: float
    #: the two least singular values of SCoRE's matrix per frame; the least is zero, rank 5, at a hinge
    singular_values: tuple[float, float]

    @property
    def is_hinge(self) -> bool:
        """True if all but a small share of the rotation is about the axis."""
        return bool(
            self.rotation_deviation > MIN_ROTATION
            and self.wobble < min(MAX_WOBBLE, MAX_WOBBLE_RATIO * self.rotation_deviation)
        )


def find_hinge(rotations: Float[np.ndarray, "F 3 3"], robust: bool = True) -> Hinge:
    """Find the axis that is fixed in both segments.

    It is the null direction of SCoRE's matrix. The rank of this matrix is 5 for a hinge, as the centre can
    be anywhere along the axis (Ehrig 2007, section 2).

    **Arguments:** `rotations` of the child's frame in the parent's.
    """
    weights = np.ones(len(rotations))
    parent = child = np.zeros(3)
    values = np.zeros(6)
    for _ in range(MAX_REWEIGHTINGS if robust else 1):
        mean = np.einsum("f,fab->ab", weights, rotations) / weights.sum()
        matrix = np.block([[np.eye(3), -mean], [-mean.T, np.eye(3)]])
        values, vectors = np.linalg.eigh(matrix)
        last = parent
        parent, child = vectors[:3, 0], vectors[3:, 0]
        parent, child = (v / max(np.linalg.norm(v), 1e-300) for v in (parent, child))
        # fix the sign: the largest coordinate is positive
        sign = np.sign(parent[np.argmax(np.abs(parent))]) or 1.0
        parent, child = sign * parent, sign * child
        if np.abs(parent - last).max() < 1e-12:
            break
        if robust:
            weights = geman_mcclure_weights(np.linalg.norm(rotations @ child - parent, axis=1))
    off = np.linalg.norm(rotations @ child - parent, axis=1)
    # a period with another axis is no outlier; the worst 5 % of the frames may be
    kept = np.sort(off)[: max(1, round(0.95 * len(off)))] if robust else off
    wobble = 2 * np.arcsin(np.clip(0.5 * np.sqrt(np.mean(kept**2)), 0, 1))
    angles = rotation_angles(rotations, parent)
    singular = np.sqrt(np.maximum(values[:2], 0.0))
    return Hinge(
        parent,
        child,
        float(wobble),
        float(np.std(angles)),
        _angle_range(angles),
        (float(singular[0]), float(singular[1])),
    )


def rotation_angles(
    rotations: Float[np.ndarray, "F 3 3"], axis: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "F"]:
    """Compute the angle about an axis of the parent relative to the first frame, radians, unwrapped."""
    turned = rotations @ rotations[:1].swapaxes(-1, -2)
    skew = np.stack(
        [
            turned[:, 2, 1] - turned[:, 1, 2],
            turned[:, 0, 2] - turned[:, 2, 0],
            turned[:, 1, 0] - turned[:, 0, 1],
        ],
        -1,
    )
    trace = np.trace(turned, axis1=1, axis2=2)
    # twist of the quaternion: atan2 of its vector part along the axis and its scalar part
    scalar = 1 + trace
    return np.unwrap(2 * np.arctan2(skew @ axis, scalar))


def _angle_range(angles: np.ndarray) -> float:
    low, high = np.quantile(angles, [0.01, 0.99])
    return float(min(high - low, 2 * np.pi))
