"""Candidate joints for removal, and the cost of each."""

import numpy as np
from jaxtyping import Array, Float

from ...body.body import Body
from ...body.pose import Pose
from ..skeleton.reparent import BoneMotions, bone_motions, reparent_children
from .blend_fit import blend_grams, fit_blends, neighbouring_bones
from .insert_and_remove import Removal

#: weight of a bone from which a vertex counts
TOUCHED = 0.02


def find_removals(body: Body, poses: Pose, targets: Float[Array, "F V 3"]) -> list[Removal]:
    """Evaluate the removal of each joint but the root, the cheapest first.

    A vertex that the bone moved is blended linearly from the bones around instead, by least squares over the
    simplex. The cost is the increase of the residual against the same blend with the bone. If the new joints
    of its children have gaps, these add to the cost by the number of vertices of the children.
    """
    skeleton = body.skeleton
    influence = np.asarray(body.skin.bone_weights(skeleton.num_joints), float)
    rest, goals = np.asarray(body.vertices, float), np.asarray(targets, float)
    bones = bone_motions(skeleton, poses)
    joints = [joint for joint, parent in enumerate(skeleton.parents) if parent >= 0]
    near = neighbouring_bones(body)
    around = [near[joint] for joint in joints]
    chosen = [np.flatnonzero(influence[:, joint] > TOUCHED) for joint in joints]
    width = max((len(row) for row in around), default=0) + 1
    grams = np.concatenate(
        [np.zeros((0, width, width))]
        + [
            blend_grams(bones, [joint, *others], rest[vertices], goals[:, vertices], width)
            for joint, others, vertices in zip(joints, around, chosen, strict=True)
        ]
    )
    if len(grams) == 0:
        return []
    owner = np.repeat(np.arange(len(joints)), [len(vertices) for vertices in chosen])
    real = np.arange(width) <= np.array([len(row) for row in around])[owner, None]
    whole, _ = fit_blends(grams, real)
    real[:, 0] = False
    lost, weights = fit_blends(grams, real)
    rise = np.bincount(owner, np.maximum(lost - whole, 0.0), len(joints))
    return sorted(
        (
            _removal(body, bones, rest, joint, others, vertices, weights[owner == row], float(rise[row]))
            for row, (joint, others, vertices) in enumerate(zip(joints, around, chosen, strict=True))
        ),
        key=lambda removal: removal.cost,
    )


def _removal(body: Body, bones: BoneMotions, rest, joint, others, vertices, weights, rise: float) -> Removal:
    skeleton = body.skeleton
    shares = np.zeros((len(vertices), skeleton.num_joints))
    shares[:, others] = weights[:, 1 : 1 + len(others)]
    hung = reparent_children(skeleton, bones, joint, rest)
    counts = np.bincount(np.asarray(body.skin.dominant_bones()), minlength=skeleton.num_joints)
    frames = len(bones.rotations)
    gaps = sum(frames * float(counts[child]) * gap**2 for child, (_, _, gap) in hung.items())
    return Removal(joint, rise + gaps, vertices, shares)
