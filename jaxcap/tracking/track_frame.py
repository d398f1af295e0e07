"""Tracking of a body through a sequence of clouds, each frame from the previous one."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from equinox.internal import unvmap_any
from jaxtyping import Array, Bool, Float

from ..arguments import check_fields, checked
from ..body.body import Body, pose_body
from ..body.people.anatomy import rest_deviations
from ..body.pose import Pose
from ..body.retraction import difference, retract
from ..energy.check_energies import UserTerms, sum_user_terms
from ..energy.data.free_space import FreeSpace
from ..energy.energy import AbstractEnergy, Sum, terms_of, weighted
from ..energy.priors.flexion_limits import human_flexion_limits
from ..energy.priors.gaussian_pose_prior import GaussianPrior
from ..energy.priors.human_prior import human_prior
from ..energy.priors.joint_limits import JointLimits
from ..energy.priors.reference_pose import PosePrior, RestPrior, tangent_deviations
from ..energy.priors.self_collision import SelfCollision, make_self_collision
from ..fit.correspondence.part_blocks import PartBlocks, make_part_blocks
from ..observe.clouds import Cloud
from ..stacking import device_array
from ..value_checks import as_number, check_at_least, check_deviations, check_positive, check_values
from .expectation_maximisation.clothes import Clothes, first_clothes
from .expectation_maximisation.em_step import (
    Estimate,
    FrameStatistics,
    MixtureSettings,
    Step,
    box_volume,
    em_step,
    first_step,
    make_mixture_settings,
    step_statistics,
    uniform_priors,
)
from .expectation_maximisation.learn_clothes import update_clothes
from .expectation_maximisation.subsets import Subsets, divide_cloud, first_subset
from .judgement.region_samples import region_joints

#: steps of expectation maximisation per frame, and the same where a body is seen in part and priors decide
ITERATIONS, PARTIAL_ITERATIONS = 4, 6
#: movement of a vertex in a step above which a frame takes further ones: metres, and standard deviations of the points, as
#: loose clothes move the surface by about as much in every frame
MOVEMENT_TOLERANCE, MOVEMENT_DEVIATIONS = 0.02, 2.0
#: largest number of steps of a frame that shows the whole body, relative to the usual one
MAX_ITERATIONS_FACTOR = 3
#: share of the subsets of a cloud that the last step uses, rounded up
LAST_SHARE = 0.75
#: number of points that count as one independent measurement against the prior of people, as the errors of
#: neighbouring points are alike
POINTS_PER_MEASUREMENT = 180.0
#: number of vertices that are tested for free space; their weight relative to the points'; and the standard deviation
#: of a violation, metres
NUM_TESTED, FREE_SPACE_WEIGHT, FREE_SPACE_DEVIATION = 1500, 0.8, 0.02
#: weight of a depth of one standard deviation inside of another part of the body, for each point of a cloud
COLLISION_WEIGHT = 1e-2
#: weight of a flexion of one radian beyond its range, for each point of a cloud
FLEXION_WEIGHT = 2.0
#: largest initial standard deviation in metres: larger ones are in another unit
MAX_SIGMA = 5.0


class Tracker(eqx.Module):
    """The constants of a tracked sequence."""

    body: Body
    parts: PartBlocks
    mixture: MixtureSettings
    #: standard deviations of a pose from its prediction, metres and radians
    motion_deviations: Float[Array, "D"]
    #: standard deviations of joints from rest in their own frames, for coordinates that a cloud does not
    #: determine
    rest_deviations: Float[Array, "J 3"]
    #: of bodies that are seen in part: the prior of people's poses, and limbs inside of other parts
    pose_prior: GaussianPrior | None
    collision: SelfCollision | None
    #: of a person's knees and elbows, which do not bend backwards
    flexion_limits: JointLimits | None
    #: share of the last change in the prediction of a frame
    momentum: Float[Array, ""]
    #: factor on the last frame's sigma at the start of a frame, and its least value in metres
    sigma_growth: Float[Array, ""]
    sigma_start: Float[Array, ""]
    #: further terms, such as `JointLimits`
    terms: tuple[AbstractEnergy, ...]
    #: steps of expectation maximisation per frame, and the largest number of them while the surface still moves far
    iterations: int = eqx.field(static=True)
    max_iterations: int = eqx.field(static=True)
    #: joints of the regions of verdicts, as of `region_joints`
    regions: tuple[int, ...] = eqx.field(static=True)
    #: largest number of vertices that are tested for free space
    num_tested: int = eqx.field(static=True, default=NUM_TESTED)
    #: clothes at the start of a frame without a frame before it; None where clothes are not modelled
    clothes: Clothes | None = None

    def __check_init__(self):
        check_fields(self)


class TrackState(eqx.Module):
    """The state passed from frame to frame."""

    estimate: Estimate
    #: change of the pose over the last frame
    change: Float[Array, "D"]


@checked
def make_tracker(
    body: Body,
    mixture: MixtureSettings | None = None,
    terms: UserTerms = (),
    *,
    motion_deviation: tuple[float, float] = (0.05, 0.3),
    rest_deviation: float = 1.0,
    momentum: float = 1.0,
    sigma_growth: float = 1.5,
    sigma_start: float = 0.015,
    iterations: int | None = None,
    max_iterations: int | None = None,
    partial: bool = False,
    num_tested: int = NUM_TESTED,
    clothes: bool = False,
) -> Tracker:
    """Make a `Tracker` for a body.

    **Arguments:** `motion_deviation` standard deviations of a frame from its prediction, metres for the root
    and radians for joints; `rest_deviation` in radians, standard deviation from rest of joints without known
    anatomy (`body.people.anatomy`); `partial`, the clouds show a part of the body, as those of one depth camera
    do: a body whose joints have names of a person's then has the prior of people's poses (`human_prior`) and the ranges of knees
    and elbows (`human_flexion_limits`), and the embedded human
    keeps its limbs out of other parts (`make_self_collision`), which costs some accuracy where everything is seen;
    `iterations`, steps of expectation maximisation per frame, 4 by default, or 6 with `partial`; all but the last use a
    small subset of the points of a large cloud (`divide_cloud`);
    `max_iterations`, the largest number of steps where the prediction is far off, as in fast motions, by default three times
    `iterations`, or as many with `partial`: further steps follow, unless `iterations` is one, while each of them moves a vertex by
    more than 20 mm and by more than two standard deviations of the points;
    `num_tested`, the largest number of vertices that are tested for free space; `clothes`, learn which parts wear loose
    clothes, such as a skirt, so that these neither drag the body nor count as unexplained (`Clothes`), best with `partial`;
    `terms` are further energies, in units of a log-likelihood.

    **Raises:** `InputError` for a number that is out of its range, and for terms that do not fit the body.
    """
    where = "make_tracker"
    check_deviations(where, motion_deviation=motion_deviation, rest_deviation=rest_deviation)
    check_at_least(where, 0, momentum=momentum)
    check_positive(where, sigma_growth=sigma_growth)
    check_positive(where, "metres", sigma_start=sigma_start)
    default = PARTIAL_ITERATIONS if partial else ITERATIONS
    iterations = default if iterations is None else iterations
    factor = 1 if partial else MAX_ITERATIONS_FACTOR
    max_iterations = factor * iterations if max_iterations is None else max_iterations
    check_at_least(where, 1, iterations=iterations, num_tested=num_tested)
    check_at_least(where, iterations, max_iterations=max_iterations)
    own = sum_user_terms(where, terms, body)
    bones = body.skin.dominant_bones()
    worn = first_clothes(body, body.skeleton.num_joints) if clothes else None
    return Tracker(
        body=body,
        parts=make_part_blocks(bones, body.skeleton.num_joints, body.vertices),
        mixture=make_mixture_settings() if mixture is None else mixture,
        motion_deviations=tangent_deviations(body.skeleton, *motion_deviation),
        rest_deviations=jnp.asarray(rest_deviations(body.skeleton, rest_deviation), body.vertices.dtype),
        pose_prior=human_prior(body.skeleton) if partial else None,
        collision=make_self_collision(body) if partial else None,
        flexion_limits=human_flexion_limits(body.skeleton) if partial else None,
        momentum=as_number(momentum),
        sigma_growth=as_number(sigma_growth),
        sigma_start=as_number(sigma_start),
        terms=() if own is None else terms_of(own),
        iterations=iterations,
        max_iterations=max_iterations,
        num_tested=num_tested,
        regions=region_joints(body),
        clothes=worn,
    )


def replace_body(tracker: Tracker, body: Body) -> Tracker:
    """Replace the body of a tracker by one of another shape, with the same skeleton and triangles."""
    parts = make_part_blocks(body.skin.dominant_bones(), body.skeleton.num_joints, body.vertices)
    collision = None if tracker.collision is None else make_self_collision(body)
    return eqx.tree_at(
        lambda t: (t.body, t.parts, t.collision),
        tracker,
        (body, parts, collision),
        is_leaf=lambda leaf: leaf is None,
    )


def check_sigma(where: str, sigma: float | Float[Array, ""]) -> None:
    """Check that an initial standard deviation is in metres: above 0 and at most `MAX_SIGMA`.

    **Raises:** `InputError`.
    """
    expected = f"a deviation above 0 and at most {MAX_SIGMA:g} metres"
    check_values(where, lambda x: (x > 0) & (x <= MAX_SIGMA), expected, sigma=sigma)


@checked
def start_state(tracker: Tracker, pose: Pose, sigma: float | Float[Array, ""] = 0.05) -> TrackState:
    """Make the state before the first frame, at a pose near it and with Kineben's `sigma0`, metres."""
    check_sigma("start_state", sigma)
    estimate = first_estimate(tracker, pose, jnp.asarray(sigma, pose.rotations.dtype))
    return TrackState(estimate, device_array(np.zeros(tracker.body.skeleton.num_dofs), pose.rotations.dtype))


