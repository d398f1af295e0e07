"""Catch up with a body that moved farther than one frame of tracking follows: a few hypotheses, before any search."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from ...body.pose import Pose, concatenate_poses
from ...body.retraction import difference, retract
from ...body.skeleton import Skeleton
from ...energy.priors.reference_pose import tangent_deviations
from ...observe import thin_cloud
from ...observe.clouds import Cloud
from ...stacking import stack_trees
from ..judge_frame import TrackedFrame, choose_better, is_finite, judge_frame, reset_velocity, track_frame_jit
from ..judgement.region_samples import RegionSamples
from ..track_frame import Tracker, TrackState, start_state
from .anneal import anneal_survivors
from .initialise import COARSE_POINTS
from .starts import subtree_starts, unsupported_shares

#: shares of the last change by which the body may have moved on, and the number of all hypotheses
EXTRAPOLATIONS, NUM_HYPOTHESES = (0.0, 0.5, 1.0, 1.5), 8
#: standard deviations of the hypotheses, metres: from the length of a fast step to the width of a wrist
SIGMAS = (0.2, 0.15, 0.12, 0.1, 0.08, 0.06, 0.05, 0.04, 0.03, 0.02)
#: standard deviations at which the likeliest hypothesis is tracked with the whole body, metres
REACHED_SIGMAS = (0.04, 0.03, 0.02)

_change = eqx.filter_jit(difference)


def catch_up(
    tracker: Tracker,
    surface: RegionSamples,
    coarse: Tracker,
    frame: TrackedFrame,
    before: TrackedFrame,
    cloud: Cloud,
    key: PRNGKeyArray,
    occluders: Float[Array, "O 4"] | None = None,
) -> TrackedFrame:
    """Fit a frame again from a few hypotheses of a fast motion; `frame` itself if none of them is better.

    The body went on by one of the `EXTRAPOLATIONS` of its last change, from the pose `before`, or one of its limbs is not where
    the frame's pose has it, most likely one without points. Each is annealed with a coarse body, and the likeliest is tracked.
    """
    few = thin_cloud(cloud, COARSE_POINTS)
    if not float(jnp.sum(few.weights)) > 0:
        return frame
    skeleton, start = tracker.body.skeleton, before.state.estimate.pose
    # a body without a known velocity has one extrapolation only
    moves = not before.lost and bool(jnp.any(before.state.change != 0))
    starts = extrapolated_poses(skeleton, before.state) if moves else stack_trees([before.trusted])
    here = stack_trees([frame.pose if is_finite(frame.pose) else before.trusted])
    shares = unsupported_shares(coarse, here, few)
    limbs = tangent_deviations(skeleton, 0.02, 0.4)
    count = NUM_HYPOTHESES - 1 - starts.rotations.shape[0]
    moved = subtree_starts(skeleton, here, count, limbs, key, shares)
    sigmas = jnp.asarray(SIGMAS, start.rotations.dtype)
    poses = anneal_survivors(coarse, few, concatenate_poses([starts, moved]), sigmas)
    state = start_state(tracker, jax.tree.map(lambda leaf: leaf[0], poses))
    for sigma in REACHED_SIGMAS:
        # clothes are learned once a frame
        state = eqx.tree_at(
            lambda s: s.estimate.clothes, state, tracker.clothes, is_leaf=lambda leaf: leaf is None
        )
        state, statistics = track_frame_jit(tracker, reset_velocity(tracker, state, sigma), cloud)
    reached = reset_velocity(tracker, state)
    if not before.lost:
        reached = TrackState(state.estimate, _change(skeleton, start, state.estimate.pose))
    found = judge_frame(surface, cloud, reached, statistics, before.baseline, frame.searches, occluders)
    return choose_better(tracker, cloud, found, frame)


@eqx.filter_jit
def extrapolated_poses(skeleton: Skeleton, state: TrackState) -> Pose:
    """Extrapolate a state by each of the `EXTRAPOLATIONS` of its last change; `(4, ...)`."""
    return jax.vmap(lambda share: retract(skeleton, state.estimate.pose, share * state.change))(
        jnp.asarray(EXTRAPOLATIONS, state.change.dtype)
    )
