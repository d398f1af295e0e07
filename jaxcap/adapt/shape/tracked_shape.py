"""Shape of a person from a sequence of clouds, tracked with a body of another shape."""

import logging
from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...arguments import checked
from ...body.body import Body, scale_body
from ...body.body_model import BodyModel, shape_from_template
from ...body.pose import Pose
from ...energy.data.cloud_extent import CloudExtent, extent_heights
from ...energy.data.points import PointToPlane, PointToPoint
from ...energy.energy import AbstractEnergy, Sum
from ...energy.priors.reference_pose import RestPrior
from ...energy.stacked import NormalPrior, Stacked
from ...errors import InputError
from ...fit.alternate import anneal_problem
from ...fit.sequences.sequence_problem import SequenceEstimate, SequenceProblem
from ...fit.sequences.unknowns import AbstractUnknown, model_coefficients
from ...fit.solvers.levenberg_marquardt import LevenbergMarquardt
from ...geometry.mesh import facet_heights
from ...geometry.sampling import even_indices
from ...observe.clouds import Cloud, stack_clouds
from ...observe.floors_and_walls import without_room
from ...stacking import stack_trees
from ...tracking.advance import FirstSearch
from ...tracking.expectation_maximisation.em_step import (
    Estimate,
    box_volume,
    e_step,
    renew_sigma,
    uniform_priors,
)
from ...tracking.search.initialise import search_size
from ...tracking.track import track_frames
from ...tracking.track_frame import (
    NUM_TESTED,
    POINTS_PER_MEASUREMENT,
    Tracker,
    partial_terms,
    replace_body,
)
from ...value_checks import check_at_least
from .shape_space import fit_coefficients, shape_space_like
from .surface_pairs import index_clouds, normal_angle, pair_frames

_LOG = logging.getLogger(__name__)

#: number of frames whose points determine the shape
NUM_FRAMES = 8
#: rounds of new correspondences, with one step each
ROUNDS = 20
#: rounds of nearest points in triangles after these, with one step each: a tangent plane of a vertex is only near the triangles
EXACT_ROUNDS = 10
#: least standard deviation of the points in the first rounds, metres: the surface of a person of another build is far away
FIRST_SIGMAS = (0.06, 0.06, 0.05, 0.05, 0.04, 0.04, 0.03, 0.03, 0.025, 0.02, 0.015)

#: least standard deviation of surface beyond the end of a cloud, metres
EXTENT_DEVIATION = 0.005


@checked
def estimate_shape(
    tracker: Tracker,
    clouds: Sequence[Cloud],
    space: BodyModel | None = None,
    *,
    num_frames: int = NUM_FRAMES,
    search: FirstSearch = True,
) -> Body:
    """Estimate the shape of a person from a short sequence of clouds, without a first pose.

    The sequence is tracked by `tracker` as it is. `num_frames` of the frames with the verdict `good` then determine the
    shape (`fit_tracked_shape`). If no frame is good, the body is of a very different build: its size is searched for in the
    first cloud (`search_size`), the sequence is tracked with a person of this size, other frames determine a first shape, and
    the sequence is tracked again with it. If no frame is good then either, as of a person in clothes, those that are
    `doubtful` determine the shape. Track the sequence anew with a tracker of the returned body.

    **Arguments:** `clouds`, consecutive frames; the more the person turns and moves in them, the more of the shape they
    show; `space`, the shape space of the tracker's body, that of `shape_space_like` where not given; `search` for the first
    pose, as in `track_frames`.

    **Raises:** `InputError` if the body is not like a human, or if all frames are lost.
    """
    check_at_least("estimate_shape", 1, num_frames=num_frames)
    clouds = list(without_room((cloud for cloud in clouds if not cloud.missing), None))
    if not clouds:
        raise InputError("estimate_shape: there are no clouds of a person; expected at least one.")
    space = find_space(tracker, space)
    first = None
    found = _track(tracker, clouds, search)
    size = search_size(tracker, clouds[0]) if search and not found["good"] else 1.0
    if size != 1:
        _LOG.info("the person is %.2f times the size of the body", size)
        body = scale_body(tracker.body, jnp.asarray(size, tracker.body.vertices.dtype))
        first = fit_coefficients(space, body)
        found = _track(replace_body(tracker, shape_from_template(space, first)), clouds, search)
    if not found["good"]:
        every = {number: pose for poses in found.values() for number, pose in poses.items()}
        body = fit_to_some(tracker, clouds, every, space, num_frames, first)
        found = _track(replace_body(tracker, body), clouds, search)
    poses = found["good"] or found["doubtful"]
    if poses:
        return fit_to_some(tracker, clouds, poses, space, num_frames, first)
    raise InputError(
        f"estimate_shape: all of {len(clouds)} frames have the verdict 'lost', so they do not show the person's shape; give "
        "other frames, or a body of about the person's height."
    )


