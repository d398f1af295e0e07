"""Rounds of `BlendProblem` on a body with linear blend skinning."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...body.body import Body
from ...body.pose import Pose
from ...body.skin import LinearSkin
from ...body.symmetry import left_right_bones
from ...fit.alternate import alternate
from ...fit.linear_solvers.block_arrow import Unknowns
from ...fit.solvers.levenberg_marquardt import LevenbergMarquardt
from ...geometry.sampling import even_indices
from ..skeleton.limbs import (
    BoneState,
    TreeTopology,
    bone_transforms,
    has_only_ball_joints,
    make_bone_state,
    read_bone_state,
)
from ..weights.weights_and_rest import choose_candidate_bones
from .blend_problem import Blend, BlendProblem, blend_residuals, gauss_newton_matrix, optimise_blend

#: vertices sampled for the steps, and the least number from each part
SAMPLES, MIN_PART_SAMPLES = 1200, 12
#: vertices per block; a constant size avoids recompilation
BLOCK = SAMPLES
#: the number of candidate bones of a vertex
NUM_CANDIDATES = 12
#: steps of the inner minimum before a round, and updates of the candidate bones in it
INNER_STEPS, PASSES = 10, 4
#: the least curvature, as a share of the largest
MIN_CURVATURE = 1e-9


class ImprovedBody(NamedTuple):
    """A body with its poses, and the squared residual on all vertices at alpha = 0, before and after."""

    body: Body
    poses: Pose
    before: float
    value: float
    damping: float


def improve_body(
    body: Body,
    poses: Pose,
    targets: Float[Array, "F V 3"],
    pairs: Int[np.ndarray, "P 2"],
    damping: float = 1e-3,
    *,
    rounds: int = 3,
    steps: int = 6,
    samples: int = SAMPLES,
    min_decrease: float = 0.02,
) -> ImprovedBody:
    """Minimise the sum of squared distances over poses and joints, with optimal weights and rest vertices for
    each.

    Levenberg-Marquardt steps use about `samples` vertices, to which all others then adapt. The sum never
    rises.

    **Arguments:** `poses` stacked over F frames, of scale one; `targets` are the registered meshes, metres;
    `pairs` of joints whose bones stay equally long; `rounds` of `steps` steps, which end early if one gains
    less than a share `min_decrease`. The candidate bones of each vertex are updated before each round.

    **Raises:** `ValueError` for a skin that is not linear, and for joints other than balls below free roots.
    """
    if not isinstance(body.skin, LinearSkin):
        raise ValueError(f"The body has a {type(body.skin).__name__}; expected a LinearSkin.")
    if not has_only_ball_joints(body.skeleton):
        raise ValueError(
            "The skeleton has joints of other kinds; expected free roots with ball joints below them."
        )
    count = body.skeleton.num_joints
    tree, limbs = make_bone_state(body.skeleton, poses)
    width = len(tree.parents)
    kept = sample_vertices(np.asarray(body.skin.dominant_bones()), samples)
    shown = jnp.swapaxes(targets[:, kept], 0, 1).reshape(len(kept), -1)
    weights = jnp.pad(body.skin.bone_weights(count), ((0, 0), (0, width - count)))
    twins = _padded_bones(body, pairs, width)
    start = Blend(limbs, weights[kept], body.vertices[kept])
    start, _ = _settled(start, tree, shown, jnp.asarray(count))
    solver = LevenbergMarquardt(rtol=min_decrease / 2, damping=jnp.asarray(damping, targets.dtype))

    def remake(y: Blend) -> BlendProblem:
        near, units = _candidates_and_units(y, tree, shown, jnp.asarray(count))
        return BlendProblem(tree, near, shown, twins, units)

    found = alternate(remake, start, solver, rounds=rounds, steps=steps, min_gain=min_decrease)
    skeleton, improved_poses = read_bone_state(body.skeleton, found.y.bone_state)
    moved = eqx.tree_at(lambda b: b.skeleton, body, skeleton)
    whole, after = _adapt_body(moved, tree, found.y.bone_state, targets)
    aims = jnp.swapaxes(targets, 0, 1).reshape(len(body.vertices), -1)
    left = _errors(Blend(limbs, weights, body.vertices), tree, aims)
    before = float(np.sum(np.square(np.asarray(left, float))))
    if after < before:
        return ImprovedBody(whole, improved_poses, before, after, damping)
    return ImprovedBody(body, poses, before, before, damping)


def optimise_all_vertices(body: Body, poses: Pose, targets: Float[Array, "F V 3"]) -> tuple[Body, float]:
    """Optimise the weights and the rest position of each vertex; also returns the squared residual."""
    tree, limbs = make_bone_state(body.skeleton, poses)
    return _adapt_body(body, tree, limbs, targets)


def _adapt_body(body: Body, tree: TreeTopology, limbs: BoneState, targets) -> tuple[Body, float]:
    count, joints = len(body.vertices), body.skeleton.num_joints
    weights = jnp.pad(body.skin.bone_weights(joints), ((0, 0), (0, len(tree.parents) - joints)))
    aims = jnp.swapaxes(targets, 0, 1).reshape(count, -1)
    size = min(BLOCK, count)
    parts = []
    for first in range(0, count, size):
        # blocks have equal size; the overlap of the last block is dropped
        begin = min(first, count - size)
        some = slice(begin, begin + size)
        found = _settled(
            Blend(limbs, weights[some], body.vertices[some]), tree, aims[some], jnp.asarray(joints)
        )
        parts.append([leaf[first - begin :] for leaf in (found[0].weights, found[0].rest, found[1])])
    weights, rest, squares = (jnp.concatenate(leaves) for leaves in zip(*parts, strict=True))
    body = eqx.tree_at(lambda b: (b.skin, b.vertices), body, (LinearSkin(weights[:, :joints]), rest))
    return body, float(np.sum(np.asarray(squares), dtype=float))


@eqx.filter_jit
def _settled(y: Blend, tree: TreeTopology, aims, count) -> tuple[Blend, Float[Array, "V"]]:
    def again(_, y):
        return optimise_blend(y, tree, _near(y, tree, aims, count), aims, INNER_STEPS)

    found = jax.lax.fori_loop(0, PASSES, again, y)
    return found, jnp.sum(blend_residuals(found, tree, aims) ** 2, 1)


@eqx.filter_jit
def _candidates_and_units(y: Blend, tree: TreeTopology, aims, count) -> tuple[Int[Array, "V K"], Unknowns]:
    """Choose the candidate bones of each vertex, and units that equalise the curvature within each joint."""

    def unit(diagonal):
        threes = diagonal.reshape(*diagonal.shape[:-1], -1, 3)
        alike = jnp.broadcast_to(jnp.mean(threes, -1, keepdims=True), threes.shape).reshape(diagonal.shape)
        return 1.0 / jnp.sqrt(alike + MIN_CURVATURE * jnp.max(alike))

    x, s = gauss_newton_matrix(tree, y).diagonal()
    return _near(y, tree, aims, count), (unit(x), unit(s))


def _near(y: Blend, tree: TreeTopology, aims, count) -> Int[Array, "V K"]:
    return choose_candidate_bones(
        y.weights,
        y.rest,
        bone_transforms(tree, y.bone_state),
        aims,
        count,
        min(NUM_CANDIDATES, y.weights.shape[1]),
    )


_errors = eqx.filter_jit(blend_residuals)


def _padded_bones(body: Body, pairs, width: int) -> Int[Array, "P 4"]:
    rows = left_right_bones(body.skeleton, pairs)
    return jnp.asarray(np.pad(rows, ((0, width // 2 - len(rows)), (0, 0))), jnp.int32)


def sample_vertices(labels: Int[np.ndarray, "V"], count: int) -> Int[np.ndarray, "S"]:
    """Sample `count` of the vertices, or all, with more than their share from small parts."""
    sizes = np.bincount(labels)
    shares = np.minimum(
        sizes, np.maximum(MIN_PART_SAMPLES, count * np.sqrt(sizes) / np.sqrt(sizes).sum())
    ).astype(int)
    groups = (np.flatnonzero(labels == part) for part in range(len(sizes)))
    picked = [
        group[even_indices(len(group), share, nearest=True)]
        for group, share in zip(groups, shares, strict=True)
        if share
    ]
    some = np.concatenate(picked)
    others = np.setdiff1d(np.arange(len(labels)), some)
    # a constant number of vertices, so that trees of any shape share compiled code
    missing = min(count, len(labels)) - len(some)
    if missing < 0:
        some = some[even_indices(len(some), count)]
    elif missing > 0:
        some = np.concatenate([some, others[even_indices(len(others), missing)]])
    return np.sort(some)
