"""Marker residuals, and their derivatives by all unknowns.

An observed position `y` is transformed to its bone's rest frame, `l = T_b^-1 y`, and compared with the
marker's rest position `o` there. The marker's model selects the part of the difference that is the residual:
all of it; the distance from the bone and the position along it; or the distance from the joint. These are
the marker models of the global technique, with markers on circles about their segment and on spheres about
their joint, and with unknown radii.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...body.geometric_jacobian import (
    GeometricJacobian,
    composite_equations,
    descendant_matrix,
    joint_jacobian,
    pose_jacobian,
    project_velocities,
    select_parameters,
    wrenches_of,
)
from ...body.kinematics import Transforms, forward_kinematics, joint_positions
from ...body.pose import Pose
from ...geometry import rotation
from ...small_matrices import apply_small
from ..subject import Subject


class LinearisedResiduals(NamedTuple):
    """Residuals of M markers in one frame, metres, with derivatives. Numbers that a model lacks are zero."""

    residual: Float[Array, "M 3"]
    by_pose: Float[Array, "M 3 D"]
    #: by the K chosen joints' centres, joint by joint
    by_centres: Float[Array, "M 3 C"]
    #: by the marker's own rest position
    by_offset: Float[Array, "M 3 3"]


class _ResidualDerivatives(NamedTuple):
    """Derivatives of a marker's residual by `l`, `o`, its bone's centre and its bone's end."""

    local: Float[Array, "M 3 3"]
    offset: Float[Array, "M 3 3"]
    centre: Float[Array, "M 3 3"]
    end: Float[Array, "M 3 3"]


def marker_residuals(subject: Subject, pose: Pose, positions: Float[Array, "M 3"]) -> Float[Array, "M 3"]:
    """Compute the residuals of all markers in one frame, metres at rest."""
    local = rest_positions(subject, pose, forward_kinematics(subject.skeleton, pose), positions)
    return _model_residuals(subject, local)[0]


def rest_positions(
    subject: Subject, pose: Pose, transforms: Transforms, positions: Float[Array, "M 3"]
) -> Float[Array, "M 3"]:
    """Transform marker positions to the rest frames of their bones."""
    r, t = _of_bones(transforms.rotations, subject), _of_bones(transforms.translations, subject)
    return apply_small(jnp.swapaxes(r, 1, 2), positions - t) / pose.scale**2


def _of_bones(values: Float[Array, "J *shape"], subject: Subject) -> Float[Array, "M *shape"]:
    return values.at[subject.bones].get(mode="promise_in_bounds", wrap_negative_indices=False)


def linearise_residuals(
    subject: Subject, pose: Pose, positions: Float[Array, "M 3"], joints: tuple[int, ...] = ()
) -> LinearisedResiduals:
    """Compute residuals and their derivatives.

    The derivatives are by the tangent of the pose, by the rest centres of `joints` and by the markers' own
    rest positions.
    """
    skeleton = subject.skeleton
    transforms = forward_kinematics(skeleton, pose)
    residual, slopes = _model_residuals(subject, rest_positions(subject, pose, transforms, positions))
    directions = _row_directions(subject, pose, transforms, slopes)
    by_pose = _residual_jacobian(subject, positions, directions, pose_jacobian(skeleton, pose, transforms))
    slots = np.array([6 * joint + axis for joint in joints for axis in range(3)], int)
    rates = select_parameters(joint_jacobian(skeleton, pose, transforms), slots)
    by_centres = _residual_jacobian(subject, positions, directions, rates)
    if joints and not _all_rigid(subject):
        starts = subject.bones[:, None] == np.array(joints)
        ends = _first_children(skeleton)[subject.bones][:, None] == np.array(joints)
        for slope, at in ((slopes.centre, starts), (slopes.end, ends)):
            wide = slope[:, :, None, :] * at[:, None, :, None]
            by_centres = by_centres + wide.reshape(by_centres.shape)
    return LinearisedResiduals(residual, by_pose, by_centres, slopes.offset)


def residual_equations(
    subject: Subject,
    pose: Pose,
    positions: Float[Array, "M 3"],
    weigh: Callable[[Float[Array, "M 3"]], Float[Array, "M"]],
) -> tuple[Float[Array, "M 3"], Float[Array, "D"], Float[Array, "D D"]]:
    """Compute residuals, and the gradient and the Gauss-Newton matrix of half their weighted squares by the tangent of the pose.

    `weigh` computes the weights of the markers from their residuals. Equal to products of the rows of `linearise_residuals`, without
    these rows.
    """
    skeleton = subject.skeleton
    transforms = forward_kinematics(skeleton, pose)
    residual, slopes = _model_residuals(subject, rest_positions(subject, pose, transforms, positions))
    directions = _row_directions(subject, pose, transforms, slopes)
    # moments about the root, as those about a distant origin are differences of large numbers
    origin = joint_positions(skeleton, transforms)[0]
    near = Transforms(transforms.rotations, transforms.translations - origin)
    rates = pose_jacobian(skeleton, pose, near)
    wrenches = wrenches_of(positions - origin, directions)
    weights = weigh(residual)
    return residual, *composite_equations(skeleton, rates, subject.bones, wrenches, residual, weights)


