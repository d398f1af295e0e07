"""Approximate nonlinear skinning by linear blend skinning, for programs and files that support no other.

After Kavan, Collins and O'Sullivan, "Automatic linearization of nonlinear skinning" (I3D 2009): virtual bones
are added at the largest residual, and weights are fitted by least squares over example poses. The paper also
fits the virtual bones' motions, frame by frame. Here the nonlinear skin itself moves each bone, with the
weights of the vertex of largest error. The result is exact at that vertex in every pose; the remaining error
is that of interpolation between such vertices.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...arguments import checked
from ...body.body import Body, pose_body
from ...body.influences import strongest_bones
from ...body.morph_targets import MorphTargets
from ...body.pose import Motion, Pose, take_poses
from ...body.skeleton import Skeleton
from ...body.skin import CorrectedSkin, DualQuaternionSkin, LinearSkin, RigidSkin, SwingTwistSkin
from ...body.skin.corrected import corrective_units
from ...geometry.sampling import even_indices
from .correctives import reduce_correctives, unit_names
from .examples import pose_blocks, skeleton_frames, virtual_frames
from .virtual_bones import VirtualBones, extended_pose, extended_skeleton, make_virtual_bones
from .weight_rows import (
    BlendTerms,
    WeightRows,
    blend_terms,
    choose_candidates,
    empty_rows,
    join_rows,
    missing_rows,
    skin_of_rows,
    take_rows,
)
from .weights import blend_errors, fit_linear_weights

#: poses of the first fit, and number of poses that are added if their error is too large
_NUM_POSES, _NUM_ADDED_POSES = 32, 8
#: vertices that get their own bones between two fits, and the least difference of their blends
_MAX_NEW_VERTICES, _MIN_BLEND_DISTANCE = 16, 0.4
#: candidate virtual bones of a vertex
_NUM_CANDIDATES = 10


class LinearBlendBody(eqx.Module):
    """A body with linear blend skinning that approximates one with another skin.

    The skeleton of `body` is the source's with the virtual bones appended; `linear_pose` and `linear_motion`
    convert the source's poses to it.
    """

    body: Body
    source: Skeleton
    #: None if the source blends linearly
    bones: VirtualBones | None
    #: largest and mean distance of vertices from the source's over all given poses, metres
    error: float = eqx.field(static=True)
    mean_error: float = eqx.field(static=True)
    #: the source's displacements by the pose, which move the vertices of `body` before its skin; None if there are none
    correctives: CorrectedSkin | None = None


@checked
def to_linear_blend(
    body: Body,
    poses: Pose,
    tolerance: float = 1e-3,
    *,
    max_influences: int = 4,
    max_virtual_bones: int = 256,
    correctives: bool = False,
) -> LinearBlendBody:
    """Approximate `body` within `tolerance` by a body with a `LinearSkin` on an extended skeleton.

    Virtual bones are added at the vertices of largest error until no vertex is further than `tolerance` from
    its position in `body` in any of the `poses`, or until there are `max_virtual_bones` of them; `error` is the error that
    was reached. Bodies that blend linearly already need none. If one of their vertices follows more than
    `max_influences` bones, the strongest are kept. If this moves it by more than half of `tolerance`, the bones
    that fit it best are chosen with new weights; `error` is the resulting error. The displacements of a `CorrectedSkin` are
    left out, and `error` includes them, unless they are kept as `correctives`.

    **Arguments:** `poses` are stacked, `(F, J, ...)`: a motion's, or `sample_poses`; `tolerance` is in
    metres; `max_influences` is the largest number of bones per vertex; `correctives` keeps the displacements of a
    `CorrectedSkin` that matter in the poses, for programs with morph targets (`linear_targets`).

    **Raises:** `ValueError` if there are no poses, they are of another skeleton, or a number is not positive.
    """
    _check(body, poses, tolerance, max_influences, max_virtual_bones)
    if isinstance(body.skin, CorrectedSkin):
        plain = eqx.tree_at(lambda b: b.skin, body, body.skin.skin)
        found = to_linear_blend(
            plain, poses, tolerance, max_influences=max_influences, max_virtual_bones=max_virtual_bones
        )
        kept = reduce_correctives(body.skin, poses, tolerance) if correctives else None
        errors = np.array(_surface_distances(body, found, kept, poses))
        return LinearBlendBody(
            found.body, found.source, found.bones, float(errors.max()), float(errors.mean()), kept
        )
    if not isinstance(body.skin, (LinearSkin, RigidSkin, SwingTwistSkin, DualQuaternionSkin)):
        raise ValueError(
            f"A body with a {type(body.skin).__name__} cannot be converted to linear blend skinning; expected a "
            "linear, rigid, swing-twist or dual quaternion skin."
        )
    count = poses.rotations.shape[0]
    chosen = even_indices(count, _NUM_POSES, nearest=True)
    blend = _initial_blend(body, max_influences)
    if isinstance(body.skin, (LinearSkin, RigidSkin)):
        blend = _limit_blend(body, blend, take_poses(poses, chosen), tolerance, max_influences)
        largest, mean = _errors(body, blend, poses)
        return LinearBlendBody(*_assemble(body, blend), error=float(largest.max()), mean_error=mean)
    while True:
        blend = _add_virtual_bones(
            body, blend, take_poses(poses, chosen), tolerance, max_influences, max_virtual_bones
        )
        largest, mean = _errors(body, blend, poses)
        # add the poses of largest error if it exceeds the tolerance
        worst = np.argsort(-largest)[:_NUM_ADDED_POSES]
        worst = worst[(largest[worst] > tolerance) & ~np.isin(worst, chosen)]
        if not len(worst):
            return LinearBlendBody(*_assemble(body, blend), error=float(largest.max()), mean_error=mean)
        chosen = np.union1d(chosen, worst)


@checked
def linear_pose(converted: LinearBlendBody, pose: Pose) -> Pose:
    """Convert a pose of the source to a pose of the converted body."""
    if converted.bones is None:
        return pose
    return extended_pose(converted.source, converted.bones, pose)


@eqx.filter_jit
def _linear_poses(converted: LinearBlendBody, poses: Pose) -> Pose:
    return jax.lax.map(lambda pose: linear_pose(converted, pose), poses)


@checked
def linear_motion(converted: LinearBlendBody, motion: Motion) -> Motion:
    """Convert a motion of the source to a motion of the converted body.

    **Raises:** `ValueError` if the motion has other joints.
    """
    _check_joints(converted, motion)
    return Motion(_linear_poses(converted, motion.poses), motion.rate)


@checked
def linear_targets(converted: LinearBlendBody, motion: Motion | None = None) -> MorphTargets | None:
    """Convert the displacements of the source to morph targets of the converted body; None if it has none.

    Their weights are those of a motion of the source; without one, the body is at rest.

    **Raises:** `ValueError` if the motion has other joints.
    """
    skin = converted.correctives
    if skin is None:
        return None
    names = unit_names(skin, converted.source.names)
    displacements = np.moveaxis(np.asarray(skin.directions, float), 2, 0)
    if motion is None:
        return MorphTargets(names, displacements, np.zeros((0, len(names))))
    _check_joints(converted, motion)
    return MorphTargets(names, displacements, np.asarray(corrective_units(skin, motion.poses), float))


@eqx.filter_jit
def _surface_distances(body: Body, converted: LinearBlendBody, kept: CorrectedSkin | None, poses: Pose):
    """Compute the distances of the vertices of both bodies in all poses, metres."""

    def of_pose(pose):
        moved = (
            converted.body.vertices if kept is None else converted.body.vertices + kept.displacements(pose)
        )
        linear = eqx.tree_at(lambda b: b.vertices, converted.body, moved)
        there = pose_body(linear, linear_pose(converted, pose)).vertices
        return jnp.linalg.norm(there - pose_body(body, pose).vertices, axis=1)

    return jax.lax.map(of_pose, poses)


def _check_joints(converted: LinearBlendBody, motion: Motion) -> None:
    joints = motion.poses.rotations.shape[1]
    if joints != converted.source.num_joints:
        raise ValueError(
            f"The motion has {joints} joints, but the source body has {converted.source.num_joints}; give a motion "
            "of the source body."
        )


def _check(body: Body, poses: Pose, tolerance: float, max_influences: int, max_virtual_bones: int) -> None:
    if poses.rotations.ndim != 3 or poses.rotations.shape[0] == 0:
        raise ValueError("The poses are not stacked over frames, or there are none; give at least one frame.")
    joints = poses.rotations.shape[1]
    if joints != body.skeleton.num_joints:
        raise ValueError(
            f"The poses have {joints} joints, but the body has {body.skeleton.num_joints}; give poses of this body."
        )
    for name, value in (
        ("tolerance", tolerance),
        ("number of influences", max_influences),
        ("largest number of virtual bones", max_virtual_bones),
    ):
        if not value > 0:
            raise ValueError(
                f"The {name} of a body with linear blend skinning is {value}; give a positive number."
            )


class _Blend(NamedTuple):
    """The virtual bones so far, and the candidate bones of each vertex with their weights."""

    rows: WeightRows
    #: (V, K), -1 for none; the indices of virtual bones follow the skeleton's own
    candidates: np.ndarray
    weights: np.ndarray


def _initial_blend(body: Body, influences: int) -> _Blend:
    """Start with the skin's own influences and no virtual bones."""
    weights = np.array(body.skin.bone_weights(body.skeleton.num_joints), float)
    return _Blend(empty_rows(body.skeleton.num_joints), *strongest_bones(weights, influences))


