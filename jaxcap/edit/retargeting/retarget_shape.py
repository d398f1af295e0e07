"""Retarget motions between bodies of the same mesh: fit the target's pose to the source's surface.

Adaptation, section 4.2.3, automatic retargeting by exploiting mesh topology: pose parameters cannot be copied
between bodies with other joint positions, but vertices correspond, and a pose is fitted to them as to a
registered mesh. Vertices of another body shape are at other positions, so the source's surface is first
transferred to the target's shape (`transfer`): a limb then has the length and thickness of the target's and
the pose of the source's.
"""

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...arguments import checked
from ...body.body import Body, posed_vertices
from ...body.pose import Motion, concatenate_poses, shift_roots, take_poses
from ...fit.fit_meshes import fit_meshes
from ...geometry.procrustes import nearest_rotation
from ...observe.meshes import MeshSequence
from .soles import motion_floor_height
from .transfer import make_transfer, transfer_pose

#: frames per fit, and number of vertices for the fit
BLOCK, NUM_FIT_VERTICES = 32, 1500
#: vertices within this distance of the lowest one bear the body, metres
SUPPORT_HEIGHT = 0.01
#: share of a limb's moment that regularises its rotation to the identity if its shape does not determine one
REGULARISATION = 0.02
#: rest poses differ if the surfaces of a limb are rotated by more than this, radians
MAX_REST_ANGLE = np.radians(30.0)


class ShapeRetarget(NamedTuple):
    """A motion of the target, and its fit errors."""

    motion: Motion
    #: (F,) root mean square distance of the vertices from the source's pose in the target's shape, metres
    rmse: Float[np.ndarray, "F"]
    #: size ratio of target to source
    ratio: float
    #: height of the common floor, metres
    floor: float


@checked
def retarget_shape(
    motion: Motion,
    source: Body,
    target: Body,
    *,
    floor: float | None = None,
    progress: Callable[[list], Iterable] = iter,
) -> ShapeRetarget:
    """Retarget the `motion` of `source` to `target`, a body with corresponding vertices in the same order.

    Every frame is fitted by `fit_meshes` to the source's surface in the target's shape. The target is then
    translated so that the height of its lowest point above the floor is the source's, times the ratio of
    their sizes; it neither floats nor penetrates the floor. Along the floor it moves so that its bearing
    surface slides as much as the source's does: feet at rest do not slide, and a shorter person travels a
    shorter distance. It starts at the source's position scaled about the origin.

    Results are of scale 1. Rest poses must be alike, as those of bodies adapted from one template are.

    **Arguments:** `floor` is the height of the floor along y, metres, by default estimated from the source
    (`floor_height`). `progress` wraps the iterable of blocks of frames that are fitted in one call.

    **Raises:** `ValueError` if vertices or triangles do not correspond, the motion has other joints than the
    source, has no frames, or the rest poses of the bodies differ.
    """
    _check(motion, source, target)
    rests = [np.asarray(body.vertices, float) for body in (source, target)]
    transfer = make_transfer(rests[0], rests[1], np.asarray(source.faces))
    ratio = float(np.ptp(rests[1][:, 1]) / np.ptp(rests[0][:, 1]))
    chosen = sample_vertices(rests[1], NUM_FIT_VERTICES)
    # all blocks have one length, so that they are compiled once; the last one repeats the last frame
    length = min(BLOCK, len(motion))
    blocks = [
        (start, np.minimum(np.arange(start, start + length), len(motion) - 1))
        for start in range(0, len(motion), length)
    ]

    def surface(frames):
        return np.asarray(posed_vertices(source, take_poses(motion.poses, frames)), float)

    if floor is None:
        floor = motion_floor_height(source, motion.poses)
    parts, errors, path = [], [], RootPath(ratio, float(floor))
    scale = np.asarray(motion.poses.scale, float)
    for start, frames in progress(blocks):
        there, count = surface(frames), min(length, len(motion) - start)
        wanted = np.stack(
            [transfer_pose(transfer, x, float(scale[frame])) for x, frame in zip(there, frames, strict=True)]
        )
        fit = fit_meshes(target, MeshSequence(wanted, target.faces), vertices=chosen)
        here = np.asarray(posed_vertices(target, fit.motion.poses), float)
        offsets = np.stack([path.step(there[i], here[i]) for i in range(count)])
        parts.append(shift_roots(target.skeleton, take_poses(fit.motion.poses, slice(0, count)), offsets))
        errors.append(np.asarray(fit.rmse, float)[:count])
    return ShapeRetarget(
        Motion(concatenate_poses(parts), motion.rate), np.concatenate(errors), ratio, float(floor)
    )


