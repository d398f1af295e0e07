"""Export of a body with its motion to programs with linear blend skinning."""

from pathlib import Path

from ...body.body import Body
from ...body.people.sample import sample_poses
from ...body.pose import Motion
from ...body.skin import CorrectedSkin
from ...edit.linear_blend.convert import linear_motion, linear_targets, to_linear_blend
from ...edit.linear_blend.correctives import MAX_UNITS
from ...io.gltf.gltf import write_gltf
from ...io.registry import write_body
from ..console.console import say, warn


def write_linear_body(
    target: Path, body: Body, motion: Motion | None, tolerance: float, influences: int
) -> None:
    """Linearise a body over its motion, or over random poses if it has none, write it, and print its error.

    **Raises:** `InputError` if the file cannot be written; `ValueError` if a number is not positive.
    """
    poses = sample_poses(body.skeleton) if motion is None else motion.poses
    has_targets = target.suffix.lower() == ".glb"
    converted = to_linear_blend(body, poses, tolerance, max_influences=influences, correctives=has_targets)
    linear, joints = converted.body, body.skeleton.num_joints
    targets = linear_targets(converted, motion)
    moving = None if motion is None else linear_motion(converted, motion)
    if targets is None:
        write_body(target, linear, moving)
    else:
        write_gltf(target, linear, moving, targets)
    virtual, count = linear.skeleton.num_joints - joints, poses.rotations.shape[0]
    say(
        f"{target}: {len(linear.vertices)} vertices, {joints} joints, {virtual} virtual bones"
        f"{'' if targets is None else f', {len(targets.names)} morph targets'}; "
        f"largest error {1000 * converted.error:.2g} mm, mean {1000 * converted.mean_error:.2g} mm, "
        f"over {count} {'sampled poses' if motion is None else 'frames'}"
    )
    if targets is not None and moving is None:
        warn(
            f"{target}: nothing moves the morph targets; the program that poses the body has to set their weights, or give --motion"
        )
    if converted.error > tolerance:
        advice = "increase --influences"
        if isinstance(body.skin, CorrectedSkin) and targets is None:
            advice = (
                "the displacements of the surface that depend on the pose are left out, as only .glb has them"
            )
        elif targets is not None and len(targets.names) == MAX_UNITS:
            advice = f"of the morph targets the {MAX_UNITS} with the largest displacements are kept"
        warn(
            f"{target}: {1000 * converted.error:.2g} mm, the largest error of a vertex, exceeds the tolerance of "
            f"{1000 * tolerance:.2g} mm; {advice}"
        )
