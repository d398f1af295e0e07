"""Insertion and removal of a joint in a body and its poses; all else stays the same."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ...body.body import Body
from ...body.pose import Pose
from ...body.skeleton import Skeleton, make_skeleton
from ...body.skin import AbstractSkin, LinearSkin, RigidSkin, SwingTwistSkin
from ...body.skin.swing_twist import add_base_weight, assign_bases
from ...geometry.mesh import box_diagonal
from ..skeleton.joint_tree import orient
from ..skeleton.pose_from_parts import fit_poses, motion_moments
from ..skeleton.reparent import BoneMotions, bone_motions, reparent_children

#: mass of a bone's frame relative to a vertex, and its width as a share of the body's diagonal
FRAME_MASS, FRAME_WIDTH = 1e-2, 0.02


class Split(NamedTuple):
    """A new bone: its vertices and its motion."""

    #: the bone that most of the vertices belonged to
    joint: int
    #: decrease of the sum of squared distances, square metres
    gain: float
    #: the vertices of the new bone, and their weights of all bones, the new one last
    vertices: Int[np.ndarray, "C"]
    weights: Float[np.ndarray, "C I"]
    #: world motions of the rest of that bone and of the new one
    rotations: Float[np.ndarray, "F 2 3 3"]
    translations: Float[np.ndarray, "F 2 3"]
    #: joint, parent and centre of the new bone and of all joints with a new parent
    reparented: tuple[tuple[int, int, Float[np.ndarray, "3"]], ...]


class Removal(NamedTuple):
    """A bone whose vertices go to the bones around it."""

    joint: int
    #: increase of the sum of squared distances, square metres
    cost: float
    #: the vertices of the bone, and their weights of all bones without it
    vertices: Int[np.ndarray, "C"]
    weights: Float[np.ndarray, "C J"]


class EditedBody(NamedTuple):
    """A body with another tree, its stacked poses, and the pairs of joints that are still valid."""

    body: Body
    poses: Pose
    left_right_pairs: Int[np.ndarray, "P 2"]


def insert_joint(body: Body, poses: Pose, pairs: Int[np.ndarray, "P 2"], split: Split) -> EditedBody:
    """Insert a "ball" joint with the motion of a split; all other bones keep their motion as far as the tree
    allows."""
    old = body.skeleton
    count = old.num_joints
    moved = split_motions(bone_motions(old, poses), split)
    parents = [*old.parents, -1]
    centres = np.concatenate([np.asarray(old.centres, float), np.zeros((1, 3))])
    for joint, parent, centre in split.reparented:
        parents[joint], centres[joint] = parent, centre
    rest = np.asarray(body.vertices, float)
    ends = centres.copy()
    ends[count] = np.average(rest[split.vertices], axis=0, weights=split.weights[:, -1])
    orientations = np.concatenate([np.asarray(old.orientations, float), orient(parents, centres, ends)[-1:]])
    names = [*old.names, _new_name(old.names)]
    keep = list(range(count + 1))

    def insert(shares: np.ndarray) -> np.ndarray:
        return insert_weights(shares, split)

    return _rebuild_body(body, pairs, names, parents, centres, orientations, moved, keep, insert)


def split_motions(bones: BoneMotions, split: Split) -> BoneMotions:
    """Return the motions of all bones after a split, those of the new bone last."""
    moved = BoneMotions(
        np.concatenate([bones.rotations, split.rotations[:, 1:]], 1),
        np.concatenate([bones.translations, split.translations[:, 1:]], 1),
    )
    moved.rotations[:, split.joint], moved.translations[:, split.joint] = (
        split.rotations[:, 0],
        split.translations[:, 0],
    )
    return moved


def insert_weights(weights: Float[np.ndarray, "V J"], split: Split) -> Float[np.ndarray, "V I"]:
    """Append a column of weights for a new bone, and set the weights of the vertices of the split."""
    wide = np.pad(weights, ((0, 0), (0, 1)))
    wide[split.vertices] = split.weights
    return wide


def remove_joint(body: Body, poses: Pose, pairs: Int[np.ndarray, "P 2"], removal: Removal) -> EditedBody:
    """Remove a joint that is no root; all other bones keep their motion as far as the tree allows.

    Its children are joined to its parent or to each other, at the point that both bones move most nearly
    alike.
    """
    old, joint = body.skeleton, removal.joint
    bones = bone_motions(old, poses)
    rest = np.asarray(body.vertices, float)
    parents, centres = list(old.parents), np.array(old.centres, float)
    for child, (parent, centre, _) in reparent_children(old, bones, joint, rest).items():
        parents[child], centres[child] = parent, centre
    keep = [j for j in range(old.num_joints) if j != joint]

    def dissolve(shares: np.ndarray) -> np.ndarray:
        shares = shares.copy()
        shares[removal.vertices] = removal.weights
        # small weights of other vertices go to the parent
        shares[:, old.parents[joint]] += shares[:, joint]
        return shares

    orientations = np.asarray(old.orientations, float)
    return _rebuild_body(body, pairs, list(old.names), parents, centres, orientations, bones, keep, dissolve)


def _new_name(names: Sequence[str]) -> str:
    return next(f"joint{k}" for k in range(1, len(names) + 2) if f"joint{k}" not in names)


def _rebuild_body(
    body: Body, pairs, names, parents, centres, orientations, bones: BoneMotions, keep, change
) -> EditedBody:
    """Rebuild the body with the joints `keep` and with weights modified by `change`."""
    place = {j: k for k, j in enumerate(keep)}
    above = [-1 if parents[j] < 0 else place[parents[j]] for j in keep]
    kinds = [body.skeleton.kinds[j] if j < body.skeleton.num_joints else "ball" for j in keep]
    axes = np.concatenate([np.asarray(body.skeleton.axes, float), np.eye(3)[None, :2]])[keep]
    skeleton = make_skeleton([names[j] for j in keep], above, kinds, centres[keep], orientations[keep], axes)
    # make_skeleton may sort: map its joints to the given ones
    order = [names.index(name) for name in skeleton.names]
    dtype = body.vertices.dtype
    skeleton = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), skeleton)
    skin = _skin(body, skeleton, lambda shares: change(shares)[:, order])
    new = Body(skeleton, skin, body.vertices, body.faces)
    moved = BoneMotions(bones.rotations[:, order], bones.translations[:, order])
    poses = fit_edited_poses(
        skeleton, moved, np.asarray(body.vertices, float), np.asarray(skin.dominant_bones())
    )
    poses = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), poses)
    return EditedBody(new, poses, _renumber_pairs(pairs, body.skeleton, parents, order))


def _renumber_pairs(pairs, old: Skeleton, parents, order) -> Int[np.ndarray, "P 2"]:
    """Renumber pairs, without those where a joint is removed or has a new parent."""
    whole = [
        (order.index(left), order.index(right))
        for left, right in np.asarray(pairs, int).reshape(-1, 2).tolist()
        if all(j in order and parents[j] == old.parents[j] for j in (left, right))
    ]
    return np.sort(np.array(whole, int).reshape(-1, 2), axis=1)


def _skin(body: Body, skeleton: Skeleton, change) -> AbstractSkin:
    skin, dtype = body.skin, body.vertices.dtype
    if isinstance(skin, SwingTwistSkin):
        swing, twist = (
            change(np.asarray(add_base_weight(weights, skin.bases), float))
            for weights in (skin.swing, skin.twist)
        )
        return assign_bases(swing, twist, skeleton, dtype)
    shares = change(np.asarray(skin.bone_weights(body.skeleton.num_joints), float))
    if isinstance(skin, LinearSkin):
        return LinearSkin(jnp.asarray(shares, dtype))
    if isinstance(skin, RigidSkin):
        return RigidSkin(jnp.asarray(np.argmax(shares, 1), skin.bones.dtype))
    raise ValueError(
        f"The body has a {type(skin).__name__}; expected a SwingTwistSkin, LinearSkin or RigidSkin."
    )


def fit_edited_poses(
    skeleton: Skeleton,
    bones: BoneMotions,
    rest: Float[np.ndarray, "V 3"],
    labels: Int[np.ndarray, "V"],
) -> Pose:
    """Fit poses to given bone motions; bones without vertices count by the frame at their centre."""
    centres = np.asarray(skeleton.centres, float)
    width = FRAME_WIDTH * box_diagonal(rest)
    frames = centres[:, None] + width * np.concatenate([np.eye(3), -np.eye(3)])
    points = np.concatenate([rest, frames.reshape(-1, 3)])
    owners = np.concatenate([labels, np.repeat(np.arange(len(centres)), 6)])
    weights = np.where(np.arange(len(points)) < len(rest), 1.0, FRAME_MASS)
    return fit_poses(skeleton, motion_moments(points, owners, weights, bones.rotations, bones.translations))
