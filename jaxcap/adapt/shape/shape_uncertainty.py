"""How well clouds determine the shape of a tracked person, and the joints in each frame."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...arguments import check_fields, checked
from ...body.body import Body, pose_body
from ...body.body_model import BodyModel, body_coefficients
from ...body.pose import Pose
from ...body.retraction import retract
from ...body.shape_modes import apply_modes
from ...energy.energy import Sum
from ...energy.priors.reference_pose import RestPrior
from ...errors import InputError
from ...fit.frame_equations import frame_equations
from ...fit.linearise import body_tangent
from ...geometry.linear import inverse_symmetric
from ...observe.clouds import Cloud, stack_clouds
from ...stacking import stack_trees
from ...tracking.track_frame import Tracker
from .tracked_shape import find_space, frame_terms

#: points that count as one independent measurement, because errors of neighbouring points are alike: from two made people,
#: whose coefficients were off by 7 deviations of independent points. The share of intervals was not measured
POINTS_PER_INDEPENDENT = 50.0
#: assignments of points, at fixed poses, that find their standard deviation
ASSIGNMENTS = 8
#: curvature of coordinates that nothing determines, as a share of the largest one
MIN_CURVATURE = 1e-9


class ShapeUncertainty(eqx.Module):
    """The coefficients of a person with their covariance."""

    coefficients: Float[Array, "K"]
    covariance: Float[Array, "K K"]

    def __check_init__(self):
        check_fields(self)

    @property
    def deviations(self) -> Float[Array, "K"]:
        """Standard deviations of the coefficients."""
        return jnp.sqrt(jnp.diagonal(self.covariance))


class _Frame(NamedTuple):
    """The normal equations of a frame by pose and coefficients, and the derivatives of the joints by both."""

    matrix: Float[np.ndarray, "N N"]
    joints: Float[np.ndarray, "J 3 N"]


@checked
def shape_uncertainty(
    tracker: Tracker, clouds: Sequence[Cloud], poses: Sequence[Pose], space: BodyModel | None = None
) -> ShapeUncertainty:
    """Compute how well tracked frames determine the shape coefficients of a person.

    The information is that of the normal equations of all poses and coefficients at the solution, without the poses, divided
    by `POINTS_PER_INDEPENDENT`, and that of a standard normal prior. The coefficients are those of the tracker's body.

    **Arguments:** `clouds` and `poses`, of the frames that determined the shape, tracked by `tracker` with the person's body;
    `space`, the shape space, that of `shape_space_like` where not given.

    **Raises:** `InputError` if the body is not one of the space, or there are no frames.
    """
    space = find_space(tracker, space)
    if not clouds or len(clouds) != len(poses):
        raise InputError(
            f"shape_uncertainty: there are {len(clouds)} clouds and {len(poses)} poses; expected one pose for each cloud, and at least "
            "one."
        )
    frames = stack_clouds(clouds)
    found = _frames(tracker, space, frames, stack_trees(list(poses)))
    # a coefficient that no frame determines has the deviation of people, one
    count = len(space.template_coefficients)
    information = np.eye(count)
    for frame in found:
        information += _without_pose(frame, count)[0] / POINTS_PER_INDEPENDENT
    dtype = space.template_coefficients.dtype
    return ShapeUncertainty(
        body_coefficients(space, tracker.body),
        jnp.asarray(inverse_symmetric(information), dtype),
    )


@checked
def joint_deviations(
    tracker: Tracker,
    cloud: Cloud,
    pose: Pose,
    shape: ShapeUncertainty,
    space: BodyModel | None = None,
) -> Float[np.ndarray, "J"]:
    """Compute the expected distances of the joints of a tracked frame from the true ones, root mean squares in metres.

    They have a part of the frame's own pose, and one of the coefficients, with which the pose goes along.

    **Arguments:** `cloud` and `pose` of the frame; `shape`, of `shape_uncertainty`; others as there.

    **Raises:** `InputError` if the body is not one of the space.
    """
    space = find_space(tracker, space)
    frame = _frames(tracker, space, stack_clouds([cloud]), stack_trees([pose]))[0]
    count = len(shape.coefficients)
    _, inverse, follow = _without_pose(frame, count)
    by_pose, by_shape = frame.joints[..., :-count], frame.joints[..., -count:]
    by_shape = by_shape - by_pose @ follow
    own = POINTS_PER_INDEPENDENT * np.einsum("jan,nm,jam->j", by_pose, inverse, by_pose)
    shared = np.einsum("jak,kl,jal->j", by_shape, np.asarray(shape.covariance, float), by_shape)
    return np.sqrt(np.maximum(own + shared, 0.0))


def _frames(tracker: Tracker, space: BodyModel, clouds: Cloud, poses: Pose) -> list[_Frame]:
    matrices, joints = (np.asarray(each, float) for each in _equations(tracker, space, clouds, poses))
    return [_Frame(*each) for each in zip(matrices, joints, strict=True)]


@eqx.filter_jit
def _equations(tracker: Tracker, space: BodyModel, clouds: Cloud, poses: Pose):
    """Linearise all frames: normal matrices `(F, N, N)`, and the derivatives of the joints `(F, J, 3, N)`."""
    body, count = tracker.body, len(space.template_coefficients)
    start = jnp.full(len(poses.scale), tracker.sigma_start, poses.rotations.dtype)

    def assign(_, sigmas):
        return frame_terms(tracker, body, clouds, poses, sigmas)[1]

    sigmas = jax.lax.fori_loop(0, ASSIGNMENTS, assign, start)
    terms = frame_terms(tracker, body, clouds, poses, sigmas)[0]
    body_at = partial(apply_modes, body, space.modes)
    tangent = body_tangent(body_at, body, count)
    dofs = body.skeleton.num_dofs

    def of_frame(frame):
        terms, pose = frame
        energy = Sum((*terms, RestPrior(tracker.rest_deviations)))
        matrix = frame_equations(energy, body, pose, body_at, tangent)[2]

        def joints(d: Float[Array, "N"]) -> Float[Array, "J 3"]:
            moved: Body = body_at(d[dofs:])
            return pose_body(moved, retract(body.skeleton, pose, d[:dofs])).joints

        return matrix, jax.jacfwd(joints)(jnp.zeros(dofs + count, matrix.dtype))

    with jax.default_matmul_precision("highest"):
        return jax.lax.map(of_frame, (terms, poses))


def _without_pose(
    frame: _Frame, count: int
) -> tuple[Float[np.ndarray, "K K"], Float[np.ndarray, "D D"], Float[np.ndarray, "D K"]]:
    """Eliminate the pose: the information of the coefficients, the inverse of the pose's, and how the pose follows them, negative."""
    own, coupling, shared = (
        frame.matrix[:-count, :-count],
        frame.matrix[:-count, -count:],
        frame.matrix[-count:, -count:],
    )
    diagonal = np.diagonal(own)
    inverse = inverse_symmetric(own + np.diag(np.where(diagonal > 0, MIN_CURVATURE * diagonal, 1.0)))
    follow = inverse @ coupling
    return shared - coupling.T @ follow, inverse, follow