def _limit_blend(body: Body, blend: _Blend, poses: Pose, tolerance: float, influences: int) -> _Blend:
    """Replace bones and weights if the strongest exceed half of the tolerance and others are nearer."""
    frames, targets = skeleton_frames(body, poses)
    vertices, own = np.array(body.vertices, float), np.array(body.skin.bone_weights(body.skeleton.num_joints))
    errors = blend_errors(vertices, targets, frames, blend.candidates, blend.weights).max(0)
    again = np.flatnonzero(errors > tolerance / 2)
    choice = np.argsort(-own[again], axis=1, kind="stable")[:, : max(_NUM_CANDIDATES, influences)]
    choice = np.where(np.take_along_axis(own[again], choice, 1) > 0, choice, -1)
    weights, nearer = fit_linear_weights(vertices[again], targets[:, again], frames, choice, influences)
    better = nearer < errors[again]
    gap = ((0, 0), (0, choice.shape[1] - blend.candidates.shape[1]))
    candidates, kept = np.pad(blend.candidates, gap, constant_values=-1), np.pad(blend.weights, gap)
    candidates[again[better]], kept[again[better]] = choice[better], weights[better]
    return _Blend(blend.rows, candidates, kept)


def _add_virtual_bones(
    body: Body, blend: _Blend, poses: Pose, tolerance: float, influences: int, max_rows: int
) -> _Blend:
    """Add rows until the poses are within the tolerance or there are `max_rows` rows."""
    needs, rows = blend_terms(body.skin), blend.rows
    own, targets = skeleton_frames(body, poses)
    frames = np.concatenate([own, virtual_frames(body, rows, poses)], 1)
    vertices = np.array(body.vertices, float)
    candidates = choose_candidates(needs, rows, _NUM_CANDIDATES)
    weights, errors = fit_linear_weights(vertices, targets, frames, candidates, influences)
    while len(rows.bases) < max_rows:
        new = _worst_rows(needs, rows, errors, tolerance, max_rows)
        if not len(new.bases):
            break
        rows = join_rows(rows, new)
        frames = np.concatenate([frames, virtual_frames(body, new, poses)], 1)
        before, candidates = candidates, choose_candidates(needs, rows, _NUM_CANDIDATES)
        gap = candidates.shape[1] - before.shape[1]
        before = np.pad(before, ((0, 0), (0, gap)), constant_values=-1)
        weights = np.pad(weights, ((0, 0), (0, gap)))
        # vertices with a small error keep their candidates
        again = (np.sort(before, 1) != np.sort(candidates, 1)).any(1) & (errors > tolerance / 2)
        candidates[~again] = before[~again]
        weights[again], errors[again] = fit_linear_weights(
            vertices[again], targets[:, again], frames, candidates[again], influences
        )
    return _Blend(rows, candidates, weights)


