"""Nonlinear skinning by linear blending, for programs and files that know no other.

After Kavan, Collins and O'Sullivan, "Automatic linearization of nonlinear skinning" (I3D 2009):
virtual bones where the residual is largest, and weights by least squares over example poses. There
the virtual bones' motions are fitted too, frame by frame; here each is carried by the nonlinear
skin itself, with the weights of the vertex that was furthest off. It is then exact at that vertex
in every pose, and what is left is how smoothly the surface goes from one such vertex to the next.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..body.body import Body, pose_body
from ..body.kinematics import forward_kinematics
from ..body.pose import Motion, Pose
from ..body.skeleton import Skeleton
from ..body.skin import AbstractSkin, DualQuaternionSkin, LinearSkin, RigidSkin, SwingTwistSkin
from .influences import limit_influences
from .linear_weights import fit_linear_weights
from .virtual_bones import (
    VirtualBones,
    bone_frames,
    extended_pose,
    extended_skeleton,
    make_virtual_bones,
)
from .weight_rows import (
    Needs,
    Rows,
    choose_candidates,
    join_rows,
    missing_rows,
    no_rows,
    skin_of,
    take_rows,
    vertex_needs,
)

#: poses that weights are fitted to at first, and how many are added where they do not do for the rest
_POSES, _MORE = 32, 8
#: vertices that get bones of their own between two fits, and the difference of blends between them
_AT_ONCE, _APART = 16, 0.4
#: virtual bones that a vertex may choose from, and how many are compiled for at once
_CHOICE, _CHUNK = 10, 32


class Linearised(eqx.Module):
    """A body with linear blend skinning that follows one with another skin.

    The skeleton of `body` is the source's with the virtual bones behind; `linear_pose` and
    `linear_motion` give it the source's poses.
    """

    body: Body
    source: Skeleton
    #: None where the source blends linearly
    bones: VirtualBones | None
    #: largest and mean distance of vertices from the source's over all given poses, metres
    error: float = eqx.field(static=True)
    mean_error: float = eqx.field(static=True)


def linearise(
    body: Body, poses: Pose, tolerance: float = 1e-3, *, influences: int = 4, most: int = 256
) -> Linearised:
    """A body with a `LinearSkin` on a longer skeleton that stays within `tolerance` of `body`.

    Virtual bones are added where vertices are furthest off until no vertex is further than
    `tolerance` from where `body` has it in any of the `poses`, or until there are `most` of them;
    `error` tells what was reached. Bodies that blend linearly already need none; where one of
    their vertices follows more than `influences` bones, the strongest are kept, and `error` tells
    what that costs.

    **Arguments:** `poses` are stacked, `(F, J, ...)`: a motion's, or `sample_poses`; `tolerance` is
    in metres; `influences` is the largest number of bones that move one vertex.

    **Raises:** `ValueError` where there are no poses, they are of another skeleton, or a number is
    not positive.
    """
    _check(body, poses, tolerance, influences, most)
    if isinstance(body.skin, (LinearSkin, RigidSkin)):
        weights = body.skin.influence(body.skeleton.num_joints).astype(body.vertices.dtype)
        linear = eqx.tree_at(lambda b: b.skin, body, LinearSkin(weights))
        return _measured(body, limit_influences(linear, influences), None, poses)[0]
    if not isinstance(body.skin, (SwingTwistSkin, DualQuaternionSkin)):
        raise ValueError(f"A body with a {type(body.skin).__name__} cannot be linearised.")
    count = poses.rotations.shape[0]
    chosen = np.unique(np.linspace(0, count - 1, min(count, _POSES)).round().astype(int))
    needs, rows = vertex_needs(body.skin), no_rows(body.skeleton.num_joints)
    while True:
        rows, linear, bones = _follow(body, needs, rows, _take(poses, chosen), tolerance, influences, most)
        found, errors = _measured(body, linear, bones, poses)
        # the poses that these bones and weights do worst, where they do not do
        worst = np.argsort(-errors)[:_MORE]
        worst = worst[(errors[worst] > tolerance) & ~np.isin(worst, chosen)]
        if not len(worst):
            return found
        chosen = np.union1d(chosen, worst)


def linear_pose(linearised: Linearised, pose: Pose) -> Pose:
    """A pose of the source as a pose of the linearised body."""
    if linearised.bones is None:
        return pose
    return extended_pose(linearised.source, linearised.bones, pose)


@eqx.filter_jit
def _all_poses(linearised: Linearised, poses: Pose) -> Pose:
    return jax.lax.map(lambda pose: linear_pose(linearised, pose), poses)


def linear_motion(linearised: Linearised, motion: Motion) -> Motion:
    """A motion of the source as a motion of the linearised body.

    **Raises:** `ValueError` where the motion has other joints.
    """
    joints = motion.poses.rotations.shape[1]
    if joints != linearised.source.num_joints:
        raise ValueError(
            f"The motion moves {joints} joints and the source body has {linearised.source.num_joints}."
        )
    return Motion(_all_poses(linearised, motion.poses), motion.rate)


def _check(body: Body, poses: Pose, tolerance: float, influences: int, most: int) -> None:
    if poses.rotations.ndim != 3 or poses.rotations.shape[0] == 0:
        raise ValueError("Linearising needs poses stacked over frames, and one at least; none was given.")
    joints = poses.rotations.shape[1]
    if joints != body.skeleton.num_joints:
        raise ValueError(f"The poses are of {joints} joints and the body has {body.skeleton.num_joints}.")
    for name, value in (("tolerance", tolerance), ("number of influences", influences), ("most", most)):
        if not value > 0:
            raise ValueError(f"The {name} of a linearised body is {value}; give a positive number.")


def _follow(
    body: Body, needs: Needs, rows: Rows, poses: Pose, tolerance: float, influences: int, most: int
) -> tuple[Rows, Body, VirtualBones | None]:
    """More rows, until the poses are followed: with them the linear body and its virtual bones."""
    joints = body.skeleton.num_joints
    own, targets = (np.asarray(a, float) for a in _targets(body, poses))
    frames = np.concatenate([own, _frames(body, rows, poses)], 1)
    vertices = np.asarray(body.vertices, float)
    candidates = choose_candidates(needs, rows, _CHOICE)
    weights, errors = fit_linear_weights(vertices, targets, frames, candidates, influences)
    while len(rows.bases) < most:
        new = _worst_rows(needs, rows, errors, tolerance, most)
        if not len(new.bases):
            break
        rows = join_rows(rows, new)
        frames = np.concatenate([frames, _frames(body, new, poses)], 1)
        before, candidates = candidates, choose_candidates(needs, rows, _CHOICE)
        gap = candidates.shape[1] - before.shape[1]
        before = np.pad(before, ((0, 0), (0, gap)), constant_values=-1)
        weights = np.pad(weights, ((0, 0), (0, gap)))
        # what is well where it is stays there
        again = (np.sort(before, 1) != np.sort(candidates, 1)).any(1) & (errors > tolerance / 2)
        candidates[~again] = before[~again]
        weights[again], errors[again] = fit_linear_weights(
            vertices[again], targets[:, again], frames, candidates[again], influences
        )
    dense = np.zeros((len(vertices), joints + len(rows.bases)))
    vertex, place = np.nonzero(weights)
    dense[vertex, candidates[vertex, place]] = weights[vertex, place]
    return (rows, *_assemble(body, rows, dense))


def _worst_rows(needs: Needs, rows: Rows, errors: np.ndarray, tolerance: float, most: int) -> Rows:
    """Rows for the vertices that are furthest off, at places that lie apart."""
    new = no_rows(needs.blends.shape[1])
    done: list[int] = []
    for vertex in np.argsort(-errors):
        if errors[vertex] <= tolerance or len(done) == _AT_ONCE:
            break
        near = needs.bases[done] == needs.bases[vertex]
        near &= np.abs(needs.blends[done] - needs.blends[vertex]).sum(1) < _APART
        if near.any():
            continue
        found = missing_rows(needs, int(vertex), join_rows(rows, new))
        if len(found.bases) and len(rows.bases) + len(new.bases) + len(found.bases) <= most:
            new = join_rows(new, found)
            done.append(int(vertex))
    return new


def _assemble(body: Body, rows: Rows, weights: np.ndarray) -> tuple[Body, VirtualBones | None]:
    """The linear body on the skeleton's own and those virtual bones that move anything."""
    joints = body.skeleton.num_joints
    used = np.flatnonzero(weights[:, joints:].any(0))
    kept = jnp.asarray(np.delete(weights, joints + np.setdiff1d(np.arange(len(rows.bases)), used), 1))
    skin = LinearSkin(kept.astype(body.vertices.dtype))
    if not len(used):
        return Body(body.skeleton, skin, body.vertices, body.faces), None
    bones = make_virtual_bones(skin_of(body.skin, take_rows(rows, used)), body.skeleton)
    return Body(extended_skeleton(body.skeleton, bones), skin, body.vertices, body.faces), bones


