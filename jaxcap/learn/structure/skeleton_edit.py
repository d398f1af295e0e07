"""A joint more, a joint less: bodies and their poses with the tree changed, all else as it was."""

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
from ...body.skin.swing_twist import on_best_base, with_base
from ..skeleton.pose_from_parts import motion_moments, pose_moments
from ..skeleton.reparent import Bones, bone_motions, hang_children
from ..skeleton.tree import orient

#: how heavy the frame of a bone is beside its vertices, and how wide, as a share of the body's diagonal
FRAME_MASS, FRAME_WIDTH = 1e-2, 0.02


class Split(NamedTuple):
    """A bone more: the vertices that it moves, and how it moves itself."""

    #: the bone that most of them belonged to
    joint: int
    #: by how much the sum of squared distances falls, square metres
    gain: float
    #: the vertices that it moves, and the shares of all bones in them with the new one, which is the last
    vertices: Int[np.ndarray, "C"]
    shares: Float[np.ndarray, "C I"]
    #: motions in the world, of what is left of that bone and of the new one
    rotations: Float[np.ndarray, "F 2 3 3"]
    translations: Float[np.ndarray, "F 2 3"]
    #: joint, parent and centre of itself and of all that hangs elsewhere with it
    hung: tuple[tuple[int, int, Float[np.ndarray, "3"]], ...]


class Removal(NamedTuple):
    """One bone dissolved into those around it."""

    joint: int
    #: by how much the sum of squared distances rises, square metres
    cost: float
    #: the vertices that it moved, and the shares of all bones in them without it
    vertices: Int[np.ndarray, "C"]
    shares: Float[np.ndarray, "C J"]


class Graft(NamedTuple):
    """A body with another tree, its stacked poses, and the pairs of joints that the tree left whole."""

    body: Body
    poses: Pose
    pairs: Int[np.ndarray, "P 2"]


def with_joint(body: Body, poses: Pose, pairs: Int[np.ndarray, "P 2"], split: Split) -> Graft:
    """The body with a new "ball" joint, moved as the split says; all other bones move as they did,
    as nearly as the tree allows."""
    old = body.skeleton
    count = old.num_joints
    bones = bone_motions(old, poses)
    moved = Bones(
        np.concatenate([bones.rotations, split.rotations[:, 1:]], 1),
        np.concatenate([bones.translations, split.translations[:, 1:]], 1),
    )
    moved.rotations[:, split.joint], moved.translations[:, split.joint] = (
        split.rotations[:, 0],
        split.translations[:, 0],
    )
    parents = [*old.parents, -1]
    centres = np.concatenate([np.asarray(old.centres, float), np.zeros((1, 3))])
    for joint, parent, centre in split.hung:
        parents[joint], centres[joint] = parent, centre
    rest = np.asarray(body.vertices, float)
    ends = centres.copy()
    ends[count] = np.average(rest[split.vertices], axis=0, weights=split.shares[:, -1])
    orientations = np.concatenate([np.asarray(old.orientations, float), orient(parents, centres, ends)[-1:]])
    names = [*old.names, _new_name(old.names)]
    keep = list(range(count + 1))

    def insert(shares: np.ndarray) -> np.ndarray:
        return insert_share(shares, split)

    return _regrown(body, pairs, names, parents, centres, orientations, moved, keep, insert)


def insert_share(shares: Float[np.ndarray, "V J"], split: Split) -> Float[np.ndarray, "V I"]:
    """Shares with a last column for a new bone, and what the split makes of its vertices."""
    wide = np.pad(shares, ((0, 0), (0, 1)))
    wide[split.vertices] = split.shares
    return wide