def first_estimate(tracker: Tracker, pose: Pose, sigma: Float[Array, ""]) -> Estimate:
    """Make the estimate at a pose without a frame before it."""
    return Estimate(pose, sigma, uniform_priors(tracker.parts, pose.rotations.dtype), tracker.clothes)


def with_clothes(tracker: Tracker, clothes: Clothes | None) -> Tracker:
    """Give a tracker the clothes that the frames so far have shown, for searches and comparisons of poses."""
    if tracker.clothes is clothes:
        return tracker
    return eqx.tree_at(lambda t: t.clothes, tracker, clothes, is_leaf=lambda leaf: leaf is None)


def frame_terms(tracker: Tracker, cloud: Cloud) -> tuple[AbstractEnergy, ...]:
    """Return the terms of a frame besides its points."""
    return (RestPrior(tracker.rest_deviations), *tracker.terms, *partial_terms(tracker, cloud))


def partial_terms(tracker: Tracker, cloud: Cloud) -> tuple[AbstractEnergy, ...]:
    """Return the terms that determine unobserved joints: pose prior, limits, self-collision, and free space."""
    total, terms = jnp.sum(cloud.weights), []
    if tracker.pose_prior is not None:
        terms.append(weighted(total / POINTS_PER_MEASUREMENT, tracker.pose_prior))
    if tracker.flexion_limits is not None:
        terms.append(weighted(FLEXION_WEIGHT * total, tracker.flexion_limits))
    if tracker.collision is not None:
        terms.append(weighted(COLLISION_WEIGHT * total, tracker.collision))
    if cloud.views:
        count = len(tracker.body.vertices)
        rows = jnp.linspace(0, count - 1, min(tracker.num_tested, count)).astype(jnp.int32)
        weights = jnp.full(len(rows), FREE_SPACE_WEIGHT / len(rows)) * total / len(cloud.views)
        deviation = jnp.asarray(FREE_SPACE_DEVIATION)
        terms += [FreeSpace(rows, weights, view, deviation) for view in cloud.views]
    return tuple(terms)


