"""The surface of a source in the build of a target that keeps its own shape."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...body.body import Body, posed_vertices
from ...body.pose import Motion, Pose, shift_roots
from ...fit.fit_meshes import fit_meshes, procrustes_poses
from ...observe.meshes import MeshSequence
from ..retargeting.retarget_shape import RootPath
from ..retargeting.soles import motion_floor_height
from ..retargeting.transfer import PoseTransfer, make_transfer, transfer_pose

#: mean distance at rest above which the build of a target is another one, as a share of the body's size
MAX_DIFFERENCE = 0.01


class OwnBuild(NamedTuple):
    """A target of another build than the source: the transfer of surfaces to it, and its path along the floor."""

    transfer: PoseTransfer
    path: RootPath
    #: size ratio of target to source
    ratio: float


def find_own_build(
    motion: Motion,
    source: Body,
    target: Body,
    rest: Float[np.ndarray, "W 3"],
    matched: Bool[np.ndarray, "W"],
) -> OwnBuild | None:
    """Prepare the transfer to a target's own build; None if that of the source is the same.

    `rest` are the target's vertices on the source at rest, metres. The target takes the pose of that surface bone by bone
    (`procrustes_poses`), so that lengths of bones do not matter.
    """
    size = float(np.ptp(rest, axis=0).max())
    mesh = MeshSequence(np.where(matched[:, None], rest, np.nan)[None], target.faces)
    fit = fit_meshes(target, mesh)
    nearest = np.asarray(posed_vertices(target, fit.motion.poses)[0], float)
    if np.linalg.norm(nearest - rest, axis=1)[matched].mean() < MAX_DIFFERENCE * size:
        return None
    own = np.asarray(posed_vertices(target, procrustes_poses(target, mesh))[0], float)
    ratio = float(np.ptp(own[:, 1]) / np.ptp(rest[:, 1]))
    floor = motion_floor_height(source, motion.poses)
    return OwnBuild(make_transfer(rest, own, np.asarray(target.faces)), RootPath(ratio, floor), ratio)


def transfer_surfaces(
    build: OwnBuild, surfaces: Float[np.ndarray, "F W 3"], scales: Float[np.ndarray, "F"]
) -> Float[np.ndarray, "F W 3"]:
    """Transfer surfaces in successive frames to the target's build, each centred at its mean, metres."""
    return np.stack(
        [
            transfer_pose(build.transfer, one, float(scale))
            for one, scale in zip(surfaces, scales, strict=True)
        ]
    )


def follow_path(
    build: OwnBuild,
    target: Body,
    poses: Pose,
    surfaces: Float[np.ndarray, "F W 3"],
    vertices: Float[np.ndarray, "F W 3"],
) -> Pose:
    """Translate successive poses of the target, with these `vertices`, along the floor as the source's `surfaces` move."""
    shifts = [build.path.step(there, here) for there, here in zip(surfaces, vertices, strict=True)]
    return shift_roots(target.skeleton, poses, np.stack(shifts))
