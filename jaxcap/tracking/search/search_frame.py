"""Search for a frame that tracking has lost, from many starts."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from ...body.pose import Pose, concatenate_poses
from ...energy.priors.reference_pose import tangent_deviations
from ...observe import thin_cloud
from ...observe.clouds import Cloud
from ...stacking import stack_trees
from ..judge_frame import (
    SearchHistory,
    TrackedFrame,
    choose_better,
    is_finite,
    judge_frame,
    reset_velocity,
    track_frame_jit,
)
from ..judgement.baseline import Baseline
from ..judgement.region_samples import RegionSamples
from ..track_frame import Tracker, start_state
from .anneal import anneal_survivors, first_poses
from .initialise import COARSE_POINTS, FINE_SIGMAS, refine
from .prior_starts import prior_starts
from .starts import perturbed_starts, rotated_starts, subtree_starts

#: number of directions in the search for a body that jumped
NUM_JUMP_DIRECTIONS = 4


def search_frame(
    tracker: Tracker,
    surface: RegionSamples,
    coarse: Tracker,
    frame: TrackedFrame,
    baseline: Baseline,
    previous: Pose,
    cloud: Cloud,
    key: PRNGKeyArray,
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
    occluders: Float[Array, "O 4"] | None = None,
) -> TrackedFrame:
    """Search for a frame, which was compared with `baseline`, from many starts (Kineben, section 6, "global
    refinement").

    Starts are neighbours of the frame's own pose and of the last trusted one, `previous`, whole and limb by
    limb, and the latter moved to the cloud's centre and rotated about `up`, for a body that jumped. With the prior of
    people's poses, starts are also those with limbs at its mean. The
    result is used if it is likelier and its worst fault is smaller.
    """
    failed = eqx.tree_at(lambda f: f.searches, frame, frame.searches.extend())
    skeleton = tracker.body.skeleton
    few = thin_cloud(cloud, COARSE_POINTS)
    if not float(jnp.sum(few.weights)) > 0:
        return failed
    wide = tangent_deviations(skeleton, 0.05, 0.5)
    here = stack_trees([*([frame.pose] if is_finite(frame.pose) else []), previous])
    keys = jax.random.split(key, 3)
    vertical = jnp.asarray(up, previous.rotations.dtype)
    starts = [
        perturbed_starts(skeleton, here, 7, wide, keys[0]),
        subtree_starts(skeleton, here, 7, wide, keys[1]),
        rotated_starts(coarse, few, previous, NUM_JUMP_DIRECTIONS, vertical),
    ]
    if tracker.pose_prior is not None:
        starts += prior_starts(tracker.pose_prior, skeleton, here)
    sigmas = jnp.asarray(np.repeat(FINE_SIGMAS, 2), frame.pose.rotations.dtype)
    poses = anneal_survivors(coarse, few, concatenate_poses(starts), sigmas)
    pose, _ = refine(tracker, coarse, cloud, first_poses(poses, 1), 7, keys[2])
    state, _ = track_frame_jit(tracker, start_state(tracker, pose, 0.02), cloud)
    state, statistics = track_frame_jit(tracker, reset_velocity(tracker, state), cloud)
    searches = SearchHistory(0.0, frame.searches.length, frame.searches.count + 1.0)
    reached = reset_velocity(tracker, state)
    found = judge_frame(surface, cloud, reached, statistics, baseline, searches, occluders)
    if choose_better(tracker, cloud, found, frame) is frame:
        return failed
    # a better pose that is not good either keeps the pause
    return found if found.verdict == "good" else eqx.tree_at(lambda f: f.searches, found, failed.searches)
