"""Gauge freedom of the rest pose: rotations of each bone about its own joint that no frame determines.

If a bone's points, its markers and its children's centres, are rotated at rest, and its rotation in every
frame is rotated back, the observations do not change. So the rest pose is the template's choice, and
covariances are reported without these changes.
"""

import numpy as np
from jaxtyping import Float

from ...geometry.linear import pseudo_inverse
from ..subject import Subject


def gauge_directions(subject: Subject, joints: tuple[int, ...]) -> Float[np.ndarray, "S G"]:
    """Compute the changes of `s` that no marker determines for any motion.

    Bone j may rotate by any `w_j` if all joints are ball joints. A joint of another kind couples the
    rotations of its two bones: a revolute one to its axis, a universal one to the first axis above and the
    second below, a fixed one to each other, as the axes are fixed at rest.
    """
    skeleton = subject.skeleton
    turns = _allowed_rotations(subject).reshape(-1, skeleton.num_joints, 3)
    centres, offsets = np.asarray(skeleton.centres, float), np.asarray(subject.offsets, float)
    bones = np.asarray(subject.bones)
    shifts = np.zeros_like(turns)
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            arm = centres[joint] - centres[parent]
            shifts[:, joint] = shifts[:, parent] + np.cross(turns[:, parent], arm)
    moved = shifts[:, bones] + np.cross(turns[:, bones], offsets - centres[bones])
    if skeleton.kinds[0] in ("free", "translate"):
        shifts, moved = (np.concatenate([x, _unit_translations(x.shape[1])]) for x in (shifts, moved))
    count = len(shifts)
    return np.concatenate([shifts[:, list(joints)].reshape(count, -1), moved.reshape(count, -1)], 1).T


def gauge_constraints(subject: Subject, joints: tuple[int, ...]) -> Float[np.ndarray, "G S"]:
    """Compute rows that vanish for an `s` without rotation or translation of any bone's markers on the whole.

    Where a bone has too few markers, its ends replace them.
    """
    gauge = gauge_directions(subject, joints)
    weights = np.append(np.full(3 * len(joints), 1e-3), np.ones(3 * subject.num_markers))
    return gauge.T * weights


def _unit_translations(count: int) -> Float[np.ndarray, "3 N 3"]:
    return np.broadcast_to(np.eye(3)[:, None], (3, count, 3))


def _allowed_rotations(subject: Subject) -> Float[np.ndarray, "N J3"]:
    """Compute a basis of the rotations `w (J, 3)` that the kinds of all joints allow."""
    skeleton, count = subject.skeleton, subject.skeleton.num_joints
    axes = np.asarray(skeleton.axes, float)
    rows: list[np.ndarray] = []

    def tie(*terms: tuple[int, np.ndarray]) -> None:
        block = np.zeros((3, count, 3))
        for joint, matrix in terms:
            if joint >= 0:
                block[:, joint] += matrix
        rows.append(block.reshape(3, -1))

    one = np.eye(3)
    for joint, (parent, kind) in enumerate(zip(skeleton.parents, skeleton.kinds, strict=True)):
        if kind in ("fixed", "translate"):
            tie((joint, one), (parent, -one))
        elif kind in ("revolute", "universal"):
            below = axes[joint, 1 if kind == "universal" else 0]
            tie((joint, one - np.outer(below, below)))
            tie((parent, one - np.outer(axes[joint, 0], axes[joint, 0])))
    if not rows:
        return np.eye(3 * count)
    _, values, basis = np.linalg.svd(np.vstack(rows))
    rank = int((values > 1e-9).sum())
    return basis[rank:]


def remove_gauge(
    subject: Subject, joints: tuple[int, ...], covariance: Float[np.ndarray, "S S"]
) -> Float[np.ndarray, "S S"]:
    """Remove the undetermined changes from a covariance of `s` (Baarda's S-transformation).

    The result is in the frame of the markers: by least squares the markers of every bone do not rotate or
    translate. Centres have small weights, as their covariance is the result.
    """
    gauge, rows = gauge_directions(subject, joints), gauge_constraints(subject, joints)
    kept = np.eye(len(covariance)) - gauge @ pseudo_inverse(rows @ gauge, 1e-9) @ rows
    return kept @ covariance @ kept.T
