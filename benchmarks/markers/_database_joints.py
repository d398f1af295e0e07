"""The database's own skeleton and motion of a take, and how far joints are from it."""

from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

import jaxcap as jc
from benchmarks._scenes import cmu_motion


class DatabaseMotion(NamedTuple):
    """The database's skeleton, and its bones in every frame: their rotations, translations and centres."""

    skeleton: jc.Skeleton
    rotations: Float[np.ndarray, "F J 3 3"]
    translations: Float[np.ndarray, "F J 3"]
    centres: Float[np.ndarray, "F J 3"]


class JointError(NamedTuple):
    """The mean distances of a joint from the database's joint, metres, before and after the best constant offset."""

    name: str
    before: float
    after: float


def load_database(shared: Path, take: str, frames: slice) -> DatabaseMotion:
    """Load some frames of the database's motion of a take."""
    motion, skeleton = cmu_motion(shared, take)
    return DatabaseMotion(skeleton, *bone_frames(skeleton, motion.slice(frames)))


def bone_frames(skeleton: jc.Skeleton, motion: jc.Motion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute rotations (F, J, 3, 3), translations and centres (F, J, 3) of all bones."""

    def of_frame(pose):
        transforms = jc.forward_kinematics(skeleton, pose)
        return transforms.rotations, transforms.translations

    r, t = (np.asarray(x, float) for x in jax.jit(lambda poses: jax.lax.map(of_frame, poses))(motion.poses))
    return r, t, np.einsum("fjab,jb->fja", r, np.asarray(skeleton.centres, float)) + t


def offset_spread(
    rotations: Float[np.ndarray, "F 3 3"], origins: Float[np.ndarray, "F 3"], points: Float[np.ndarray, "F 3"]
) -> Float[np.ndarray, "F"]:
    """Compute the distances of points from their best constant position in a moving frame, metres."""
    local = np.einsum("fba,fb->fa", rotations, points - origins)
    return np.linalg.norm(local - local.mean(0), axis=1)


def joint_error(
    database: DatabaseMotion, name: str, joint: int, points: Float[np.ndarray, "F 3"]
) -> JointError:
    """Compare a joint's positions with a joint of the database, whose parent's frame has the offset."""
    theirs, above = database.centres[:, joint], database.skeleton.parents[joint]
    before = float(np.linalg.norm(points - theirs, axis=1).mean())
    away = np.einsum("fba,fb->fa", database.rotations[:, above], points - theirs)
    after = float(np.linalg.norm(away - away.mean(0), axis=1).mean())
    return JointError(f"{name} {database.skeleton.names[joint]}", before, after)


def bone_residuals(
    database: DatabaseMotion, places: Float[np.ndarray, "F M 3"], seen: np.ndarray
) -> tuple[Float[np.ndarray, "F M"], Float[np.ndarray, "M J"]]:
    """Compute the residuals of markers on the database's bones that carry them best, and mean squares on every bone."""
    best = np.full(places.shape[:2], np.nan)
    squares = np.zeros((places.shape[1], database.skeleton.num_joints))
    for marker, shown in enumerate(seen.T):
        each = [
            offset_spread(
                database.rotations[shown, j], database.translations[shown, j], places[shown, marker]
            )
            for j in range(database.skeleton.num_joints)
        ]
        squares[marker] = [float(np.mean(one**2)) for one in each]
        best[shown, marker] = each[int(squares[marker].argmin())]
    return best, squares
