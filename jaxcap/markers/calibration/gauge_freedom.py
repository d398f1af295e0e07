"""What may change at rest and no frame ever tells: each bone turned about its own joint.

If a bone's points, its markers and its children's centres, are turned at rest and its rotation in
every frame is turned back, nothing is seen to change. The rest pose is thereby the template's choice,
and covariances are told after these changes are taken out.
"""

import numpy as np
from jaxtyping import Float

from ..subject import Subject


def gauge_directions(subject: Subject, joints: tuple[int, ...]) -> Float[np.ndarray, "S G"]:
    """The changes of `s` that no marker tells, whatever the motion.

    Bone j may turn by any `w_j` where joints are ball joints. A joint of another kind ties the turns
    of its two bones: a revolute one to its axis, a universal one to the first axis above and the
    second below, a fixed one to each other, as its axes stay where they are at rest.
    """
    skeleton = subject.skeleton
    turns = _allowed(subject).reshape(-1, skeleton.num_joints, 3)
    centres, offsets = np.asarray(skeleton.centres, float), np.asarray(subject.offsets, float)
    bones = np.asarray(subject.bones)
    shifts = np.zeros_like(turns)
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            arm = centres[joint] - centres[parent]
            shifts[:, joint] = shifts[:, parent] + np.cross(turns[:, parent], arm)
    moved = shifts[:, bones] + np.cross(turns[:, bones], offsets - centres[bones])
    if skeleton.kinds[0] in ("free", "translate"):
        shifts, moved = (np.concatenate([x, _along_axes(x.shape[1])]) for x in (shifts, moved))
    count = len(shifts)
    return np.concatenate([shifts[:, list(joints)].reshape(count, -1), moved.reshape(count, -1)], 1).T


def gauge_rows(subject: Subject, joints: tuple[int, ...]) -> Float[np.ndarray, "G S"]:
    """Rows that are zero of an `s` under which the markers of no bone have turned or moved on the
    whole; where a bone has too few, its ends stand in for them."""
    gauge = gauge_directions(subject, joints)
    weights = np.append(np.full(3 * len(joints), 1e-3), np.ones(3 * subject.num_markers))
    return gauge.T * weights


def _along_axes(count: int) -> Float[np.ndarray, "3 N 3"]:
    return np.broadcast_to(np.eye(3)[:, None], (3, count, 3))


def _allowed(subject: Subject) -> Float[np.ndarray, "N J3"]:
    """A basis of the turns `w (J, 3)` that all joints' kinds allow."""
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


def without_gauge(
    subject: Subject, joints: tuple[int, ...], covariance: Float[np.ndarray, "S S"]
) -> Float[np.ndarray, "S S"]:
    """The covariance in the frame of the markers: changes that cannot be told are taken out, so that
    the markers of every bone, by least squares, have not turned or moved (Baarda's S-transformation;
    centres count little, being what is asked for)."""
    gauge, rows = gauge_directions(subject, joints), gauge_rows(subject, joints)
    kept = np.eye(len(covariance)) - gauge @ np.linalg.pinv(rows @ gauge, 1e-9) @ rows
    return kept @ covariance @ kept.T