def penalty(tracker: Tracker, cloud: Cloud, pose: Pose) -> Float[Array, ""]:
    """Compute half the energy of the tracker's own terms and of `partial_terms` for each point of the cloud.

    Subtracted from the mean log-likelihood of the points it compares poses by their posterior density.
    """
    terms, total = (*tracker.terms, *partial_terms(tracker, cloud)), jnp.sum(cloud.weights)
    if not terms:
        return jnp.zeros((), total.dtype)
    r = Sum(terms).residual(pose_body(tracker.body, pose))
    return 0.5 * jnp.sum(r * r) / jnp.maximum(total, 1.0)


def predict_pose(tracker: Tracker, state: TrackState) -> Pose:
    """Predict the pose of the next frame: a share of the last change, once more."""
    return retract(tracker.body.skeleton, state.estimate.pose, tracker.momentum * state.change)


def first_sigma(tracker: Tracker, state: TrackState) -> Float[Array, ""]:
    """Compute the standard deviation at which the next frame starts, metres."""
    return jnp.maximum(tracker.sigma_growth * state.estimate.sigma, tracker.sigma_start)


def moves_far(step: Step) -> Bool[Array, ""]:
    """Decide if a step has moved the surface so far that further ones are needed; not where numbers are not finite."""
    limit = jnp.maximum(MOVEMENT_TOLERANCE, MOVEMENT_DEVIATIONS * step.after.sigma)
    return step.largest_movement() > limit