def _track(tracker: Tracker, clouds: Sequence[Cloud], search: FirstSearch) -> dict[str, dict[int, Pose]]:
    """Track all frames; return their poses by number, of each verdict."""
    found: dict[str, dict[int, Pose]] = {"good": {}, "doubtful": {}, "lost": {}}
    for number, frame in enumerate(track_frames(tracker, clouds, search=search)):
        _LOG.info("tracking frame %d of %d for the shape of the person", number + 1, len(clouds))
        found[frame.verdict][number] = frame.pose
    return found


def fit_to_some(
    tracker: Tracker,
    clouds: Sequence[Cloud] | Mapping[int, Cloud],
    poses: dict[int, Pose],
    space: BodyModel,
    num_frames: int,
    coefficients: Float[Array, "K"] | None = None,
) -> Body:
    """Fit the shape to some of the tracked frames, evenly spread; `coefficients` as in `fit_tracked_shape`."""
    numbers = sorted(poses)
    kept = [numbers[k] for k in even_indices(len(numbers), num_frames)]
    frames = [clouds[n] for n in kept], [poses[n] for n in kept]
    return fit_tracked_shape(tracker, *frames, space, coefficients=coefficients)


@checked
def fit_tracked_shape(
    tracker: Tracker,
    clouds: Sequence[Cloud],
    poses: Sequence[Pose],
    space: BodyModel | None = None,
    rounds: int = ROUNDS,
    exact_rounds: int = EXACT_ROUNDS,
    *,
    coefficients: Float[Array, "K"] | None = None,
) -> Body:
    """Fit the shape of a person to several tracked frames, together with the poses of these.

    Each round assigns the points to the surface anew, with their standard deviation in each frame, and takes one step on
    all poses and the shape coefficients. The terms of each frame are those of the tracker: prior of people's poses,
    self-collision and free space where the tracker has them. The prior of the coefficients is normal; neighbouring points
    count as one measurement against it.

    **Arguments:** `clouds` and `poses`, of the same frames, tracked by `tracker`; `space`, the shape space of its body,
    that of `shape_space_like` where not given; `coefficients` of a first shape, relative to the template, zero where not
    given.

    **Raises:** `InputError` if the body is not like a human, or there are no frames.
    """
    if not clouds or len(clouds) != len(poses):
        raise InputError(
            f"fit_tracked_shape: there are {len(clouds)} clouds and {len(poses)} poses; expected one pose for each cloud, "
            "and at least one."
        )
    space = find_space(tracker, space)
    frames, start = stack_clouds(clouds), stack_trees(list(poses))
    unknowns: dict[str, AbstractUnknown] = {"shape": model_coefficients(space)}
    spread = coefficient_spread(space, frames)
    prior = NormalPrior("shape", -space.template_coefficients, spread)

    def problem(terms: Sequence[Stacked]) -> SequenceProblem:
        energy = Sum((*terms, RestPrior(tracker.rest_deviations)))
        return SequenceProblem(
            tracker.body, energy, jnp.arange(len(clouds), dtype=spread.dtype), unknowns, shared=(prior,)
        )

    def renew(y: SequenceEstimate, number: int) -> SequenceProblem:
        nonlocal sigmas
        _LOG.info("fitting the shape of the person, round %d of %d", number + 1, rounds)
        body = empty.body_at(y.values)
        if number < len(FIRST_SIGMAS):
            sigmas = jnp.maximum(sigmas, FIRST_SIGMAS[number])
        terms, sigmas = frame_terms(tracker, body, frames, y.poses, sigmas)
        return problem([Stacked(term) for term in terms])

    def renew_pairs(y: SequenceEstimate, number: int) -> SequenceProblem:
        nonlocal widths
        _LOG.info("fitting the shape of the person to triangles, round %d of %d", number + 1, exact_rounds)
        body = empty.body_at(y.values)
        distances, widths = pair_frames(body, y.poses, scans, widths, normal_angle(tracker))
        others = further_terms(tracker, body, frames)
        return problem([Stacked(term) for term in (distances, *others)])

    empty = problem(())
    sigmas = jnp.full(len(clouds), tracker.sigma_start, spread.dtype)
    solver = LevenbergMarquardt(rtol=0.0, atol=0.0, damping=1e-3)
    begun = empty.start(start)
    if coefficients is not None:
        low, high = (
            end if end is None else end - space.template_coefficients for end in (space.lowest, space.highest)
        )
        begun = eqx.tree_at(
            lambda y: y.values["shape"], begun, jnp.clip(coefficients.astype(spread.dtype), low, high)
        )
    found = anneal_problem(renew, begun, solver, range(rounds))
    scans, widths = index_clouds(clouds), None
    found = anneal_problem(renew_pairs, found, solver, range(exact_rounds))
    return empty.body_at(found.values)


