"""Global initialisation of a pose: annealing from many starts, and refinement of the best result."""

import logging
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from ...arguments import checked
from ...body.decimate import reduce_body
from ...body.pose import Pose, concatenate_poses, rest_pose
from ...energy.energy import AbstractEnergy, unweighted
from ...energy.priors.joint_limits import JointLimits
from ...energy.priors.reference_pose import PosePrior, RestPrior, tangent_deviations
from ...fit.correspondence.part_blocks import make_part_blocks
from ...observe import Scan, thin_cloud
from ...observe.clouds import Cloud, as_cloud
from ...stacking import device_array
from ...value_checks import check_at_least, check_direction, check_positive
from ..track_frame import Tracker
from .anneal import SEGMENT, anneal_sorted, anneal_survivors, first_poses
from .prior_starts import mean_pose, prior_starts
from .starts import perturbed_starts, rotated_starts, subtree_starts, unsupported_shares

_LOG = logging.getLogger(__name__)

#: sigma falls from the size of a trunk to that of a wrist, metres
COARSE_SIGMAS = (0.25, 0.2, 0.15, 0.12, 0.1, 0.08, 0.06, 0.05, 0.04, 0.03)
FINE_SIGMAS = (0.08, 0.06, 0.05, 0.04, 0.03, 0.025, 0.02, 0.02, 0.015, 0.015)
#: numbers of vertices and points in the coarse search, and number of points in the refinement
COARSE_VERTICES, COARSE_POINTS, FINE_POINTS = 1000, 768, 2500
#: number of poses that are refined with the whole body
NUM_REFINED = 4
#: sizes of people, relative to the body of an adult, among which a search chooses if the size is unknown
PERSON_SIZES = (1.0, 0.65, 0.72, 0.8, 0.9, 1.1, 1.22)


def joint_terms(tracker: Tracker) -> tuple[AbstractEnergy, ...]:
    """Return the further terms of a tracker that are over joints, not over vertices."""
    return tuple(t for t in tracker.terms if isinstance(unweighted(t), JointLimits | PosePrior | RestPrior))


def coarse_tracker(tracker: Tracker) -> Tracker:
    """Reduce a tracker to fewer vertices, for searches.

    Of its further terms only those over joints are kept: vertices have other indices on the coarse body.
    """
    body = reduce_body(tracker.body, COARSE_VERTICES)
    parts = make_part_blocks(body.skin.dominant_bones(), body.skeleton.num_joints, body.vertices)
    return eqx.tree_at(lambda t: (t.body, t.parts, t.terms), tracker, (body, parts, joint_terms(tracker)))