@checked
def track_frame(tracker: Tracker, state: TrackState, cloud: Cloud) -> tuple[TrackState, FrameStatistics]:
    """Track one frame: predict it, take a few steps of expectation maximisation, and compute statistics.

    Each step but the last uses another subset of the points (`divide_cloud`), and the last one several: more steps then take
    less time, and correct a larger error of the prediction. While a step moves the surface far, further ones follow. Their number is
    constant for derivatives.

    Pure, and of the form of a `jax.lax.scan` step once `tracker` is bound.
    """
    skeleton, before = tracker.body.skeleton, state.estimate
    predicted = predict_pose(tracker, state)
    prior = Sum((PosePrior(predicted, tracker.motion_deviations), *frame_terms(tracker, cloud)))
    volume = box_volume(cloud)
    sigma = first_sigma(tracker, state)

    clouds, count = divide_cloud(cloud), tracker.max_iterations if tracker.iterations > 1 else 1
    number = len(clouds.weights)
    most = math.ceil(LAST_SHARE * number) if count > 1 else number

    def step(iteration, carry):
        taken, last = carry
        is_last = iteration == count - 1
        is_needed = (iteration < tracker.iterations - 1) | is_last | moves_far(last)

        def take(last):
            # the last step leaves out the points of the steps just before it, which would count more than the others
            some = first_subset(Subsets(clouds, jnp.where(is_last, most, 1)), taken)
            found = em_step(tracker.parts, tracker.mixture, prior, some, volume, last)
            found = jax.tree.map(lambda new, old: jnp.where(is_needed, new, old), found, last)
            return eqx.tree_at(
                lambda s: (s.posed.body, s.moved.body), found, (last.posed.body, last.moved.body)
            )

        # in a batch, as long as one member needs the step
        return taken + is_needed, jax.lax.cond(unvmap_any(is_needed), take, lambda last: last, last)

    start = Estimate(predicted, sigma, before.priors, before.clothes)
    first = first_step(tracker.body, tracker.parts, tracker.mixture, clouds, start)
    taken, last = jax.lax.fori_loop(0, count, step, (0, first))
    used = first_subset(Subsets(clouds, most), taken - 1)
    statistics = step_statistics(tracker.parts, tracker.mixture, used, volume, last)
    estimate = last.after
    if before.clothes is not None:
        clothes = update_clothes(before.clothes, last.found, last.moved, used.cloud(), last.before.sigma)
        estimate = Estimate(estimate.pose, estimate.sigma, estimate.priors, clothes)
    return TrackState(estimate, difference(skeleton, before.pose, estimate.pose)), statistics
