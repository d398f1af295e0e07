"""The motion of a body from a file of any motion format."""

import functools
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from ...body.body import Body
from ...body.kinematics import joint_paths
from ...body.pose import Motion, Pose
from ...body.retraction import project
from ...body.skeleton import rest_distance
from ...errors import InputError
from ...metrics import joint_errors
from ..archives.archive import array_names
from ..archives.npz import load_motion, load_skeleton
from ..registry import read_motion
from ..system.reader_errors import reader_of
from .amass import is_amass, read_amass
from .parameters.joints import MAX_REST_DISTANCE


@reader_of("a motion")
def read_body_motion(body: Body, path: Path, unit: str | None = None) -> Motion:
    """Read a motion of a body; joints of a BVH file, with lengths in `unit`, are matched by name.

    **Raises:** `InputError` if the file is invalid or belongs to another body.
    """
    if is_amass(path):
        return read_amass(path, body.skeleton)[1]
    if path.suffix.lower() == ".npz":
        motion = load_motion(path, body.skeleton)
        # a motion may have been saved without its skeleton
        if "centres" in array_names(path):
            _check_distance(path, rest_distance(body.skeleton, load_skeleton(path)))
        return motion
    skeleton, motion = read_motion(path, unit)
    target = body.skeleton
    missing = [
        name
        for name in target.names
        if name not in skeleton.names and target.names.index(name) in target.parents
    ]
    if missing or target.names[0] not in skeleton.names:
        raise InputError(
            f"{path}: this motion has no joint '{(missing or target.names)[0]}'; retarget it with `jaxcap edit retarget`."
        )
    count = motion.num_frames
    rotations = np.tile([1.0, 0, 0, 0], (count, target.num_joints, 1))
    translations = np.zeros((count, target.num_joints, 3))
    for joint, name in enumerate(target.names):
        if name in skeleton.names:
            source = skeleton.names.index(name)
            rotations[:, joint] = motion.poses.rotations[:, source]
            translations[:, joint] = motion.poses.translations[:, source]
    there = np.asarray(joint_paths(skeleton, motion.poses))
    root = there[:, skeleton.names.index(target.names[0])]
    translations[:, 0] = root - np.asarray(target.centres)[0]
    dtype = target.centres.dtype
    poses = Pose(jnp.asarray(translations, dtype), jnp.asarray(rotations, dtype), jnp.ones(count, dtype))
    poses = jax.vmap(functools.partial(project, target))(poses)
    shared = [name for name in target.names if name in skeleton.names]
    here = np.asarray(joint_paths(target, poses))[:, [target.names.index(name) for name in shared]]
    # a file with other joints may have another rest pose, so positions in the motion are compared
    there = there[:, [skeleton.names.index(name) for name in shared]]
    _check_distance(path, float(joint_errors(here, there).max()))
    return Motion(poses, motion.rate)


def _check_distance(path: Path, distance: float) -> None:
    if distance > MAX_REST_DISTANCE:
        raise InputError(
            f"{path}: this motion belongs to another skeleton: its joints differ by up to {1000 * distance:.0f} mm "
            "from those of the body; retarget it with `jaxcap edit retarget`."
        )