def _row_directions(
    subject: Subject, pose: Pose, transforms: Transforms, slopes: _ResidualDerivatives
) -> Float[Array, "M 3 3"]:
    """Compute the directions in the world along which a velocity of its bone changes the rows of each marker."""
    back = jnp.swapaxes(_of_bones(transforms.rotations, subject), 1, 2) / pose.scale**2
    # the bone moves and the observation is fixed, so it moves the opposite way in the bone's frame
    return -back if _all_rigid(subject) else -slopes.local @ back


def _residual_jacobian(
    subject: Subject, positions, directions, rates: GeometricJacobian
) -> Float[Array, "M 3 N"]:
    below = descendant_matrix(subject.skeleton, rates)[subject.bones]
    return project_velocities(positions, directions, rates) * below[:, None]


def _all_rigid(subject: Subject) -> bool:
    return all(model == "rigid" for model in subject.models)


def _first_children(skeleton) -> Array:
    """Find the first child of every joint (J,), the joint itself where it has none."""
    ends = np.arange(skeleton.num_joints)
    for joint in reversed(range(skeleton.num_joints)):
        if skeleton.parents[joint] >= 0:
            ends[skeleton.parents[joint]] = joint
    return jnp.asarray(ends)


def _model_residuals(
    subject: Subject, local: Float[Array, "M 3"]
) -> tuple[Float[Array, "M 3"], _ResidualDerivatives]:
    """Compute the residual of each marker's model, and its derivatives."""
    offsets, dtype = subject.offsets, local.dtype
    one = jnp.asarray(np.broadcast_to(np.eye(3, dtype=dtype), (len(offsets), 3, 3)))
    none = jnp.zeros_like(one)
    residual, slopes = local - offsets, _ResidualDerivatives(one, -one, none, none)
    for name, model in (("circle", _circle_residuals), ("sphere", _sphere_residuals)):
        has_model = np.array([kind == name for kind in subject.models])
        if has_model.any():
            other, others = model(subject, local)
            residual = jnp.where(has_model[:, None], other, residual)
            pairs = zip(others, slopes, strict=True)
            slopes = _ResidualDerivatives(*(jnp.where(has_model[:, None, None], a, b) for a, b in pairs))
    return residual, slopes


def _sphere_residuals(subject: Subject, local) -> tuple[Float[Array, "M 3"], _ResidualDerivatives]:
    """Compute `|l - c| - |o - c|`."""
    centres = subject.skeleton.centres[subject.bones]
    radius, out = _length_and_direction(local - centres)
    own_radius, own_out = _length_and_direction(subject.offsets - centres)
    none = jnp.zeros((len(local), 3, 3), local.dtype)
    row = lambda x: none.at[:, 0].set(x)  # noqa: E731
    return (
        jnp.zeros_like(local).at[:, 0].set(radius - own_radius),
        _ResidualDerivatives(row(out), row(-own_out), row(own_out - out), none),
    )


def _circle_residuals(subject: Subject, local) -> tuple[Float[Array, "M 3"], _ResidualDerivatives]:
    """Compute the residual along the bone's line `c + s u`, and that of the distance from it."""
    skeleton, bones = subject.skeleton, subject.bones
    centres, ends = skeleton.centres[bones], _first_children(skeleton)[bones]
    ahead = jnp.broadcast_to(jnp.array([1.0, 0.0, 0.0], local.dtype), local.shape)
    twist = rotation.rotate(skeleton.orientations[bones], ahead)
    length, line = _length_and_direction(skeleton.centres[ends] - centres)
    # the direction of a bone without an end, or with zero length, is its joint's twist axis
    known = length > 1e-6
    line = jnp.where(known[:, None], line, twist)
    along, radius, out = _cylindrical_coordinates(local - centres, line)
    own_along, own_radius, own_out = _cylindrical_coordinates(subject.offsets - centres, line)
    # derivatives of both numbers by the line: (l - o) . du, and -along out . du + own_along own_out . du
    turned = jnp.stack([local - subject.offsets, own_along[:, None] * own_out - along[:, None] * out], 1)
    across = jnp.eye(3, dtype=local.dtype) - line[:, :, None] * line[:, None, :]
    by_end = turned @ across * jnp.where(known, 1.0 / jnp.where(known, length, 1.0), 0.0)[:, None, None]
    pad = lambda rows: jnp.pad(rows, ((0, 0), (0, 1), (0, 0)))  # noqa: E731
    by_centre = jnp.stack([jnp.zeros_like(out), own_out - out], 1) - by_end
    residual = jnp.stack([along - own_along, radius - own_radius, jnp.zeros_like(radius)], 1)
    slopes = jnp.stack([line, out], 1), -jnp.stack([line, own_out], 1), by_centre, by_end
    return residual, _ResidualDerivatives(*map(pad, slopes))


def _cylindrical_coordinates(x: Float[Array, "M 3"], axis: Float[Array, "M 3"]):
    along = jnp.sum(x * axis, 1)
    radius, out = _length_and_direction(x - along[:, None] * axis)
    return along, radius, out


def _length_and_direction(x: Float[Array, "M 3"]) -> tuple[Float[Array, "M"], Float[Array, "M 3"]]:
    """Compute length and direction; a zero vector has the direction zero."""
    squared = jnp.sum(x * x, 1)
    nonzero = squared > 1e-16
    length = jnp.sqrt(jnp.where(nonzero, squared, 1.0))
    return jnp.where(nonzero, length, 0.0), jnp.where(nonzero[:, None], x / length[:, None], 0.0)
