"""Global initialisation of a pose: many starts at once, of which the best are refined."""

import logging

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from ..arguments import checked
from ..body.body import pose_body
from ..body.decimate import reduce_body
from ..body.pose import Pose, concatenate_poses, rest_pose
from ..body.retraction import retract
from ..body.skeleton import Skeleton, dof_layout
from ..energy.energy import Sum, unweighted
from ..energy.priors.joint_limits import JointLimits
from ..energy.priors.reference_pose import PosePrior, RestPrior, tangent_deviations
from ..fit.correspondence.part_blocks import make_part_blocks
from ..geometry import rotation
from ..observe import Scan, thin_cloud
from ..observe.clouds import Cloud, as_cloud
from ..parallel import parallel_map
from ..value_checks import check_at_least, check_direction
from .expectation_maximisation.em_step import Estimate, box_volume, em_step
from .prior_starts import mean_pose, prior_starts
from .track_frame import Tracker, first_estimate, frame_terms, penalty

_LOG = logging.getLogger(__name__)

#: sigma falls from the size of a trunk to that of a wrist, metres
COARSE_SIGMAS = (0.25, 0.2, 0.15, 0.12, 0.1, 0.08, 0.06, 0.05, 0.04, 0.03)
FINE_SIGMAS = (0.08, 0.06, 0.05, 0.04, 0.03, 0.025, 0.02, 0.02, 0.015, 0.015)
#: standard deviation at which starts are compared, metres: small enough to tell the front of a trunk from its back
SEARCH_SIGMA = 0.012
#: numbers of vertices and points in the coarse search, and number of points in the refinement
COARSE_VERTICES, COARSE_POINTS, FINE_POINTS = 1000, 768, 2500
#: number of starts that one call of the compiled function anneals
GROUP = 4
#: number of deviations after which poses are compared, the share of the best that go on, and their least number
SEGMENT, SURVIVING_SHARE, MIN_SURVIVORS = 5, 1 / 2, 12
#: number of poses that are refined with the whole body
NUM_REFINED = 4
#: distance from a vertex within which a point supports it, metres, and the share that is added to the unsupported one of
#: every joint
SUPPORT_RADIUS, UNIFORM_SHARE = 0.06, 0.1


def anneal_pose(
    tracker: Tracker,
    cloud: Cloud,
    start: Pose,
    sigmas: Float[Array, "S"],
    comparison_sigma: float | Float[Array, ""] = SEARCH_SIGMA,
) -> tuple[Estimate, Float[Array, ""]]:
    """Fit a pose by expectation maximisation with a given, falling standard deviation at every step.

    Large deviations attract a distant body, small ones fit it (deterministic annealing, Ueda and Nakano
    1998).

    Returns the estimate and its mean log-density, posterior, at `comparison_sigma`, which is common to all starts.
    """
    prior = Sum(frame_terms(tracker, cloud))
    volume = box_volume(cloud)
    first = first_estimate(tracker, start, sigmas[0])

    def step(estimate, sigma):
        # a wrong pose would teach wrong clothes
        wide = Estimate(estimate.pose, sigma, estimate.priors, first.clothes)
        return em_step(tracker.body, tracker.parts, tracker.mixture, prior, cloud, volume, wide)

    judged = jnp.append(sigmas, jnp.asarray(comparison_sigma, sigmas.dtype))
    last, statistics = jax.lax.scan(step, first, judged)
    likelihood = statistics.surface_log_likelihood[-1] - penalty(tracker, cloud, last.pose)
    return last, jnp.where(jnp.isfinite(likelihood), likelihood, -jnp.inf)


