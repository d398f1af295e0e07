"""Comparison of the person in each scan with those in the other scans, after an adaptation to all of them."""

from itertools import combinations

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree

from ..arguments import checked
from ..body.body import Body
from ..body.people.anatomy import without_side
from ..body.pose import Pose
from ..body.shape_modes import ShapeModes
from ..energy.data.pairs import stack_pairs
from ..fit.correspondence.nearest_assignment import IndexedScan
from ..geometry.mesh import vertex_normals
from ..parallel import parallel_map
from ..stacking import stack_trees, unstack_trees
from .adapt_round import TANGENTIAL_WEIGHT, gauss_newton_step
from .objective import CoefficientPrior, shared_problem
from .poses.fit_frame import pairs_of
from .poses.select_frames import select_evenly
from .task import AdaptState, AdaptTask, OtherPerson

#: number of scans that are compared, evenly spaced: of scans without an order in time, and of a sequence, which is rarely of
#: several people
NUM_COMPARED, NUM_OF_SEQUENCE = 60, 16
#: rounds of a scan's own pose and coefficients
NUM_ROUNDS = 6
#: standard deviation of a scan's coefficients from those of the adapted body
COEFFICIENT_DEVIATION = 0.3
#: number of parts that are named with their differences
NUM_NAMED = 3

#: joints without their sides, and the least mean distance between the surfaces of two people there, metres. Those of one person
#: differ by up to half of it between poses
SURFACES: dict[str, tuple[tuple[str, ...], float]] = {
    "chest": (("Spine", "Spine1"), 0.006),
    "pelvis": (("Hips", "LowerBack", "LHipJoint", "RHipJoint"), 0.006),
    "upper arms": (("Arm",), 0.005),
    "forearms": (("ForeArm",), 0.002),
    "thighs": (("UpLeg",), 0.004),
    "shanks": (("Leg",), 0.0025),
}
#: if the scans of one person differ less, a smaller limit holds: this multiple of the median distance of a scan from its nearest
#: group, and at least this share
LINK_FACTOR, MIN_LIMIT = 4.0, 0.4
#: with this smaller limit, scans whose poses differ from the others by more than this multiple of the links between their own poses
#: are not of another person
POSE_FACTOR = 1.5


@checked
def compare_people(task: AdaptTask, state: AdaptState) -> tuple[OtherPerson, ...]:
    """Find scans whose person differs from the person in most of the scans, although one body was adapted to all of them.

    A few rounds fit coefficients of the shape space, and the pose, to each scan alone, from the adapted body. What is missing
    in this body, or in the shape space, is the same in all scans. Around a limb the mean shift of the surface along its normals
    is a change of the radius, which does not depend on the position of the limb. Scans are linked by their mean shifts
    (`group_people`). At most `NUM_COMPARED` scans are compared, `NUM_OF_SEQUENCE` of a sequence in time, and none that are lost. Nothing is compared if the template
    has no shape space, or no joints with the names of the human's.
    """
    there = [frame for frame in task.scanned if frame not in state.lost]
    most = NUM_COMPARED if task.settings.unordered else NUM_OF_SEQUENCE
    frames, space = select_evenly(there, most), task.shape_space
    parts = surface_parts(state.body)
    if space is None or len(frames) < 2 or not parts:
        return ()
    modes = space.modes

    def fit(item: tuple[int, IndexedScan]) -> Float[np.ndarray, "K"]:
        return _fit_alone(task, state, modes, *item)

    coefficients = list(parallel_map(fit, ((frame, task.scan(frame)) for frame in frames)))
    shifts = np.stack(coefficients) @ _mean_shifts(state.body, modes, list(parts.values()))
    finite = np.flatnonzero(np.isfinite(shifts).all(1))
    frames, shifts = [frames[row] for row in finite], shifts[finite]
    if len(frames) < 2:
        return ()
    limits = np.array([SURFACES[name][1] for name in parts])
    first, *others = group_people(shifts / limits, pose_distances(state.motion.poses, frames))
    found = []
    for group in others:
        differences = np.median(shifts[group], 0) - np.median(shifts[first], 0)
        shares = np.abs(differences / limits)
        order = [
            n for n in np.argsort(-shares)[:NUM_NAMED] if shares[n] > MIN_LIMIT / 2 or n == np.argmax(shares)
        ]
        named = tuple((list(parts)[n], float(differences[n])) for n in order)
        found.append(OtherPerson(tuple(frames[row] for row in group), named, len(frames)))
    return tuple(found)


