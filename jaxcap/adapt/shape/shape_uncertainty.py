"""How well clouds determine the shape of a tracked person, and the joints in each frame."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...arguments import check_fields, checked
from ...body.body_model import BodyModel, body_coefficients
from ...body.pose import Pose
from ...body.shape_modes import apply_modes
from ...energy.data.pairs import PairDistances
from ...energy.energy import Sum
from ...energy.priors.reference_pose import RestPrior
from ...errors import InputError
from ...fit.body_models.region_covariance import (
    RegionEquations,
    coefficient_covariance,
    eliminate_pose,
    frame_sums,
    joint_derivatives,
    joint_distances,
    surface_regions,
    unstack_equations,
)
from ...fit.frame_equations import frame_equations
from ...fit.linearise import body_tangent, frame_jacobian
from ...fit.solve import solve
from ...fit.solvers.levenberg_marquardt import LevenbergMarquardt
from ...observe.clouds import Cloud, stack_clouds
from ...stacking import stack_trees
from ...tracking.track_frame import Tracker, partial_terms
from .surface_pairs import index_clouds, normal_angle, pair_frames
from .tracked_shape import find_space

#: steps of the poses to their best places on the triangles
STEPS = 4


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
    """The equations of a frame by pose and coefficients, and the derivatives of the joints by both."""

    equations: RegionEquations
    joints: Float[np.ndarray, "J 3 N"]


@checked
def shape_uncertainty(
    tracker: Tracker, clouds: Sequence[Cloud], poses: Sequence[Pose], space: BodyModel | None = None
) -> ShapeUncertainty:
    """Compute how well tracked frames determine the shape coefficients of a person.

    The covariance comes from the distances of the points from the triangles at the solution, whose errors may be alike within each
    of 64 regions of the surface (`jaxcap.fit.body_models.region_covariance`), and from a standard normal prior. The coefficients are
    those of the tracker's body.

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
    count = len(space.template_coefficients)
    frames = _frames(tracker, space, clouds, stack_trees(list(poses)))
    covariance = coefficient_covariance([eliminate_pose(frame.equations, count) for frame in frames])
    return ShapeUncertainty(
        body_coefficients(space, tracker.body), jnp.asarray(covariance, space.template_coefficients.dtype)
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
    frame = _frames(tracker, space, [cloud], stack_trees([pose]))[0]
    reduced = eliminate_pose(frame.equations, len(shape.coefficients))
    return joint_distances(frame.joints, frame.equations, reduced, np.asarray(shape.covariance, float))


def _frames(tracker: Tracker, space: BodyModel, clouds: Sequence[Cloud], poses: Pose) -> list[_Frame]:
    """Linearise frames at the poses that are best on the triangles."""
    scans, stacked, sigmas = index_clouds(clouds), stack_clouds(clouds), None
    angle = normal_angle(tracker)
    # the standard deviations of the first pairs select those of the second
    for _ in range(2):
        distances, sigmas = pair_frames(tracker.body, poses, scans, sigmas, angle)
        poses = _best_poses(tracker, distances, stacked, poses)
    distances, _ = pair_frames(tracker.body, poses, scans, sigmas, angle)
    regions = jnp.asarray(surface_regions(space.template.vertices))
    sums, joints = _equations(tracker, space, distances, stacked, poses, regions)
    return [_Frame(*each) for each in zip(unstack_equations(sums), np.asarray(joints, float), strict=True)]


@eqx.filter_jit
def _best_poses(tracker: Tracker, distances: PairDistances, clouds: Cloud, poses: Pose) -> Pose:
    def of_frame(frame):
        own, cloud, pose = frame
        energy = Sum((own, *_other_terms(tracker, cloud)))
        return solve(energy, tracker.body, pose, LevenbergMarquardt(), STEPS).pose

    return jax.lax.map(of_frame, (distances, clouds, poses))


def _other_terms(tracker: Tracker, cloud: Cloud) -> tuple:
    return RestPrior(tracker.rest_deviations), *partial_terms(tracker, cloud)


@eqx.filter_jit
def _equations(
    tracker: Tracker,
    space: BodyModel,
    distances: PairDistances,
    clouds: Cloud,
    poses: Pose,
    regions: Int[Array, "V"],
):
    """Linearise all frames: the sums of each (`frame_sums`), and derivatives of the joints `(F, J, 3, N)`."""
    body, count = tracker.body, len(space.template_coefficients)
    body_at = partial(apply_modes, body, space.modes)
    tangent = body_tangent(body_at, body, count)
    dofs = body.skeleton.num_dofs

    def of_frame(frame):
        own, cloud, pose = frame
        residual, rows = frame_jacobian(own, body, pose, body_at, tangent)
        places = regions[own.pairs.vertices[:, 0]]
        matrix, *others = frame_sums(
            rows.reshape(len(places), 3, -1), residual.reshape(len(places), 3), places
        )
        further = frame_equations(Sum(_other_terms(tracker, cloud)), body, pose, body_at, tangent)[2]

        return (matrix + further, *others), joint_derivatives(body_at, pose, dofs, count)

    with jax.default_matmul_precision("highest"):
        return jax.lax.map(of_frame, (distances, clouds, poses))
