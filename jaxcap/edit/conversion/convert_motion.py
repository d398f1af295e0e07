"""Conversion of a motion from one body to another: the target's pose and shape follow the source's surface.

All frames share the coefficients of the target's shape. This is the registration of `transfer_model` of SMPL-X (Pavlakos et al.
2019), which fits every frame alone with a given correspondence, as one least-squares problem of all frames with a correspondence
that is found.
"""

from collections.abc import Callable, Iterable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...arguments import checked
from ...body.body import Body, pose_body, posed_vertices
from ...body.body_model import BodyModel, shape_body
from ...body.pose import Motion, Pose, concatenate_poses, take_poses
from ...errors import InputError
from ...fit.fit_meshes import fit_meshes
from ...fit.fit_model import fit_model
from ...geometry.attachment import Attachment, attached_positions
from ...geometry.sampling import even_indices
from ...observe.meshes import MeshSequence
from .conversion_error import ConversionError, conversion_error
from .match_surfaces import SurfaceMatch, match_surfaces

#: largest number of frames from which the coefficients are found, and frames of one fit of poses
NUM_SHAPE_FRAMES, BLOCK = 24, 32


class ConvertedMotion(NamedTuple):
    """A motion of the target with the target's body in the shape of the source."""

    body: Body
    motion: Motion
    #: (K,) shape coefficients; none if the target is a body
    coefficients: Float[np.ndarray, "K"]
    error: ConversionError


@checked
def convert_motion(
    motion: Motion,
    source: Body,
    target: BodyModel | Body,
    match: SurfaceMatch | None = None,
    *,
    progress: Callable[[list], Iterable] = iter,
) -> ConvertedMotion:
    """Convert the `motion` of `source` to another body or body model, so that its surface follows the source's.

    The coefficients of a model are found from frames spread over the motion, all together (`fit_model`); then the pose of each
    frame, with these coefficients (`fit_meshes`). A target that is a body keeps its shape, so that the surfaces agree only as far
    as the two builds do; `retarget` transfers a motion to another build.

    **Arguments:** `source` in the shape of the moving person (`shape_body`); `match` of `match_surfaces`, also of another shape of
    the same bodies, where it is known already; `progress` wraps the iterable of blocks of frames.

    **Raises:** `InputError` if the motion has no frames or other joints than the source, or as `match_surfaces` does.
    """
    _check(motion, source)
    match = match_surfaces(source, target) if match is None else match
    faces = np.asarray((target.template if isinstance(target, BodyModel) else target).faces)
    held = jax.tree.map(lambda x: jnp.asarray(x), match.attachment)
    matched = jnp.asarray(match.matched)

    def wanted(frames: Int[np.ndarray, "N"]) -> MeshSequence:
        poses = take_poses(motion.poses, frames)
        return MeshSequence(_wanted_vertices(source, poses, held, matched), faces, motion.rate)

    body, coefficients = target, np.zeros(0)
    if isinstance(target, BodyModel):
        some = fit_model(target, wanted(even_indices(len(motion), NUM_SHAPE_FRAMES)))
        coefficients = np.asarray(some.coefficients[0], float)
        body = shape_body(target, some.coefficients[0])
    # all blocks have one length, so that they are compiled once; the last one repeats the last frame
    length = min(BLOCK, len(motion))
    blocks = [
        np.minimum(np.arange(first, first + length), len(motion) - 1)
        for first in range(0, len(motion), length)
    ]
    poses, distances, converged = [], [], []
    for block in progress(blocks):
        meshes = wanted(block)
        fit = fit_meshes(body, meshes)
        poses.append(fit.motion.poses)
        distances.append(np.asarray(_distances(body, fit.motion.poses, meshes.vertices)))
        converged.append(np.asarray(fit.converged))
    count = len(motion)
    error = conversion_error(
        np.concatenate(distances)[:count],
        match.matched,
        np.asarray(body.skin.dominant_bones()),
        body.skeleton.num_joints,
        np.concatenate(converged)[:count],
    )
    found = Motion(take_poses(concatenate_poses(poses), slice(0, count)), motion.rate)
    return ConvertedMotion(body, found, coefficients, error)


@eqx.filter_jit
def _wanted_vertices(source: Body, poses: Pose, held: Attachment, matched) -> Float[Array, "F W 3"]:
    """Compute the target's vertices on the posed source; NaN without a counterpart."""

    def one(vertices: Float[Array, "V 3"]) -> Float[Array, "W 3"]:
        return jnp.where(matched[:, None], attached_positions(held, vertices), jnp.nan)

    return jax.lax.map(one, posed_vertices(source, poses))


@eqx.filter_jit
def _distances(body: Body, poses: Pose, wanted: Float[Array, "F W 3"]) -> Float[Array, "F W"]:
    def one(frame):
        pose, there = frame
        return jnp.linalg.norm(pose_body(body, pose).vertices - there, axis=1)

    return jax.lax.map(one, (poses, wanted))


def _check(motion: Motion, source: Body) -> None:
    joints = motion.poses.rotations.shape[1]
    if joints != source.skeleton.num_joints:
        raise InputError(
            f"convert_motion: the motion has {joints} joints, and the source {source.skeleton.num_joints}; give the body of the motion."
        )
    if not len(motion):
        raise InputError("convert_motion: the motion has no frames; give at least one.")