def without_joint(body: Body, poses: Pose, pairs: Int[np.ndarray, "P 2"], removal: Removal) -> Graft:
    """The body without a joint that is no root: its children hang on its parent or on each other,
    where both bones have a point that they move most nearly alike; all bones that are left move
    as they did, as nearly as the tree allows."""
    old, joint = body.skeleton, removal.joint
    bones = bone_motions(old, poses)
    rest = np.asarray(body.vertices, float)
    parents, centres = list(old.parents), np.array(old.centres, float)
    for child, (parent, centre, _) in hang_children(old, bones, joint, rest).items():
        parents[child], centres[child] = parent, centre
    keep = [j for j in range(old.num_joints) if j != joint]

    def dissolve(shares: np.ndarray) -> np.ndarray:
        shares = shares.copy()
        shares[removal.vertices] = removal.shares
        # what little others have of the bone goes to its parent
        shares[:, old.parents[joint]] += shares[:, joint]
        return shares

    orientations = np.asarray(old.orientations, float)
    return _regrown(body, pairs, list(old.names), parents, centres, orientations, bones, keep, dissolve)


def _new_name(names: Sequence[str]) -> str:
    return next(f"joint{k}" for k in range(1, len(names) + 2) if f"joint{k}" not in names)


def _regrown(body: Body, pairs, names, parents, centres, orientations, bones: Bones, keep, change) -> Graft:
    """The body over the joints to `keep`, with the skin's shares as `change` makes them."""
    place = {j: k for k, j in enumerate(keep)}
    above = [-1 if parents[j] < 0 else place[parents[j]] for j in keep]
    kinds = [body.skeleton.kinds[j] if j < body.skeleton.num_joints else "ball" for j in keep]
    axes = np.concatenate([np.asarray(body.skeleton.axes, float), np.eye(3)[None, :2]])[keep]
    skeleton = make_skeleton([names[j] for j in keep], above, kinds, centres[keep], orientations[keep], axes)
    # make_skeleton may sort: which of the given joints each of its own was
    order = [names.index(name) for name in skeleton.names]
    dtype = body.vertices.dtype
    skeleton = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), skeleton)
    skin = _skin(body, skeleton, lambda shares: change(shares)[:, order])
    new = Body(skeleton, skin, body.vertices, body.faces)
    moved = Bones(bones.rotations[:, order], bones.translations[:, order])
    poses = _follow(skeleton, moved, np.asarray(body.vertices, float), np.asarray(skin.parts()))
    poses = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), poses)
    return Graft(new, poses, _carry_pairs(pairs, body.skeleton, parents, order))


def _carry_pairs(pairs, old: Skeleton, parents, order) -> Int[np.ndarray, "P 2"]:
    """Pairs by their new numbers, those left out of which a joint is gone or hangs elsewhere."""
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
            change(np.asarray(with_base(weights, skin.bases), float)) for weights in (skin.swing, skin.twist)
        )
        return on_best_base(swing, twist, skeleton, dtype)
    shares = change(np.asarray(skin.influence(body.skeleton.num_joints), float))
    if isinstance(skin, LinearSkin):
        return LinearSkin(jnp.asarray(shares, dtype))
    if isinstance(skin, RigidSkin):
        return RigidSkin(jnp.asarray(np.argmax(shares, 1), skin.bones.dtype))
    raise ValueError(f"The joints of a body with a {type(skin).__name__} cannot be exchanged.")


def _follow(skeleton: Skeleton, bones: Bones, rest: np.ndarray, labels: np.ndarray) -> Pose:
    """The poses in which the bones move most nearly as given. Bones without vertices count, too:
    by the frame at their centre."""
    centres = np.asarray(skeleton.centres, float)
    width = FRAME_WIDTH * float(np.linalg.norm(np.ptp(rest, axis=0)))
    frames = centres[:, None] + width * np.concatenate([np.eye(3), -np.eye(3)])
    points = np.concatenate([rest, frames.reshape(-1, 3)])
    owners = np.concatenate([labels, np.repeat(np.arange(len(centres)), 6)])
    weights = np.where(np.arange(len(points)) < len(rest), 1.0, FRAME_MASS)
    return pose_moments(
        skeleton, motion_moments(points, owners, weights, bones.rotations, bones.translations)
    )
