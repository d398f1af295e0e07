"""All unknowns of a linearly blended body at once, by variable projection.

Without a Laplacian, vertices are independent of each other given the poses and the joints: each has
a rest place `v` and weights `w` on the simplex of its own, so that

    r(p) = sum_v  min_{w, v}  sum_m | sum_j w_j T_mj(p) v - x_m |^2

is a function of poses and joints `p` alone (Golub and Pereyra 1973). In turns, `p` moves only as far
as weights and vertices that stay let it, and learning creeps; steps on `r` know that these follow.
With `J_v` the derivatives of a vertex by `p`, and `K_v` those by its own unknowns, weights at zero
left out, Gauss-Newton's matrix is (Kaufman 1975)

    H = sum_v J_v^T (I - K_v K_v^+) J_v,    with the gradient  sum_v J_v^T (I - K_v K_v^+) e_v.

A weight leaves its bound in the inner minimum, which is found anew for every trial, so that bounds do not stop the steps.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..body.body import Body
from ..body.pose import Pose
from ..body.skin import LinearSkin
from ..body.symmetry import bones_of as paired_bones
from ..fit.alternate import alternate
from ..fit.solvers.block_arrow import BlockArrow, Unknowns
from ..fit.solvers.block_banded import BlockBanded
from ..fit.solvers.cholesky import factorise
from ..fit.solvers.descent import ConstrainedInfo, Constraints
from ..fit.solvers.equalities import Equalities
from ..fit.solvers.levenberg_marquardt import LevenbergMarquardt
from ..fit.solvers.problem import AbstractProblem
from .adapt import images, promising_bones, settle, spread_weights
from .limbs import Limbs, Tree, bone_rates, bones_of, is_simple, make_limbs, move_limbs, read_limbs
from .projected import Moves, Own, Projected, flat_bones

#: vertices that settle at once
BLOCK = 1024
#: vertices on which steps rest, about, and of each part at least
SAMPLES, LEAST = 1200, 12
#: bones that may move a vertex
NEAR = 12
#: what a joint's turn by one radian, and a centre's shift by one metre, may cost, as shares of r
STIFF_TURN, STIFF_SHIFT = 1e-2, 1.0
#: steps of the inner minimum for a trial, and before a round
INNER, OUTER = 2, 10
#: times that the bones near a vertex are chosen anew where all vertices settle
PASSES = 4
#: curvature of what does not count at all, as a share of the largest
LITTLE = 1e-9
#: what is left of directions of a vertex that depend on each other
RIDGE = 1e-6
#: conjugate gradients: the share of the right side at which they end, and steps at most
TOLERANCE, STEPS = 5e-2, 25


class Blend(eqx.Module):
    """Bones, and vertices that they blend."""

    limbs: Limbs
    weights: Float[Array, "V J"]
    rest: Float[Array, "V 3"]


class BlendProblem(AbstractProblem[Blend]):
    """Half the squares left between blended vertices and where they should be, by bones alone: a step takes the vertices with it."""

    tree: Tree
    near: Int[Array, "V K"]
    aims: Float[Array, "V N"]
    #: joints of the left and right, and the parents of each: left, parent, right, parent
    twins: Int[Array, "P 4"]
    units: Unknowns

    def value(self, y: Blend) -> Float[Array, ""]:
        return 0.5 * jnp.sum(self.errors(y) ** 2)

    def errors(self, y: Blend) -> Float[Array, "V N"]:
        """How far each vertex is from where it should be in all frames."""
        return errors_of(y, self.tree, self.aims)

    def retract(self, y: Blend, d: Unknowns) -> Blend:
        limbs = move_limbs(self.tree, y.limbs, d)
        return settle_blend(Blend(limbs, y.weights, y.rest), self.tree, self.near, self.aims, INNER)

    def scales(self) -> Unknowns:
        return self.units

    def information(self, y: Blend) -> ConstrainedInfo:
        moves = Moves(self.tree, y.limbs, spread_places(y), self.units)
        own = own_directions(self.tree, self.near, self.aims, y)
        errors = self.errors(y)
        left = own.without(errors)
        arrow = arrow_of(self.tree, y).rescaled(*self.units)
        value = 0.5 * jnp.sum(errors**2)
        none = jax.tree.map(jnp.zeros_like, self.units)
        hessian = Projected(arrow, none, moves, own, jnp.asarray(TOLERANCE, errors.dtype), jnp.asarray(STEPS))
        # what hardly counts is kept from going far
        stiff = jax.tree.map(lambda u, s: 2.0 * value * s * u**2, self.units, (STIFF_TURN, STIFF_SHIFT))
        hessian = hessian.add_diagonal(stiff)
        constraints = Constraints(equalities=self._equalities(y.limbs))
        return ConstrainedInfo(value, moves.pull(left), hessian, constraints=constraints)  # pyright: ignore[reportCallIssue]

    def _equalities(self, limbs: Limbs) -> Equalities:
        count = len(self.twins)
        differences = jnp.zeros(count, limbs.centres.dtype)
        rows = jnp.zeros((count, *limbs.centres.shape), differences.dtype)
        for (end, start), sign in ((self.twins.T[:2], 1.0), (self.twins.T[2:], -1.0)):
            bones = limbs.centres[end] - limbs.centres[start]
            lengths = jnp.linalg.norm(bones, axis=1)
            slopes = sign * bones / jnp.maximum(lengths, jnp.finfo(lengths.dtype).tiny)[:, None]
            differences = differences + sign * lengths
            rows = rows.at[jnp.arange(count), end].add(slopes).at[jnp.arange(count), start].add(-slopes)
        return Equalities(rows.reshape(count, -1) * self.units[1], -differences)


def spread_places(y: Blend) -> Float[Array, "V B"]:
    """Weigh the rest place of each vertex, and one, for every bone."""
    places = jnp.concatenate([y.rest, jnp.ones_like(y.rest[:, :1])], 1)
    return (y.weights[:, :, None] * places[:, None]).reshape(len(places), -1)


def errors_of(y: Blend, tree: Tree, aims: Float[Array, "V N"]) -> Float[Array, "V N"]:
    """Compute how far each vertex is from where it should be in all frames."""
    return jnp.matmul(spread_places(y), flat_bones(bones_of(tree, y.limbs)), precision="highest") - aims


def settle_blend(y: Blend, tree: Tree, near, aims, steps: int) -> Blend:
    """Give each vertex the weights and the rest place that are best for it."""
    weights = jnp.take_along_axis(y.weights, near, 1)
    found = settle(weights, y.rest, near, bones_of(tree, y.limbs), aims, steps)
    return Blend(y.limbs, spread_weights(found.weights, near, y.weights.shape[1]), found.rest)


def arrow_of(tree: Tree, y: Blend) -> BlockArrow:
    """Sum `J^T J` by frames: the vertices enter by the moments of what each bone counts in them."""
    spread = spread_places(y)
    moments = jnp.matmul(spread.T, spread, precision="highest")
    joints = len(tree.parents)
    width, shared = 3 * (joints + len(tree.roots)), 3 * joints
    eye = jnp.eye(width + shared, dtype=spread.dtype)

    def of_frame(limbs):
        frame = Limbs(limbs[0][None], limbs[1][None], y.limbs.centres)
        moves = jax.vmap(lambda d: bone_rates(tree, frame, (d[None, :width], d[width:]))[0])(eye)
        # (B, N) for each axis
        columns = moves.transpose(2, 1, 3, 0).reshape(3, -1, width + shared)
        with jax.default_matmul_precision("highest"):
            return jnp.einsum("abi,abj->ij", columns, moments @ columns)

    grams = jax.lax.map(of_frame, (y.limbs.turns, y.limbs.places))
    frames = BlockBanded(grams[:, None, :width, :width])
    return BlockArrow(frames, grams[:, :width, width:], jnp.sum(grams[:, width:, width:], 0))


def own_directions(tree: Tree, near, aims, y: Blend) -> Own:
    """Find the directions of each vertex by its place and by shares that bones exchange."""
    bones = bones_of(tree, y.limbs)
    weights = jnp.take_along_axis(y.weights, near, 1)
    apart = images(bones, y.rest, near) - aims[:, None]
    first = jnp.argmax(weights, 1)
    base = jnp.take_along_axis(apart, first[:, None, None], 1)
    apart = jnp.where((weights > 0)[:, :, None], apart - base, 0.0)
    turns = jnp.swapaxes(bones[..., :3], 0, 1).transpose(0, 3, 1, 2).reshape(y.weights.shape[1], -1)
    by_place = jnp.matmul(y.weights, turns, precision="highest").reshape(len(weights), 3, -1)
    rows = jnp.concatenate([by_place, apart], 1)
    rows = rows / (jnp.linalg.norm(rows, axis=2, keepdims=True) + jnp.finfo(rows.dtype).eps)
    gram = jnp.einsum("vin,vjn->vij", rows, rows, precision="highest")
    eye = jnp.eye(gram.shape[1], dtype=gram.dtype)
    inverse = jax.lax.map(lambda g: factorise(g, RIDGE).solve(eye), gram)
    return Own(rows, inverse)


class Improved(NamedTuple):
    """A body with its poses, and the squares left on all vertices, at alpha = 0, before and after."""

    body: Body
    poses: Pose
    before: float
    value: float
    damping: float


def projectable(body: Body) -> bool:
    """Tell whether `improve_all` can be used."""
    return isinstance(body.skin, LinearSkin) and is_simple(body.skeleton)


def improve_all(
    body: Body,
    poses: Pose,
    targets: Float[Array, "F V 3"],
    pairs: Int[np.ndarray, "P 2"],
    damping: float = 1e-3,
    *,
    rounds: int = 3,
    steps: int = 6,
    samples: int = SAMPLES,
    enough: float = 0.02,
) -> Improved:
    """Levenberg-Marquardt on the sum of squared distances over poses and joints, with the best
    weights and rest vertices for each: never more than before.

    **Arguments:** `poses` stacked over F frames, of scale one; `targets` the registered meshes, metres; `pairs` of
    joints whose bones stay equally long; `rounds` of `steps`, fewer where one gains less than a
    share `enough`: before each the bones that may move a vertex are chosen anew. They rest on some `samples` vertices, to which all others then adapt.

    **Raises:** `ValueError` for a skin that is not linear, and for joints that are no balls below free roots.
    """
    if not isinstance(body.skin, LinearSkin):
        raise ValueError(f"A {type(body.skin).__name__} cannot be projected; give the body a LinearSkin.")
    if not is_simple(body.skeleton):
        raise ValueError("Only ball joints below free roots can be projected; give the body such a skeleton.")
    count = body.skeleton.num_joints
    tree, limbs = make_limbs(body.skeleton, poses)
    width = len(tree.parents)
    kept = spread_vertices(np.asarray(body.skin.parts()), samples)
    shown = jnp.swapaxes(targets[:, kept], 0, 1).reshape(len(kept), -1)
    weights = jnp.pad(body.skin.influence(count), ((0, 0), (0, width - count)))
    twins = _twins(body, pairs, width)
    start = Blend(limbs, weights[kept], body.vertices[kept])
    start, _ = _settled(start, tree, shown, jnp.asarray(count))
    solver = LevenbergMarquardt(rtol=enough / 2, damping=jnp.asarray(damping, targets.dtype))

    def remake(y: Blend) -> BlendProblem:
        near, units = _prepared(y, tree, shown, jnp.asarray(count))
        return BlendProblem(tree, near, shown, twins, units)

    found = alternate(remake, start, solver, rounds=rounds, steps=steps, enough=enough)
    skeleton, there = read_limbs(body.skeleton, found.y.limbs)
    moved = eqx.tree_at(lambda b: b.skeleton, body, skeleton)
    whole, after = _adapt_body(moved, tree, found.y.limbs, targets)
    aims = jnp.swapaxes(targets, 0, 1).reshape(len(body.vertices), -1)
    left = _errors(Blend(limbs, weights, body.vertices), tree, aims)
    before = float(np.sum(np.square(np.asarray(left, float))))
    if after < before:
        return Improved(whole, there, before, after, damping)
    return Improved(body, poses, before, before, damping)


def adapt_all(body: Body, poses: Pose, targets: Float[Array, "F V 3"]) -> tuple[Body, float]:
    """Find the weights and the rest place of each vertex that are best, and the squares left."""
    tree, limbs = make_limbs(body.skeleton, poses)
    return _adapt_body(body, tree, limbs, targets)


def _adapt_body(body: Body, tree: Tree, limbs: Limbs, targets) -> tuple[Body, float]:
    count, joints = len(body.vertices), body.skeleton.num_joints
    weights = jnp.pad(body.skin.influence(joints), ((0, 0), (0, len(tree.parents) - joints)))
    aims = jnp.swapaxes(targets, 0, 1).reshape(count, -1)
    size = min(BLOCK, count)
    parts = []
    for first in range(0, count, size):
        # blocks are equally long; what is in the last one twice is cut from its head
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
def _settled(y: Blend, tree: Tree, aims, count) -> tuple[Blend, Float[Array, "V"]]:
    def again(_, y):
        return settle_blend(y, tree, _near(y, tree, aims, count), aims, OUTER)

    found = jax.lax.fori_loop(0, PASSES, again, y)
    return found, jnp.sum(errors_of(found, tree, aims) ** 2, 1)


@eqx.filter_jit
def _prepared(y: Blend, tree: Tree, aims, count) -> tuple[Int[Array, "V K"], Unknowns]:
    """The bones that may move each vertex, and units in which all numbers of a joint count alike."""

    def unit(diagonal):
        threes = diagonal.reshape(*diagonal.shape[:-1], -1, 3)
        alike = jnp.broadcast_to(jnp.mean(threes, -1, keepdims=True), threes.shape).reshape(diagonal.shape)
        return 1.0 / jnp.sqrt(alike + LITTLE * jnp.max(alike))

    x, s = arrow_of(tree, y).diagonal()
    return _near(y, tree, aims, count), (unit(x), unit(s))


def _near(y: Blend, tree: Tree, aims, count) -> Int[Array, "V K"]:
    return promising_bones(
        y.weights, y.rest, bones_of(tree, y.limbs), aims, count, min(NEAR, y.weights.shape[1])
    )


_errors = eqx.filter_jit(errors_of)


def _twins(body: Body, pairs, width: int) -> Int[Array, "P 4"]:
    parents = np.array(body.skeleton.parents)
    rows = [(a, parents[a], b, parents[b]) for a, b in paired_bones(body.skeleton, pairs).tolist()]
    return jnp.asarray(np.array(rows + [(0, 0, 0, 0)] * (width // 2 - len(rows)), np.int32))


def spread_vertices(labels: Int[np.ndarray, "V"], count: int) -> Int[np.ndarray, "S"]:
    """Choose so many of the vertices, or all, more than their share from parts that have few."""
    sizes = np.bincount(labels)
    shares = np.minimum(sizes, np.maximum(LEAST, count * np.sqrt(sizes) / np.sqrt(sizes).sum())).astype(int)
    groups = (np.flatnonzero(labels == part) for part in range(len(sizes)))
    picked = [
        group[np.linspace(0, len(group) - 1, share).round().astype(int)]
        for group, share in zip(groups, shares, strict=True)
        if share
    ]
    some = np.concatenate(picked)
    others = np.setdiff1d(np.arange(len(labels)), some)
    # always as many, so that trees of any shape share what is compiled
    missing = min(count, len(labels)) - len(some)
    if missing < 0:
        some = some[np.linspace(0, len(some) - 1, count).astype(int)]
    elif missing > 0:
        some = np.concatenate([some, others[np.linspace(0, len(others) - 1, missing).astype(int)]])
    return np.sort(some)