def find_space(tracker: Tracker, space: BodyModel | None) -> BodyModel:
    """Return the given shape space, or that of the tracker's body. Raises `InputError` if there is none."""
    space = shape_space_like(tracker.body) if space is None else space
    if space is None:
        raise InputError(
            "The body is not like a human, so its shape space is unknown; give a body model, learn one from bodies with "
            "`learn_shape_space`, or fit no shape."
        )
    here, there = tracker.body, space.template
    if here.vertices.shape != there.vertices.shape or here.skeleton.names != there.skeleton.names:
        raise InputError(
            f"The body has {len(here.vertices)} vertices and {here.skeleton.num_joints} joints, and the shape space "
            f"{len(there.vertices)} and {there.skeleton.num_joints}; expected the same, of one body model (`reduce_model`)."
        )
    return space


def coefficient_spread(space: BodyModel, frames: Cloud) -> Float[Array, "K"]:
    """Compute the standard deviations of the prior of the coefficients, in residuals of the points of stacked frames."""
    total = jnp.mean(jnp.sum(frames.weights, 1))
    return jnp.full(len(space.template_coefficients), (POINTS_PER_MEASUREMENT / total) ** 0.5)


@eqx.filter_jit
def further_terms(tracker: Tracker, body: Body, clouds: Cloud) -> tuple:
    """Make the terms of each frame other than those of its points, stacked over the frames."""
    tracker = eqx.tree_at(lambda t: t.body, tracker, body)
    sigma = jnp.zeros((), body.vertices.dtype)
    return jax.lax.map(lambda cloud: jax.tree.map(jnp.asarray, _other_terms(tracker, cloud, sigma)), clouds)


def _other_terms(tracker: Tracker, cloud: Cloud, sigma: Float[Array, ""]) -> tuple[AbstractEnergy, ...]:
    """Make the terms of a frame other than those of its points.

    Points in clothes pull a larger body over themselves, whose feet or hands are beyond the cloud, where nothing pulls
    them back: an image shows it by free space, and a cloud of the whole person by its ends. These have the standard deviation
    `sigma` of the points, and at least 5 mm: the first step to a body of another size would be an extrapolation by decimetres.
    """
    terms = partial_terms(tracker, cloud)
    if cloud.views or tracker.pose_prior is not None:
        return terms
    count = len(tracker.body.vertices)
    rows = jnp.asarray(even_indices(count, NUM_TESTED), jnp.int32)
    weights = jnp.full(len(rows), 1.0 / len(rows)) * jnp.sum(cloud.weights)
    deviation = jnp.maximum(sigma, EXTENT_DEVIATION).astype(weights.dtype)
    return (*terms, CloudExtent(rows, weights, extent_heights(cloud), deviation))


@eqx.filter_jit
def frame_terms(tracker: Tracker, body: Body, clouds: Cloud, poses: Pose, sigmas: Float[Array, "F"]):
    """Assign the points of each frame to the surface, and make the frame's terms and its new standard deviation."""
    tracker = eqx.tree_at(lambda t: t.body, tracker, body)

    def of_frame(frame):
        cloud, pose, sigma = frame
        estimate = Estimate(pose, sigma, uniform_priors(tracker.parts, sigma.dtype))
        posed, found = e_step(body, tracker.parts, tracker.mixture, cloud, box_volume(cloud), estimate)
        shares = cloud.weights[:, None] * found.weights
        renewed = renew_sigma(tracker.mixture, found, found.squared_distances, cloud, sigma)
        vertices, weights = found.vertices.reshape(-1), (shares / sigma**2).reshape(-1)
        points = jnp.repeat(cloud.points, found.weights.shape[1], axis=0)
        # points are on the triangles, which lie inside of the tangent planes of a convex surface
        heights = facet_heights(posed.vertices, body.faces, posed.normals)
        lifted = points - (heights[:, None] * posed.normals)[vertices]
        along = tracker.mixture.tangential_weight
        terms = (
            PointToPlane(vertices, lifted, posed.normals[vertices], (1.0 - along) * weights),
            PointToPoint(vertices, points, along * weights),
            *_other_terms(tracker, cloud, sigma),
        )
        # constants of a term, such as those of a prior, are repeated for each frame
        return jax.tree.map(jnp.asarray, terms), renewed

    return jax.lax.map(of_frame, (clouds, poses, sigmas))