def anneal_each(
    tracker: Tracker,
    cloud: Cloud,
    starts: Pose,
    sigmas: Float[Array, "S"],
    comparison_sigma: float | Float[Array, ""] = SEARCH_SIGMA,
    *,
    is_compiled: bool = False,
) -> tuple[Pose, Float[Array, "P"]]:
    """Run `anneal_pose` from each of P stacked starts; poses and scores in their order.

    Groups of `GROUP` starts run on all cores, so that any number of starts uses one compiled function. `is_compiled`, the
    same shapes were annealed before.
    """
    count = starts.rotations.shape[0]
    rows = np.minimum(np.arange(-(-count // GROUP) * GROUP), count - 1).reshape(-1, GROUP)
    groups = [jax.tree.map(lambda leaf, row=row: leaf[row], starts) for row in rows]
    compared = jnp.asarray(comparison_sigma, sigmas.dtype)
    found = parallel_map(
        lambda group: jax.block_until_ready(_anneal_group(tracker, cloud, group, sigmas, compared)),
        groups,
        is_compiled=is_compiled,
    )
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves)[:count], *found)


@eqx.filter_jit
def _anneal_group(
    tracker: Tracker,
    cloud: Cloud,
    starts: Pose,
    sigmas: Float[Array, "S"],
    comparison_sigma: Float[Array, ""],
) -> tuple[Pose, Float[Array, "P"]]:
    def one(start):
        estimate, score = anneal_pose(tracker, cloud, start, sigmas, comparison_sigma)
        return estimate.pose, score

    return jax.lax.map(one, starts)


def anneal_sorted(
    tracker: Tracker, cloud: Cloud, starts: Pose, sigmas: Float[Array, "S"]
) -> tuple[Pose, Float[Array, "P"]]:
    """Run `anneal_each` and sort the results, best first."""
    return _sorted(*anneal_each(tracker, cloud, starts, sigmas))


def anneal_survivors(
    tracker: Tracker, cloud: Cloud, starts: Pose, sigmas: Float[Array, "S"], *, is_compiled: bool = False
) -> Pose:
    """Run `anneal_pose` from P stacked starts, of which only the best go on after every `SEGMENT` deviations; poses, best
    first.

    Most starts are poor from the beginning (successive halving, Jamieson and Talwalkar 2016). Poses are compared at the
    deviation that they have reached. The number of deviations has to be a multiple of `SEGMENT`.
    """
    poses = starts
    for number, segment in enumerate(sigmas.reshape(-1, SEGMENT)):
        if number > 0:
            count = poses.rotations.shape[0]
            poses = first_poses(poses, max(int(count * SURVIVING_SHARE), min(MIN_SURVIVORS, count)))
        compared = jnp.maximum(segment[-1], SEARCH_SIGMA)
        known = is_compiled or number > 0
        poses, _ = _sorted(*anneal_each(tracker, cloud, poses, segment, compared, is_compiled=known))
    return poses


def _sorted(poses: Pose, scores: Float[Array, "P"]) -> tuple[Pose, Float[Array, "P"]]:
    order = jnp.argsort(-scores)
    return jax.tree.map(lambda leaf: leaf[order], poses), scores[order]


def first_poses(poses: Pose, count: int) -> Pose:
    """Select the first `count` of stacked poses."""
    return jax.tree.map(lambda leaf: leaf[:count], poses)


def rotated_starts(tracker: Tracker, cloud: Cloud, pose: Pose, count: int, up: Float[Array, "3"]) -> Pose:
    """Rotate a pose about the vertical `up` in `count` equal steps and align the centres of surface and
    cloud; `(count, ...)`.

    The centre is a median, which is robust to outliers.
    """
    skeleton = tracker.body.skeleton
    posed = pose_body(tracker.body, pose)
    middle = jnp.median(posed.vertices, 0)
    points = jnp.where((cloud.weights > 0)[:, None], cloud.points, jnp.nan)
    target = jnp.nanmedian(points, 0)
    angles = jnp.linspace(0.0, 2 * jnp.pi, count, endpoint=False).astype(middle.dtype)
    # a root that only translates has its rotations in the first joint below it
    turner = next((j for j, kind in enumerate(skeleton.kinds) if kind in ("ball", "free")), None)
    mover = next((j for j, kind in enumerate(skeleton.kinds) if kind in ("translate", "free")), None)

    def turn(angle):
        rotations, translations, moved = pose.rotations, pose.translations, middle
        if turner is not None:
            q = rotation.about_axis(up, angle)
            centre = posed.joints[turner]
            moved = rotation.rotate(q, middle - centre) + centre
            rotations = rotations.at[turner].set(rotation.multiply(q, rotations[turner]))
        if mover is not None:
            translations = translations.at[mover].add((target - moved) / pose.scale)
        return Pose(translations, rotations, pose.scale)

    return jax.vmap(turn)(angles)


def perturbed_starts(
    skeleton: Skeleton, poses: Pose, count: int, deviations: Float[Array, "D"], key: PRNGKeyArray
) -> Pose:
    """Sample `count` random neighbours of each of P stacked poses, and keep the poses themselves; `(P *
    (count + 1), ...)`.
    """
    num = poses.rotations.shape[0]
    steps = deviations * jax.random.normal(key, (count, num, skeleton.num_dofs), poses.rotations.dtype)
    return _neighbours(skeleton, poses, steps)


def subtree_starts(
    skeleton: Skeleton,
    poses: Pose,
    count: int,
    deviations: Float[Array, "D"],
    key: PRNGKeyArray,
    unsupported: Float[Array, "P J"] | None = None,
) -> Pose:
    """Sample neighbours as `perturbed_starts` does, but each moves one random joint and its descendants.

    A lost limb is found again while the rest of the body stays. With the `unsupported` shares of each pose
    (`unsupported_shares`), a joint is chosen the more often the less its surface is supported.
    """
    num = poses.rotations.shape[0]
    which, how = jax.random.split(key)
    below_root = np.array(skeleton.parents) >= 0
    bearers = np.flatnonzero((skeleton.descendants.sum(1) > 1) & below_root)
    bearers = bearers if bearers.size else np.arange(skeleton.num_joints)
    shares = jnp.zeros((num, skeleton.num_joints)) if unsupported is None else unsupported
    odds = jnp.log(shares[:, bearers] + UNIFORM_SHARE)
    joints = jnp.asarray(bearers)[jax.random.categorical(which, odds, axis=1, shape=(count, num))]
    below = jnp.asarray(skeleton.descendants)[joints][..., dof_layout(skeleton).joints]
    near, far = jax.random.split(how)
    steps = deviations * jax.random.normal(near, (count, num, skeleton.num_dofs), poses.rotations.dtype)
    # some steps small, some large enough to turn a hand over
    size = 2.0 ** jax.random.uniform(far, (count, num, 1), poses.rotations.dtype, 0.0, 3.0)
    return _neighbours(skeleton, poses, jnp.where(below, size * steps, 0.0))


@eqx.filter_jit
def unsupported_shares(tracker: Tracker, poses: Pose, cloud: Cloud) -> Float[Array, "P J"]:
    """Compute, for each joint of P stacked poses, the share of the surface below it that has no point with a similar normal
    within `SUPPORT_RADIUS`.
    """
    below = jnp.asarray(tracker.body.skeleton.descendants, cloud.points.dtype)
    bones = tracker.body.skin.dominant_bones()

    def of_pose(pose):
        posed = pose_body(tracker.body, pose)
        squared = jnp.sum((posed.vertices[:, None] - cloud.points) ** 2, -1)
        supports = (cloud.weights > 0) & (posed.normals @ cloud.normals.T > tracker.mixture.normal_threshold)
        distances = jnp.min(jnp.where(supports, squared, jnp.inf), 1)
        alone = (distances > SUPPORT_RADIUS**2).astype(below.dtype)
        sums = jnp.zeros((below.shape[0], 2), below.dtype).at[bones].add(jnp.stack([alone, alone * 0 + 1], 1))
        missing, total = (below @ sums).T
        return missing / jnp.maximum(total, 1.0)

    return jax.lax.map(of_pose, poses)


def _neighbours(skeleton: Skeleton, poses: Pose, steps: Float[Array, "C P D"]) -> Pose:
    steps = jnp.concatenate([jnp.zeros_like(steps[:1]), steps])
    tiled = jax.tree.map(lambda leaf: jnp.concatenate([leaf] * len(steps)), poses)
    flat = steps.reshape(-1, skeleton.num_dofs)
    return jax.vmap(lambda pose, step: retract(skeleton, pose, step))(tiled, flat)


def coarse_tracker(tracker: Tracker) -> Tracker:
    """Reduce a tracker to fewer vertices, for searches.

    Of its further terms only those over joints are kept: vertices have other indices on the coarse body.
    """
    body = reduce_body(tracker.body, COARSE_VERTICES)
    over_joints = tuple(
        t for t in tracker.terms if isinstance(unweighted(t), JointLimits | PosePrior | RestPrior)
    )
    parts = make_part_blocks(body.skin.dominant_bones(), body.skeleton.num_joints, body.vertices)
    return eqx.tree_at(lambda t: (t.body, t.parts, t.terms), tracker, (body, parts, over_joints))


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
) -> tuple[Pose, Float[Array, ""]]:
    """Find the pose of a body in a cloud without a start: orientation about `up` and position are unknown.

    Stacked `starts` replace those at rest.

    Starts in all directions, at rest and at the mean of the tracker's pose prior if it has one, are annealed with a
    coarse body and few points; the worse ones are given up on the way (`anneal_survivors`). The best `keep` and `neighbours`
    random neighbours of each are annealed again, then in `rounds` the best with single limbs moved, mostly limbs that have
    no points. In the end the same is done with the whole body and more points, which resolve hands and feet, also with
    limbs at the mean of the prior. Returns the best of all and its mean log-likelihood.

    **Raises:** `InputError` where `up` has no direction, or where nothing is to be tried or kept.
    """
    cloud = as_cloud(cloud)
    check_direction("initialise", up=up)
    check_at_least("initialise", 1, turns=turns, keep=keep)
    check_at_least("initialise", 0, neighbours=neighbours, rounds=rounds)
    keys = jax.random.split(jax.random.key(0) if key is None else key, 3 + rounds)
    coarse = coarse_tracker(tracker) if coarse is None else coarse
    few = thin_cloud(cloud, COARSE_POINTS)
    skeleton = tracker.body.skeleton
    _LOG.info("searching for the pose in all directions")
    rest = rest_pose(skeleton)
    vertical = jnp.asarray(up, rest.rotations.dtype)
    wide = jnp.asarray(np.repeat(COARSE_SIGMAS, 2), vertical.dtype)
    fine = jnp.asarray(FINE_SIGMAS, vertical.dtype)
    if starts is None:
        standing = [rest] if tracker.pose_prior is None else [rest, mean_pose(tracker.pose_prior, skeleton)]
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
    sigmas = jnp.asarray(FINE_SIGMAS[2:], poses.rotations.dtype)
    near = anneal_survivors(coarse, few, near, sigmas[:SEGMENT], is_compiled=True)
    poses, scores = anneal_sorted(
        tracker, thin_cloud(cloud, FINE_POINTS), first_poses(near, NUM_REFINED), sigmas
    )
    return jax.tree.map(lambda leaf: leaf[0], poses), scores[0]
