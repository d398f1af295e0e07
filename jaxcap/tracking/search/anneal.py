"""Deterministic annealing from many starts, with successive halving."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...body.pose import Pose
from ...energy.energy import Sum
from ...observe.clouds import Cloud
from ...parallel import parallel_map
from ...stacking import concatenate_trees, device_array, take_rows
from ..expectation_maximisation.em_step import Estimate, box_volume, em_step, first_step, step_statistics
from ..expectation_maximisation.subsets import whole_cloud
from ..track_frame import Tracker, first_estimate, frame_terms, penalty

#: standard deviation at which starts are compared, metres: small enough to tell the front of a trunk from its back
SEARCH_SIGMA = 0.012
#: number of starts that one call of the compiled function anneals
GROUP = 2
#: number of deviations after which poses are compared, the share of the best that go on, and their least number
SEGMENT, SURVIVING_SHARE, MIN_SURVIVORS = 5, 1 / 2, 12


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
    every = whole_cloud(cloud)

    def step(last, sigma):
        wide = eqx.tree_at(lambda s: s.after.sigma, last, sigma)
        return em_step(tracker.parts, tracker.mixture, prior, every, volume, wide), None

    estimate = first_estimate(tracker, start, sigmas[0])
    first = first_step(tracker.body, tracker.parts, tracker.mixture, every.clouds, estimate)
    judged = jnp.append(sigmas, jnp.asarray(comparison_sigma, sigmas.dtype))
    last, _ = jax.lax.scan(step, first, judged)
    statistics = step_statistics(tracker.parts, tracker.mixture, every, volume, last)
    likelihood = statistics.surface_log_likelihood - penalty(tracker, cloud, last.after.pose)
    return last.after, jnp.where(jnp.isfinite(likelihood), likelihood, -jnp.inf)


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
    groups = [take_rows(starts, row) for row in rows]
    compared = device_array(comparison_sigma, sigmas.dtype)
    found = parallel_map(
        lambda group: jax.block_until_ready(_anneal_group(tracker, cloud, group, sigmas, compared)),
        groups,
        is_compiled=is_compiled,
    )
    return take_rows(concatenate_trees(list(found)), slice(count))


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
    """Run `anneal_pose` from P stacked starts, and keep only the likeliest poses after every `SEGMENT` deviations (successive
    halving, Jamieson and Talwalkar 2016).

    Poses are compared at the last deviation of each segment, and at the end at `SEARCH_SIGMA`. The number of deviations has
    to be a multiple of `SEGMENT`. Returns the remaining poses, sorted by decreasing score.
    """
    poses = starts
    segments = np.asarray(sigmas).reshape(-1, SEGMENT)
    for number, segment in enumerate(segments):
        if number > 0:
            count = poses.rotations.shape[0]
            poses = first_poses(poses, max(int(count * SURVIVING_SHARE), min(MIN_SURVIVORS, count)))
        compared = segment[-1] if number + 1 < len(segments) else SEARCH_SIGMA
        known = is_compiled or number > 0
        poses, _ = _sorted(
            *anneal_each(tracker, cloud, poses, device_array(segment), compared, is_compiled=known)
        )
    return poses


def _sorted(poses: Pose, scores: Float[Array, "P"]) -> tuple[Pose, Float[Array, "P"]]:
    return take_rows((poses, scores), np.argsort(-np.asarray(scores), kind="stable"))


def first_poses(poses: Pose, count: int) -> Pose:
    """Select the first `count` of stacked poses."""
    return take_rows(poses, slice(count))