def _worst_rows(
    needs: BlendTerms, rows: WeightRows, errors: np.ndarray, tolerance: float, max_rows: int
) -> WeightRows:
    """Choose rows for the vertices of largest error, with blends that differ from each other."""
    new = empty_rows(needs.blends.shape[1])
    done: list[int] = []
    for vertex in np.argsort(-errors):
        if errors[vertex] <= tolerance or len(done) == _MAX_NEW_VERTICES:
            break
        near = needs.bases[done] == needs.bases[vertex]
        near &= np.abs(needs.blends[done] - needs.blends[vertex]).sum(1) < _MIN_BLEND_DISTANCE
        if near.any():
            continue
        found = missing_rows(needs, int(vertex), join_rows(rows, new))
        if len(found.bases) and len(rows.bases) + len(new.bases) + len(found.bases) <= max_rows:
            new = join_rows(new, found)
            done.append(int(vertex))
    return new


def _errors(body: Body, blend: _Blend, poses: Pose) -> tuple[np.ndarray, float]:
    """Compute the largest vertex distance in each pose, and the mean over all, metres."""
    vertices, largest, means = np.array(body.vertices, float), [], []
    for block in pose_blocks(poses):
        own, targets = skeleton_frames(body, block)
        frames = np.concatenate([own, virtual_frames(body, blend.rows, block)], 1)
        errors = blend_errors(vertices, targets, frames, blend.candidates, blend.weights)
        largest.append(errors.max(1))
        means.append(errors.mean(1))
    return np.concatenate(largest), float(np.concatenate(means).mean())


def _assemble(body: Body, blend: _Blend) -> tuple[Body, Skeleton, VirtualBones | None]:
    """Build the linear body on the skeleton's bones and those virtual bones that have a weight."""
    joints, rows = body.skeleton.num_joints, blend.rows
    weights = np.zeros((len(blend.weights), joints + len(rows.bases)))
    vertex, place = np.nonzero(blend.weights)
    weights[vertex, blend.candidates[vertex, place]] = blend.weights[vertex, place]
    used = np.flatnonzero(weights[:, joints:].any(0))
    kept = weights[:, np.concatenate([np.arange(joints), joints + used])]
    skin = LinearSkin(jnp.asarray(kept, body.vertices.dtype))
    if not len(used):
        return Body(body.skeleton, skin, body.vertices, body.faces), body.skeleton, None
    bones = make_virtual_bones(skin_of_rows(body.skin, take_rows(rows, used)), body.skeleton)
    linear = Body(extended_skeleton(body.skeleton, bones), skin, body.vertices, body.faces)
    return linear, body.skeleton, bones
