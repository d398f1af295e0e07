"""How far joints turn: a normal distribution of each joint's rotation about its mean.

Where a joint hardly turns about an axis, or not at all, noise alone makes its bone seem to turn, and
every seeming turn would tell a little of where the centre is: wrongly, and the more frames the more
firmly (Neyman and Scott 1948). Poses are therefore held at each joint's own mean about axes about
which it turns by no more than noise makes of it, and not at all about those that it uses.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..body.pose import Pose
from ..body.skeleton import Skeleton, dof_layout

#: radians: no joint is held more firmly
STIFFEST = 1e-3
#: times the variance that noise gives a turn, from where on it stays free
MUCH = 2.0
#: the variance left to turns about all other axes, in that of noise
STIFF = 1e-3
#: how many times what is usual a frame's own variance may be, to count
CLEAR = 3.0


class Turning(NamedTuple):
    """Mean rotations and inverse covariances of turns about them, of T ball joints."""

    joints: np.ndarray
    means: Float[np.ndarray, "T 4"]
    precision: Float[np.ndarray, "T 3 3"]


class Drawn(NamedTuple):
    """What a `Turning` adds to the equations of each frame: to the cost, and to `A` and its side."""

    cost: float
    matrix: Float[np.ndarray, "F D D"]
    side: Float[np.ndarray, "F D"]


def free_turning(skeleton: Skeleton) -> Turning:
    """Any turn is as good as any other."""
    inner = [j for j, parent in enumerate(skeleton.parents) if parent >= 0 and skeleton.kinds[j] == "ball"]
    joints = np.array(inner, int)
    return Turning(joints, np.tile([1.0, 0, 0, 0], (len(joints), 1)), np.zeros((len(joints), 3, 3)))


def mean_turns(q: Float[np.ndarray, "F J 4"]) -> Float[np.ndarray, "F J 3"]:
    """Rotation vectors from each joint's mean rotation, in the bones' own frames, radians."""
    return _turns(mean_rotations(q), q)


def turning_of(skeleton: Skeleton, poses: Pose, covariances: Float[np.ndarray, "F D D"]) -> Turning:
    """The distribution by poses that were found without one, with their covariances: what they vary less
    what noise makes them vary. Axes about which a joint turns `MUCH` more than that stay free, as turns
    are not normal and those of several joints go together."""
    joints = free_turning(skeleton).joints
    slots = dof_layout(skeleton).rotations[joints]
    q = np.asarray(poses.rotations, float)[:, joints]
    means = mean_rotations(q)
    turns = _turns(means, q)
    each = covariances[:, slots[:, :, None], slots[:, None, :]]
    # frames that show a bone badly tell nothing of how far it turns
    doubt = np.trace(each, axis1=2, axis2=3)
    shown = (doubt <= CLEAR * np.median(doubt, 0)).astype(float)
    shown /= shown.sum(0)
    second = np.einsum("fj,fja,fjb->jab", shown, turns, turns)
    noise = np.einsum("fj,fjab->jab", shown, each)
    # measured in noise, so that directions are told apart by what they show
    root = np.linalg.cholesky(noise + STIFFEST**2 * np.eye(3))
    even = np.linalg.solve(root, np.swapaxes(np.linalg.solve(root, second), 1, 2))
    values, vectors = np.linalg.eigh(even)
    share = np.where(values > MUCH, 0.0, 1.0 / STIFF)
    back = np.linalg.solve(np.swapaxes(root, 1, 2), vectors)
    precision = (back * share[:, None]) @ np.swapaxes(back, 1, 2)
    return Turning(joints, means, (precision + np.swapaxes(precision, 1, 2)) / 2)


def drawn(skeleton: Skeleton, turning: Turning, poses: Pose) -> Drawn:
    """The squares of the turns about the means in standard deviations, with their derivatives."""
    count, dofs = len(poses.rotations), skeleton.num_dofs
    matrix, side = np.zeros((count, dofs, dofs)), np.zeros((count, dofs))
    if not turning.precision.any():
        return Drawn(0.0, matrix, side)
    slots = dof_layout(skeleton).rotations[turning.joints]
    turns = _turns(turning.means, np.asarray(poses.rotations, float)[:, turning.joints])
    slope = _inverse_right_jacobian(turns)
    pull = np.einsum("jab,fjb->fja", turning.precision, turns)
    blocks = np.einsum("fjba,jbc,fjcd->fjad", slope, turning.precision, slope)
    matrix[:, slots[:, :, None], slots[:, None, :]] = blocks
    side[:, slots] = -np.einsum("fjba,fjb->fja", slope, pull)
    return Drawn(float(np.sum(pull * turns)), matrix, side)


def mean_rotations(q: Float[np.ndarray, "F T 4"]) -> Float[np.ndarray, "T 4"]:
    """The quaternions nearest to all of each joint's, whatever their signs."""
    return np.linalg.eigh(np.einsum("fja,fjb->jab", q, q))[1][..., -1]


def _turns(means: Float[np.ndarray, "T 4"], q: Float[np.ndarray, "F T 4"]) -> Float[np.ndarray, "F T 3"]:
    """Rotation vectors from the means, in the bones' own frames."""
    w, v = means[:, :1], means[:, 1:]
    scalar = w * q[..., :1] + np.sum(v * q[..., 1:], -1, keepdims=True)
    vector = w * q[..., 1:] - q[..., :1] * v - np.cross(v, q[..., 1:])
    vector, scalar = np.where(scalar < 0, -vector, vector), np.abs(scalar)
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(length, scalar)
    return vector * np.where(length > 1e-9, angle / np.maximum(length, 1e-9), 2.0)


def _inverse_right_jacobian(turns: Float[np.ndarray, "F T 3"]) -> Float[np.ndarray, "F T 3 3"]:
    """The derivative of the rotation vector of `exp(t) exp(w)` by `w` at zero."""
    x, y, z = np.moveaxis(turns, -1, 0)
    none = np.zeros_like(x)
    cross = np.stack([none, -z, y, z, none, -x, -y, x, none], -1).reshape(*turns.shape, 3)
    angle = np.linalg.norm(turns, axis=-1)
    safe = np.maximum(angle, 1e-3)
    half = safe / 2.0
    share = np.where(angle > 1e-3, (1.0 - half / np.tan(half)) / safe**2, 1.0 / 12.0)
    return np.eye(3) + cross / 2.0 + share[..., None, None] * (cross @ cross)
