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
from ..retargeting.retarget_shape import sample_vertices
from .conversion_error import ConversionError, conversion_error
from .match_surfaces import SurfaceMatch, match_surfaces
from .own_build import find_own_build, follow_path, transfer_surfaces

#: largest number of frames from which the coefficients are found, and frames of one fit of poses
NUM_SHAPE_FRAMES, BLOCK = 24, 32
#: number of vertices, even over the surface, that determine the pose of a frame
NUM_VERTICES = 3000


class ConvertedMotion(NamedTuple):
    """A motion of the target with the target's body in the shape of the source."""

    body: Body
    motion: Motion
    #: (K,) shape coefficients; none if the target is a body
    coefficients: Float[np.ndarray, "K"]
    error: ConversionError
    #: size ratio of target to source, if the target keeps a build of its own; its surface is then compared with the source's in
    #: that build
    ratio: float | None


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
    frame, with these coefficients (`fit_meshes`). A target that is a body keeps its shape. If that is not the source's, its limbs
    take the directions of the source's: the source's surface is first transferred to the target's build, and the target moves
    along the floor in proportion to its size, as in `retarget_shape`.

    **Arguments:** `source` in the shape of the moving person (`shape_body`); `match` of `match_surfaces`, also of another shape of
    the same bodies, where it is known already; `progress` wraps the iterable of blocks of frames.

    **Raises:** `InputError` if the motion has no frames or other joints than the source, or as `match_surfaces` does.
    """
    _check(motion, source)
    match = match_surfaces(source, target) if match is None else match
    held = jax.tree.map(jnp.asarray, match.attachment)
    matched, count = match.matched, len(motion)

    def surfaces(frames: Int[np.ndarray, "N"]) -> Float[Array, "N W 3"]:
        return _mapped_vertices(source, take_poses(motion.poses, frames), held)

    def known(vertices: Float[Array | np.ndarray, "N W 3"]) -> MeshSequence:
        return MeshSequence(jnp.where(matched[:, None], vertices, jnp.nan), faces, motion.rate)

    if isinstance(target, BodyModel):
        faces, build = np.asarray(target.template.faces), None
        some = fit_model(target, known(surfaces(even_indices(count, NUM_SHAPE_FRAMES))))
        coefficients = np.asarray(some.coefficients[0], float)
        body = shape_body(target, some.coefficients[0])
    else:
        body, faces, coefficients = target, np.asarray(target.faces), np.zeros(0)
        rest = np.asarray(attached_positions(match.attachment, np.asarray(source.vertices, float)))
        build = find_own_build(motion, source, target, rest, matched)
    chosen = sample_vertices(np.asarray(body.vertices, float), NUM_VERTICES)
    # all blocks have one length, so that they are compiled once; the last one repeats the last frame
    length = min(BLOCK, count)
    blocks = [np.minimum(np.arange(k, k + length), count - 1) for k in range(0, count, length)]
    scales = np.asarray(motion.poses.scale, float)
    poses, distances, converged = [], [], []
    for block in progress(blocks):
        there = surfaces(block)
        wanted = there if build is None else transfer_surfaces(build, np.asarray(there, float), scales[block])
        fit = fit_meshes(body, known(wanted), vertices=chosen)
        here = posed_vertices(body, fit.motion.poses)
        distances.append(np.linalg.norm(np.asarray(here - wanted, float), axis=2))
        converged.append(np.asarray(fit.converged))
        poses.append(
            fit.motion.poses
            if build is None
            else follow_path(build, body, fit.motion.poses, np.asarray(there, float), np.asarray(here, float))
        )
    error = conversion_error(
        np.concatenate(distances)[:count],
        matched,
        np.asarray(body.skin.dominant_bones()),
        body.skeleton.num_joints,
        np.concatenate(converged)[:count],
    )
    found = Motion(take_poses(concatenate_poses(poses), slice(0, count)), motion.rate)
    return ConvertedMotion(body, found, coefficients, error, None if build is None else build.ratio)


@eqx.filter_jit
def _mapped_vertices(source: Body, poses: Pose, held: Attachment) -> Float[Array, "F W 3"]:
    """Compute the target's vertices on the posed source."""
    return jax.lax.map(lambda pose: attached_positions(held, pose_body(source, pose).vertices), poses)


def _check(motion: Motion, source: Body) -> None:
    joints = motion.poses.rotations.shape[1]
    if joints != source.skeleton.num_joints:
        raise InputError(
            f"convert_motion: the motion has {joints} joints, and the source {source.skeleton.num_joints}; give the body of the motion."
        )
    if not len(motion):
        raise InputError("convert_motion: the motion has no frames; give at least one.")
