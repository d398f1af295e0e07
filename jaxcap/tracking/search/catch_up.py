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
from .anneal import GROUP, anneal_survivors
from .initialise import COARSE_POINTS
from .starts import subtree_starts, unsupported_shares

#: shares of the last change by which the body may have moved on
CONTINUATIONS = (0.0, 0.5, 1.0, 1.5)
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

    The body went on by one of the `CONTINUATIONS` of its last change, from the pose `before`, or one of its limbs is where the
    frame's pose has no points. Each is annealed with a coarse body, and the likeliest is tracked. This takes a tenth of the
    time of a search.
    """
    few = thin_cloud(cloud, COARSE_POINTS)
    if not float(jnp.sum(few.weights)) > 0:
        return frame
    skeleton, start = tracker.body.skeleton, before.state.estimate.pose
    starts = continued_poses(skeleton, before.state)
    here = stack_trees([frame.pose if is_finite(frame.pose) else before.trusted])
    shares = unsupported_shares(coarse, here, few)
    limbs = tangent_deviations(skeleton, 0.02, 0.4)
    moved = subtree_starts(skeleton, here, GROUP - 1, limbs, key, shares)
    sigmas = jnp.asarray(SIGMAS, start.rotations.dtype)
    poses = anneal_survivors(coarse, few, concatenate_poses([starts, moved]), sigmas)
    state = start_state(tracker, jax.tree.map(lambda leaf: leaf[0], poses))
    for sigma in REACHED_SIGMAS:
        state, statistics = track_frame_jit(tracker, reset_velocity(tracker, state, sigma), cloud)
    change = _change(skeleton, start, state.estimate.pose)
    reached = TrackState(state.estimate, change)
    found = judge_frame(surface, cloud, reached, statistics, before.baseline, frame.searches, occluders)
    return choose_better(tracker, cloud, found, frame)


@eqx.filter_jit
def continued_poses(skeleton: Skeleton, state: TrackState) -> Pose:
    """Continue the last change of a state by each of the `CONTINUATIONS`; `(4, ...)`."""
    return jax.vmap(lambda share: retract(skeleton, state.estimate.pose, share * state.change))(
        jnp.asarray(CONTINUATIONS, state.change.dtype)
    )