def _frames(body: Body, rows: Rows, poses: Pose) -> np.ndarray:
    """(F, S, 3, 4) frames of rows, in chunks of one size so that one program does for all."""
    parts = [np.zeros((poses.rotations.shape[0], 0, 3, 4))]
    for start in range(0, len(rows.bases), _CHUNK):
        part = np.arange(start, min(start + _CHUNK, len(rows.bases)))
        padded = np.pad(part, (0, _CHUNK - len(part)), mode="edge")
        bones = make_virtual_bones(skin_of(body.skin, take_rows(rows, padded)), body.skeleton)
        parts.append(np.asarray(_bone_frames(body.skeleton, bones.skin, poses), float)[:, : len(part)])
    return np.concatenate(parts, 1)


def _take(poses: Pose, chosen: np.ndarray) -> Pose:
    return jax.tree.map(lambda values: values[chosen], poses)


@eqx.filter_jit
def _bone_frames(skeleton: Skeleton, skin: AbstractSkin, poses: Pose) -> Float[Array, "F S 3 4"]:
    return jax.lax.map(lambda pose: bone_frames(skeleton, skin, pose), poses)


@eqx.filter_jit
def _targets(body: Body, poses: Pose) -> tuple[Float[Array, "F J 3 4"], Float[Array, "F V 3"]]:
    def one(pose):
        moved = forward_kinematics(body.skeleton, pose)
        frames = jnp.concatenate([moved.rotations, moved.translations[:, :, None]], 2)
        return frames, pose_body(body, pose).vertices

    return jax.lax.map(one, poses)


@eqx.filter_jit
def _distances(
    body: Body, linearised: Linearised, poses: Pose
) -> tuple[Float[Array, "F"], Float[Array, "F"]]:
    def one(pose):
        here = pose_body(linearised.body, linear_pose(linearised, pose)).vertices
        apart = jnp.linalg.norm(here - pose_body(body, pose).vertices, axis=1)
        return jnp.max(apart), jnp.mean(apart)

    return jax.lax.map(one, poses)


def _measured(
    body: Body, linear: Body, bones: VirtualBones | None, poses: Pose
) -> tuple[Linearised, np.ndarray]:
    """The linearised body with its errors, and the largest one of each pose."""
    largest, mean = (
        np.asarray(a, float)
        for a in _distances(body, Linearised(linear, body.skeleton, bones, 0.0, 0.0), poses)
    )
    found = Linearised(linear, body.skeleton, bones, float(largest.max()), float(mean.mean()))
    return found, largest
