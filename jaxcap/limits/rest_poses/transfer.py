"""Limits of a person's joints expressed for another skeleton: other joint names, and another rest pose."""

from collections.abc import Mapping

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...arguments import checked
from ...body.skeleton import Skeleton
from ...errors import InputError
from ...geometry import rotation
from ..chart import Chart
from ..implicit_surface import LimitSurface, SurfaceLimits
from .anatomical_joint import AnatomicalJoint, rest_difference_rotations
from .rest_difference import MAX_REST_ANGLE, has_equal_rest, has_same_segments, rest_difference


@checked
def transfer_limits(
    limits: SurfaceLimits, skeleton: Skeleton, anatomy: Mapping[str, AnatomicalJoint]
) -> SurfaceLimits:
    """Convert limits to another skeleton of a person: the same poses of the segments are allowed.

    If all joints that both skeletons have are in the same directions at rest, to two degrees, joints with the same name keep
    their limits as they are. Others are found by their anatomical names, and their charts are rotated by the differences of the
    proximal and of the distal segment at rest. A joint that is not recognised needs the same name, and directions at rest on
    both of its segments that differ by less than 20 degrees: see `rest_difference`.

    **Arguments:** `anatomy` are the joints of the skeleton, as `jaxcap.biomechanics.find_anatomical_joints` finds them.

    **Raises:** `InputError` where a joint is not recognised in one of the skeletons, and its name or its rest pose differ, or the
    limits are without a rest pose.
    """
    return SurfaceLimits(tuple(_transfer(each, skeleton, anatomy) for each in limits.surfaces))


def _transfer(
    surface: LimitSurface, skeleton: Skeleton, anatomy: Mapping[str, AnatomicalJoint]
) -> LimitSurface:
    target = _counterpart(surface.joint, surface.rest, surface.anatomy, skeleton, anatomy)
    if target is not None:
        before, after = rest_difference_rotations(_known(surface.anatomy), target)
        centres = surface.centres
        if surface.chart.kind == "ball":
            centres = centres @ jnp.asarray(after, centres.dtype).T
        chart = _rotate_chart(surface.chart, before, after)
        surface = eqx.tree_at(lambda s: (s.chart, s.centres), surface, (chart, centres))
        surface = _replace(surface, joint=target.joint, anatomy=target, rest=skeleton)
    if surface.parent is None or surface.parent_chart is None:
        return surface
    target = _counterpart(surface.parent, surface.parent_rest, surface.parent_anatomy, skeleton, anatomy)
    if target is not None:
        before, after = rest_difference_rotations(_known(surface.parent_anatomy), target)
        keys = surface.keys
        if surface.parent_chart.kind == "ball":
            keys = keys @ jnp.asarray(after, keys.dtype).T
        chart = _rotate_chart(surface.parent_chart, before, after)
        surface = eqx.tree_at(lambda s: (s.parent_chart, s.keys), surface, (chart, keys))
        surface = _replace(surface, parent=target.joint, parent_anatomy=target, parent_rest=skeleton)
    return surface


def _counterpart(
    joint: str,
    rest: Skeleton | None,
    known: AnatomicalJoint | None,
    skeleton: Skeleton,
    anatomy: Mapping[str, AnatomicalJoint],
) -> AnatomicalJoint | None:
    """Find the joint of the skeleton with the limits of `joint`; None where it is `joint`, and its rotations mean the same."""
    is_named = joint in skeleton.names
    if known is None:
        if not is_named:
            raise InputError(
                f"these limits belong to another skeleton: '{joint}' is not among the joints {', '.join(skeleton.names)}; learn "
                f"limits from motions of this skeleton. The joint '{joint}' is no recognised hip, knee, ankle, shoulder, elbow or "
                "wrist, so its limits are valid for its own skeleton only."
            )
        if rest is None:
            raise InputError(
                f"the limits of '{joint}' are without the rest pose that its rotations are from, so they cannot be compared with this "
                "skeleton: they were learned by an earlier version, or from markers alone; learn the limits again, from motions of a "
                "skeleton."
            )
        _check_segments(joint, rest, skeleton)
        return None
    # a joint of a table of angles has no skeleton
    if is_named and rest is not None and has_equal_rest(rest, skeleton, joint):
        return None
    if known.name not in anatomy:
        where = ""
        if joint not in skeleton.names:
            where = f": '{joint}' is not among the joints {', '.join(skeleton.names)}"
        elif is_named and rest is not None:
            differs = rest_difference(rest, skeleton)
            where = f" with another rest pose: {differs.direction} differs by {np.degrees(differs.angle):.0f} degrees"
        raise InputError(
            f"these limits belong to another skeleton{where}; learn limits from motions of this skeleton. The skeleton has no joint "
            f"that is recognised as '{known.name}', of which '{joint}' has limits; it has "
            f"{', '.join(anatomy) or 'no joints of a person'}."
        )
    return anatomy[known.name]


def _check_segments(joint: str, rest: Skeleton, skeleton: Skeleton) -> None:
    """Check that the segments of a joint have the directions of another skeleton at rest. Raises `InputError`."""
    if not has_same_segments(rest, skeleton, joint):
        raise InputError(
            f"these limits belong to another skeleton: the joints above and below '{joint}' are not among the joints "
            f"{', '.join(skeleton.names)}, so rest poses cannot be compared; learn limits from motions of this skeleton."
        )
    differs = rest_difference(rest, skeleton, joint)
    if differs.angle > MAX_REST_ANGLE:
        raise InputError(
            f"these limits are for another rest pose: {differs.direction} differs by {np.degrees(differs.angle):.0f} degrees at "
            f"rest, and '{joint}' is no recognised hip, knee, ankle, shoulder, elbow or wrist; transfer the motions to this "
            "skeleton with `jaxcap edit retarget`, and learn the limits from the results."
        )


def _known(anatomy: AnatomicalJoint | None) -> AnatomicalJoint:
    assert anatomy is not None
    return anatomy


def _rotate_chart(chart: Chart, before: Float[np.ndarray, "3 3"], after: Float[np.ndarray, "3 3"]) -> Chart:
    """Make the chart in which `q` has the coordinates, rotated by `after`, of `before q after` in `chart`.

    `m^-1 B q A = A^-1 ((B^-1 m A^-1)^-1 q) A`, with the middle `m`.
    """

    def quaternion(matrix) -> Float[Array, "4"]:
        return rotation.from_matrix(jnp.asarray(matrix, chart.middle.dtype))

    middle = rotation.multiply(rotation.multiply(quaternion(before.T), chart.middle), quaternion(after.T))
    axes = chart.axes @ jnp.asarray(after, chart.axes.dtype).T
    return Chart(rotation.normalise(middle), axes, chart.kind)


def _replace(surface: LimitSurface, **changes) -> LimitSurface:
    """Replace static fields and those that are None."""
    fields = {name: getattr(surface, name) for name in surface.__dataclass_fields__}
    return LimitSurface(**{**fields, **changes})
