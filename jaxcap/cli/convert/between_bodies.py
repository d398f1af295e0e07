"""`jaxcap convert --to`: the shape and the motion of one body for another one, by their surfaces."""

from pathlib import Path

import numpy as np

from ...adapt.shape.shape_space import shape_space_like
from ...body.body import Body
from ...body.body_model import BodyModel, split_coefficients
from ...body.matching.plan import plan_retarget
from ...body.people.human import RESOLUTIONS
from ...body.pose import Motion, rest_pose, stack_poses
from ...body.skeleton import Skeleton
from ...edit.conversion.convert_motion import ConvertedMotion, convert_motion
from ...edit.conversion.match_surfaces import match_surfaces
from ...edit.retargeting.retarget import retarget
from ...errors import InputError, user_message
from ...io.archives.npz import save_body
from ...io.registry import BODY_WRITERS, MOTION_WRITERS, write_motion
from ...io.skeletons.amass import write_amass
from ..body_models import is_model_spec, load_model, stated_gender
from ..console.console import pluralise, progress, say, warn
from ..console.heartbeat import set_activity
from ..outputs import check_new
from ..sources import is_human_spec, load_body
from .body import write_linear_body

#: share of vertices without a counterpart that is reported
MIN_UNMATCHED = 0.02
#: number of failed frames that a message lists
MAX_LISTED = 10


def convert_between_bodies(
    source: tuple[Body | Skeleton, Motion],
    name: Path,
    to: str,
    out: Path,
    *,
    tolerance: float,
    influences: int,
    overwrite: bool,
) -> None:
    """Convert a motion of a body, or of a skeleton alone, to the body that `to` names; write it and print its error.

    **Arguments:** `name` is that of the source's file, for messages. A model of SMPL's family is written in AMASS's format with
    its coefficients; another body of a fitted shape has a file of its own next to the motion.

    **Raises:** `InputError`.
    """
    check_target(out)
    target = load_target(to)
    fitted = isinstance(target, BodyModel)
    if out.suffix.lower() in BODY_WRITERS or is_model_spec(to):
        body_path = None
    else:
        body_path = out.with_name(f"{out.stem}_body.npz") if fitted else None
        check_new(body_path, overwrite)
    body, motion = source
    try:
        if isinstance(body, Skeleton) or not len(body.faces):
            found, coefficients = convert_by_joints(body, motion, target, name), None
        else:
            converted = convert_by_surface(body, motion, target)
            print_error(converted, out)
            found, coefficients = (converted.body, converted.motion), converted.coefficients
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"{name}: {user_message(error)}") from None
    body, motion = found
    if out.suffix.lower() in BODY_WRITERS:
        write_linear_body(out, body, motion, tolerance, influences)
        return
    if out.suffix.lower() == ".npz" and isinstance(target, BodyModel) and is_model_spec(to):
        shape = target.template_coefficients if coefficients is None else coefficients
        groups = split_coefficients(target, np.asarray(shape, float))
        write_amass(out, body.skeleton, motion, groups, stated_gender(to) or "neutral")
    else:
        write_motion(out, body.skeleton, motion)
    if body_path is not None:
        save_body(body_path, body)
        say(f"{body_path}: the body of the motion, {len(body.vertices)} vertices")
    say(f"{out}: {pluralise(motion.num_frames, 'frame')} at {motion.rate:g} frames per second")


def check_target(out: Path) -> None:
    """Check that the motion of another body can be written to a path. Raises `InputError`."""
    suffixes = (*MOTION_WRITERS, *BODY_WRITERS)
    if out.suffix.lower() not in suffixes:
        raise InputError(
            f"{out}: the motion of another body is not written as '{out.suffix}' files; use {', '.join(suffixes)}."
        )


def load_target(spec: str) -> BodyModel | Body:
    """Load the body of `--to`: a body model with all joints; `human` without a build as a model of people; or a body.

    **Raises:** `InputError`.
    """
    if is_model_spec(spec):
        return load_model(spec, joints="full")
    body = load_body(spec)[0]
    if not len(body.faces):
        raise InputError(f"{spec}: this body has no triangles; give one with a surface.")
    if is_human_spec(spec) and all(word in RESOLUTIONS for word in filter(None, spec[6:].split(","))):
        set_activity("sampling people for the shape of the human")
        model = shape_space_like(body)
        assert model is not None
        return model
    return body


def still_motion(body: Body) -> Motion:
    """Make a motion of one frame in which a body is at rest."""
    return stack_poses([rest_pose(body.skeleton)])


def convert_by_surface(body: Body, motion: Motion, target: BodyModel | Body) -> ConvertedMotion:
    """Convert by the surfaces, and print the share of vertices without a counterpart."""
    set_activity("matching the surfaces of the two bodies")
    match = match_surfaces(body, target)
    unmatched = float(1.0 - match.matched.mean())
    if unmatched > MIN_UNMATCHED:
        warn(
            f"{unmatched:.0%} of the target's vertices have no counterpart on the source's surface and do not count"
        )
    set_activity("finding the shape of the target")

    def shown(blocks: list):
        return progress(blocks, len(blocks), label="converting", noun="blocks")

    return convert_motion(motion, body, target, match, progress=shown)


def convert_by_joints(
    source: Body | Skeleton, motion: Motion, target: BodyModel | Body, name: Path
) -> tuple[Body, Motion]:
    """Retarget by the names of joints, for a source without a surface; the target keeps its shape."""
    skeleton = source.skeleton if isinstance(source, Body) else source
    body = target.template if isinstance(target, BodyModel) else target
    plan = plan_retarget(skeleton, body.skeleton, None, motion)
    for line in plan.matches.warnings:
        warn(f"{name}: {line}")
    say(
        f"{name}: retargeted by the names of joints, as its body has no surface: 1 m becomes {plan.ratio:.3f} m; give the body "
        "with --body for its shape, and for an error in millimetres"
    )
    return body, retarget(motion, skeleton, body.skeleton, plan=plan)


def print_error(converted: ConvertedMotion, out: Path) -> None:
    """Print the distances of the surfaces, and the frames that failed."""
    error, names = converted.error, converted.body.skeleton.names
    worst = error.worst_frame
    if converted.ratio is not None:
        say(
            f"the target has a build of its own: limbs keep their directions, and 1 m becomes {converted.ratio:.3f} m; distances are "
            "from the source's surface in that build"
        )
    say(
        f"distance of the surfaces: mean {1000 * np.mean(error.mean):.2f} mm, 95 % of the vertices within "
        f"{1000 * np.mean(error.quantile):.2f} mm; worst frame {worst}: mean {1000 * error.mean[worst]:.2f} mm, most at "
        f"{names[error.worst_part]}, {1000 * error.parts[worst, error.worst_part]:.2f} mm"
    )
    failed = np.flatnonzero(error.failed)
    if len(failed):
        listed = ", ".join(map(str, failed[:MAX_LISTED])) + (", ..." if len(failed) > MAX_LISTED else "")
        warn(f"{out}: {pluralise(len(failed), 'frame')} could not be fitted well: {listed}")