def group_people(values: Float[np.ndarray, "F M"], poses: Float[np.ndarray, "F F"]) -> list[list[int]]:
    """Group rows that differ by less than a limit, or that others link, and return the groups, the largest first.

    A distance is the largest one over the columns, and two people differ by more than one. If most scans differ less from the
    nearest ones, people differ by `LINK_FACTOR` times the median link of the minimum spanning tree. In this case the differences
    must not come from poses, between which `poses` are the distances: two groups are of one person if all poses of one
    are farther from those of the other than `POSE_FACTOR` times the links within both.
    """
    distances = np.abs(values[:, None] - values[None]).max(-1)
    limit = np.clip(LINK_FACTOR * np.median(_links(distances)), MIN_LIMIT, 1.0)
    groups = _linked_rows(distances < limit)
    reach = [_links(poses[np.ix_(group, group)]).max(initial=0.0) for group in groups]
    same = np.eye(len(groups), dtype=bool)
    for one, two in combinations(range(len(groups)), 2):
        across = np.ix_(groups[one], groups[two])
        other_poses = poses[across].min() > POSE_FACTOR * max(reach[one], reach[two])
        same[one, two] = other_poses and distances[across].min() < 1
    people = [[row for group in own for row in groups[group]] for own in _linked_rows(same)]
    return sorted(map(sorted, people), key=len, reverse=True)


def _links(distances: Float[np.ndarray, "F F"]) -> Float[np.ndarray, "L"]:
    """Compute the lengths of the links of the minimum spanning tree."""
    # a link of length zero counts as none
    return minimum_spanning_tree(np.maximum(distances, 1e-9)).data


def _linked_rows(linked: Bool[np.ndarray, "F F"]) -> list[list[int]]:
    """List the rows of each connected component."""
    count, labels = connected_components(linked, directed=False)
    return [np.flatnonzero(labels == label).tolist() for label in range(count)]


def pose_distances(poses: Pose, frames: list[int]) -> Float[np.ndarray, "F F"]:
    """Compute the distances of some of stacked poses, root mean squares of the joints' angles without the root's, radians."""
    turns = np.asarray(poses.rotations, float)[frames, 1:]
    cosines = np.abs(np.einsum("fjk,gjk->fgj", turns, turns))
    return np.sqrt(np.mean((2 * np.arccos(np.minimum(cosines, 1.0))) ** 2, -1))


def surface_parts(body: Body) -> dict[str, Bool[np.ndarray, "V"]]:
    """Find the vertices of each part of `SURFACES` that the body has, by the joints that move them most."""
    names = [without_side(name) for name in body.skeleton.names]
    bones = np.asarray(body.skin.dominant_bones())
    parts = {
        part: np.isin(bones, [row for row, name in enumerate(names) if name in joints])
        for part, (joints, _) in SURFACES.items()
    }
    return {part: own for part, own in parts.items() if own.any()}


def _mean_shifts(
    body: Body, modes: ShapeModes, parts: list[Bool[np.ndarray, "V"]]
) -> Float[np.ndarray, "K M"]:
    """Compute the mean shift of each part along the normals, metres, for a coefficient of one of each mode."""
    normals = np.asarray(vertex_normals(body.vertices, body.faces), float)
    moved = np.asarray(modes.vertices, float)
    shifts = np.sum((moved - moved.mean(1, keepdims=True)) * normals, -1)
    return np.stack([shifts[:, own].mean(1) for own in parts], 1)


def _fit_alone(
    task: AdaptTask, state: AdaptState, modes: ShapeModes, frame: int, scan: IndexedScan
) -> Float[np.ndarray, "K"]:
    """Fit shape coefficients and the pose of one frame to its scan, from the adapted body."""
    pose, dtype = state.motion[frame], state.body.vertices.dtype
    coefficients = jnp.zeros(len(modes.vertices), dtype)
    deviations = jnp.full_like(coefficients, COEFFICIENT_DEVIATION)
    weight, pair_deviation = (
        jnp.asarray(x, dtype) for x in (state.pose_weight, task.settings.pair_deviation)
    )
    body = state.body
    for _ in range(NUM_ROUNDS):
        pairs = stack_pairs([pairs_of(body, pose, scan, task.settings.matching, task.cameras)])
        along = jnp.minimum(pairs.tangential_weights, TANGENTIAL_WEIGHT)
        pairs = eqx.tree_at(lambda p: p.tangential_weights, pairs, along)
        prior = CoefficientPrior(-coefficients, deviations)
        problem = shared_problem(body, pairs, task.pose_terms(weight), modes, prior, (), pair_deviation)
        body, poses, step = gauss_newton_step(problem, stack_trees([pose]))
        (pose,), coefficients = unstack_trees(poses, 1), coefficients + step
    return np.asarray(coefficients, float)
