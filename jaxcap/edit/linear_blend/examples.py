"""Evaluate a body in example poses, as NumPy arrays; compiled once for any number of poses."""

from collections.abc import Iterator

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...body.body import Body, pose_body
from ...body.kinematics import forward_kinematics
from ...body.pose import Pose, take_poses
from ...body.skeleton import Skeleton
from ...body.skin import AbstractSkin
from .virtual_bones import bone_frames
from .weight_rows import WeightRows, skin_of_rows, take_rows

#: number of poses, and of virtual bones, per compiled call
BLOCK_SIZE = 32


def pose_blocks(poses: Pose) -> Iterator[Pose]:
    """Split stacked poses into blocks of at most `BLOCK_SIZE`, in order."""
    for start in range(0, poses.rotations.shape[0], BLOCK_SIZE):
        yield take_poses(poses, np.arange(start, min(start + BLOCK_SIZE, poses.rotations.shape[0])))


def skeleton_frames(
    body: Body, poses: Pose
) -> tuple[Float[np.ndarray, "F J 3 4"], Float[np.ndarray, "F V 3"]]:
    """Compute `[R | t]` of the skeleton's bones, and the vertices, metres."""
    parts = []
    for block in pose_blocks(poses):
        count = block.rotations.shape[0]
        parts.append([np.array(values[:count], float) for values in _pose_block(body, _pad_block(block))])
    frames, vertices = zip(*parts, strict=True)
    return np.concatenate(frames), np.concatenate(vertices)


def virtual_frames(body: Body, rows: WeightRows, poses: Pose) -> Float[np.ndarray, "F S 3 4"]:
    """Compute `[R | t]` of the virtual bones of these rows."""
    total, count = len(rows.bases), poses.rotations.shape[0]
    frames = np.zeros((count, total, 3, 4))
    for start in range(0, total, BLOCK_SIZE):
        skin = skin_of_rows(
            body.skin, take_rows(rows, np.minimum(np.arange(start, start + BLOCK_SIZE), total - 1))
        )
        blocks = [
            _virtual_block_frames(body.skeleton, skin, _pad_block(block)) for block in pose_blocks(poses)
        ]
        frames[:, start : start + BLOCK_SIZE] = np.concatenate(blocks)[:count, : total - start]
    return frames


def _pad_block(block: Pose) -> Pose:
    return take_poses(block, np.minimum(np.arange(BLOCK_SIZE), block.rotations.shape[0] - 1))


@eqx.filter_jit
def _virtual_block_frames(skeleton: Skeleton, skin: AbstractSkin, poses: Pose) -> Float[Array, "F S 3 4"]:
    return jax.lax.map(lambda pose: bone_frames(skeleton, skin, pose), poses)


@eqx.filter_jit
def _pose_block(body: Body, poses: Pose) -> tuple[Float[Array, "F J 3 4"], Float[Array, "F V 3"]]:
    def one(pose):
        moved = forward_kinematics(body.skeleton, pose)
        frames = jnp.concatenate([moved.rotations, moved.translations[:, :, None]], 2)
        return frames, pose_body(body, pose).vertices

    return jax.lax.map(one, poses)
