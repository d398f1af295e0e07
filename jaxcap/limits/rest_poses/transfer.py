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
from .rest_directions import MAX_REST_ANGLE, bone_angle, bone_direction

#: largest angle between the bones at rest of skeletons whose rotations mean the same, radians
EQUAL_REST = float(np.radians(2.0))


@checked
def transfer_limits(
    limits: SurfaceLimits, skeleton: Skeleton, anatomy: Mapping[str, AnatomicalJoint]
) -> SurfaceLimits:
    """Convert limits to another skeleton of a person: the same poses of the segments are allowed.

    A joint with the same name, whose bone at rest differs by less than two degrees, keeps its limits as they are. Others
    are found by their anatomical names, and their charts are rotated by the difference of the rest poses. A joint that is
    not recognised needs the same name, and a bone at rest that differs by less than 20 degrees.

    **Arguments:** `anatomy` are the joints of the skeleton, as `jaxcap.biomechanics.find_anatomical_joints` finds them.

    **Raises:** `InputError` where a joint is not recognised in one of the skeletons.
    """
    bones = {each.joint: each.bone for each in limits.surfaces}
    return SurfaceLimits(tuple(_transfer(each, skeleton, anatomy, bones) for each in limits.surfaces))


def _transfer(
    surface: LimitSurface, skeleton: Skeleton, anatomy: Mapping[str, AnatomicalJoint], bones
) -> LimitSurface:
    if not _is_equal(skeleton, surface.joint, surface.bone, surface.anatomy):
        target = _counterpart(surface.joint, surface.anatomy, anatomy)
        before, after = rest_difference_rotations(_known(surface.anatomy), target)
        centres = surface.centres
        if surface.chart.kind == "ball":
            centres = centres @ jnp.asarray(after, centres.dtype).T
        surface = eqx.tree_at(
            lambda s: (s.chart, s.centres, s.bone),
            surface,
            (
                _rotate_chart(surface.chart, before, after),
                centres,
                jnp.asarray(bone_direction(skeleton, target.joint), surface.bone.dtype),
            ),
        )
        surface = _renamed(surface, joint=target.joint, anatomy=target)
    if surface.parent is None or surface.parent_chart is None:
        return surface
    bone = bones.get(surface.parent, jnp.zeros(3))
    if not _is_equal(skeleton, surface.parent, bone, surface.parent_anatomy):
        target = _counterpart(surface.parent, surface.parent_anatomy, anatomy)
        before, after = rest_difference_rotations(_known(surface.parent_anatomy), target)
        keys = surface.keys
        if surface.parent_chart.kind == "ball":
            keys = keys @ jnp.asarray(after, keys.dtype).T
        chart = _rotate_chart(surface.parent_chart, before, after)
        surface = eqx.tree_at(lambda s: (s.parent_chart, s.keys), surface, (chart, keys))
        surface = _renamed(surface, parent=target.joint, parent_anatomy=target)
    return surface


def _is_equal(skeleton: Skeleton, joint: str, bone, known: AnatomicalJoint | None) -> bool:
    """Test if a joint's rotations mean the same in the skeleton: its name is there, and its bone at rest is alike."""
    if joint not in skeleton.names:
        return False
    # a joint of a table of angles has no bone
    if known is not None and not np.any(np.asarray(bone)):
        return False
    most = MAX_REST_ANGLE if known is None else EQUAL_REST
    return bone_angle(np.asarray(bone, float), bone_direction(skeleton, joint)) <= most


def _counterpart(
    joint: str, known: AnatomicalJoint | None, anatomy: Mapping[str, AnatomicalJoint]
) -> AnatomicalJoint:
    if known is None:
        raise InputError(
            f"The joint '{joint}' of the limits is no recognised hip, knee, ankle, shoulder, elbow or wrist, so its limits "
            "are valid for its own skeleton only."
        )
    if known.name not in anatomy:
        raise InputError(
            f"The skeleton has no joint that is recognised as '{known.name}', of which '{joint}' has limits; it has "
            f"{', '.join(anatomy) or 'no joints of a person'}."
        )
    return anatomy[known.name]


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


def _renamed(surface: LimitSurface, **names) -> LimitSurface:
    """Replace static fields and those that are None."""
    fields = {name: getattr(surface, name) for name in surface.__dataclass_fields__}
    return LimitSurface(**{**fields, **names})