class RootPath:
    """The path of a body, computed frame by frame from the motion of its surface and the source's."""

    def __init__(self, ratio: float, floor: float):
        self.ratio, self.floor = ratio, floor
        self.before: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None

    def step(self, source: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Compute the translation, (3,), of the target's surface `target` for the source's surface `source`."""
        bears = np.exp(-(source[:, 1] - source[:, 1].min()) / SUPPORT_HEIGHT)
        offset = np.zeros(3)
        if self.before is None:
            offset = self.ratio * source.mean(0) - target.mean(0)
        else:
            last_there, last_here, share = self.before
            # weights of vertices that bear the body in both frames
            share = np.sqrt(share * bears) + 1e-12
            slide = (share @ (self.ratio * (source - last_there) - (target - last_here))) / share.sum()
            offset = self.offset + slide
        low = self.floor + self.ratio * (source[:, 1].min() - self.floor)
        offset[1] = low - target[:, 1].min()
        self.before, self.offset = (source, target, bears), offset
        return offset


def sample_vertices(vertices: np.ndarray, count: int) -> np.ndarray:
    """Choose about `count` vertices, evenly over the surface: one in each cube of a grid."""
    if len(vertices) <= count:
        return np.arange(len(vertices))
    low, high = 1e-4 * np.ptp(vertices), np.ptp(vertices)
    for _ in range(30):
        side = np.sqrt(low * high)
        cubes = np.unique(np.floor(vertices / side).astype(int), axis=0, return_index=True)[1]
        low, high = (low, side) if len(cubes) < count else (side, high)
    return np.sort(cubes)


def _check(motion: Motion, source: Body, target: Body) -> None:
    counts = len(source.vertices), len(target.vertices)
    if counts[0] != counts[1]:
        raise ValueError(
            f"The source has {counts[0]} vertices and the target {counts[1]}; only bodies of the same mesh have "
            "corresponding vertices. Retarget by the names of joints."
        )
    if not np.array_equal(np.asarray(source.faces), np.asarray(target.faces)):
        raise ValueError(
            "The source and the target have different triangles, so their vertices do not correspond. Retarget by "
            "the names of joints."
        )
    if len(source.faces) == 0:
        raise ValueError("The bodies have no faces; without a surface, retarget by the names of joints.")
    joints = motion.poses.rotations.shape[1]
    if joints != source.skeleton.num_joints:
        raise ValueError(
            f"The motion has {joints} joints, but the source has {source.skeleton.num_joints}; give the body of the "
            "motion."
        )
    if len(motion) == 0:
        raise ValueError("The motion has no frames; give one with at least one frame.")
    root = target.skeleton.kinds[0]
    if root not in ("free", "translate"):
        raise ValueError(
            f"The target's root '{target.skeleton.names[0]}' is {root}, so it cannot translate; make it free."
        )
    _check_rest(source, target)


def _check_rest(source: Body, target: Body) -> None:
    """Check that limbs have similar rest poses.

    The best rotation of each bone's vertices from one rest pose to the other must be small.
    """
    here, there = (np.asarray(body.vertices, float) for body in (source, target))
    parts = np.asarray(source.skin.dominant_bones())
    if len(parts) != len(here):
        return
    for bone in np.unique(parts):
        own = parts == bone
        if own.mean() < 0.01:
            continue
        a, b = (x[own] - x[own].mean(0) for x in (here, there))
        cross = b.T @ a
        # directions that collinear or planar vertices leave undetermined count as no rotation
        turn = nearest_rotation(cross + REGULARISATION * np.trace(a.T @ a) * np.eye(3))
        angle = np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))
        if angle > MAX_REST_ANGLE:
            raise ValueError(
                f"At rest, the surfaces around '{source.skeleton.names[bone]}' differ by a rotation of "
                f"{np.degrees(angle):.0f} degrees; give bodies with the same rest pose."
            )