@checked
def initialise(
    tracker: Tracker,
    cloud: Cloud | Scan,
    *,
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
    turns: int = 12,
    keep: int = 4,
    neighbours: int = 7,
    rounds: int = 2,
    coarse: Tracker | None = None,
    key: PRNGKeyArray | None = None,
    starts: Pose | None = None,
    sizes: Sequence[float] = (1.0,),
) -> tuple[Pose, Float[Array, ""]]:
    """Find the pose of a body in a cloud without a start: orientation about `up` and position are unknown.

    Stacked `starts` replace those at rest. With several `sizes` relative to the body, the size is unknown, too, and the
    `scale` of the returned pose is the likeliest of them (`PERSON_SIZES` are those of people).

    Starts in all directions, at rest and at the mean of the tracker's pose prior if it has one, are annealed with a
    coarse body and few points; poor starts are discarded early (`anneal_survivors`). The best `keep` and `neighbours`
    random neighbours of each are annealed again, then in `rounds` the best with single limbs moved, mostly limbs that have
    no points. In the end the same is done with the whole body and more points, which resolve hands and feet, also with
    limbs at the mean of the prior. Returns the best of all and its mean log-likelihood.

    **Raises:** `InputError` where `up` has no direction, a size is not positive, or nothing is to be tried or kept.
    """
    cloud = as_cloud(cloud)
    check_direction("initialise", up=up)
    check_at_least("initialise", 1, turns=turns, keep=keep)
    check_at_least("initialise", 0, neighbours=neighbours, rounds=rounds)
    check_positive("initialise", "times the size of the body", sizes=sizes)
    keys = jax.random.split(jax.random.key(0) if key is None else key, 3 + rounds)
    coarse = coarse_tracker(tracker) if coarse is None else coarse
    few = thin_cloud(cloud, COARSE_POINTS)
    skeleton = tracker.body.skeleton
    _LOG.info("searching for the pose in all directions")
    rest = rest_pose(skeleton)
    vertical = jnp.asarray(up, rest.rotations.dtype)
    wide = device_array(np.repeat(COARSE_SIGMAS, 2), vertical.dtype)
    fine = device_array(FINE_SIGMAS, vertical.dtype)
    if starts is None:
        standing = [rest] if tracker.pose_prior is None else [rest, mean_pose(tracker.pose_prior, skeleton)]
        standing = [scale_pose(pose, size) for size in sizes for pose in standing]
        starts = concatenate_poses([rotated_starts(coarse, few, pose, turns, vertical) for pose in standing])
        starts = perturbed_starts(skeleton, starts, 1, tangent_deviations(skeleton, 0.0, 0.3), keys[0])
    poses = anneal_survivors(coarse, few, starts, wide)
    _LOG.info("searching near the best poses")
    limbs = tangent_deviations(skeleton, 0.02, 0.4)
    poses = perturbed_starts(skeleton, first_poses(poses, keep), neighbours, limbs, keys[1])
    poses = anneal_survivors(coarse, few, poses, fine, is_compiled=True)
    for number in range(rounds):
        best = first_poses(poses, max(keep // 2, 1))
        shares = unsupported_shares(coarse, best, few)
        poses = subtree_starts(skeleton, best, 2 * neighbours + 1, limbs, keys[2 + number], shares)
        poses = anneal_survivors(coarse, few, poses, fine, is_compiled=True)
    return refine(tracker, coarse, cloud, first_poses(poses, 1), 2 * neighbours + 1, keys[-1])


def search_size(tracker: Tracker, cloud: Cloud, up: tuple[float, float, float] = (0.0, 1.0, 0.0)) -> float:
    """Search for the size of the person in a cloud, relative to the tracker's body: one of `PERSON_SIZES`."""
    _LOG.info("comparing sizes of the body")
    return float(initialise(tracker, cloud, up=up, sizes=PERSON_SIZES)[0].scale)


def scale_pose(pose: Pose, size: float | Float[Array, ""]) -> Pose:
    """Replace the scale of one pose."""
    return Pose(pose.translations, pose.rotations, jnp.asarray(size, pose.scale.dtype))


def refine(
    tracker: Tracker, coarse: Tracker, cloud: Cloud, poses: Pose, count: int, key: PRNGKeyArray
) -> tuple[Pose, Float[Array, ""]]:
    """Refine stacked poses and `count` neighbours of each with single limbs moved, and return the best.

    The whole body and `FINE_POINTS` points distinguish poses that a coarse search cannot, such as a hand and
    the same hand turned over. Only the `NUM_REFINED` best of the coarse body reach it.
    """
    skeleton = tracker.body.skeleton
    few = thin_cloud(cloud, COARSE_POINTS)
    shares = unsupported_shares(coarse, poses, few)
    near = subtree_starts(skeleton, poses, count, tangent_deviations(skeleton, 0.02, 0.4), key, shares)
    if tracker.pose_prior is not None:
        near = concatenate_poses([near, *prior_starts(tracker.pose_prior, skeleton, poses)])
    _LOG.info("searching near the best pose with the whole body")
    sigmas = device_array(FINE_SIGMAS[2:], poses.rotations.dtype)
    first = device_array(FINE_SIGMAS[2 : 2 + SEGMENT], sigmas.dtype)
    near = anneal_survivors(coarse, few, near, first, is_compiled=True)
    poses, scores = anneal_sorted(
        tracker, thin_cloud(cloud, FINE_POINTS), first_poses(near, NUM_REFINED), sigmas
    )
    return jax.tree.map(lambda leaf: leaf[0], poses), scores[0]
