"""All unknowns of a linearly blended body at once, by variable projection.

Without a Laplacian, vertices are independent of each other given the poses and the joints: each has
a rest place `v` and weights `w` on the simplex of its own, so that

    r(p) = sum_v  min_{w, v}  sum_m | sum_j w_j T_mj(p) v - x_m |^2

is a function of poses and joints `p` alone (Golub and Pereyra 1973). In turns, `p` moves only as far
as weights and vertices that stay let it, and learning creeps; steps on `r` know that these follow.
With `J_v` the derivatives of a vertex by `p`, and `K_v` those by its own unknowns, weights at zero
left out, Gauss-Newton's matrix is (Kaufman 1975)

    H = sum_v J_v^T (I - K_v K_v^+) J_v,    with the gradient  sum_v J_v^T e_v  as it was.

The first part is an arrow, the second joins all frames, in as many ranks as vertices have unknowns:
H is dense. A weight leaves its bound in the inner minimum, which is found anew for every trial, so
that bounds do not stop the steps.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Array, Float, Int

from ..body.body import Body, deform_all, take_vertices
from ..body.kinematics import Transforms, forward_kinematics
from ..body.pose import Pose, retract
from ..body.rates import joint_rates, pose_rates, stack_rates, take_rates
from ..body.skeleton import Skeleton, dof_layout
from ..body.skin import LinearSkin
from ..body.symmetry import length_differences
from .adapt import adapt, images
from .hang import all_bones
from .joints import move_joints, shared_slots

#: vertices on which steps rest, about, and of each part at least
SAMPLES, LEAST = 800, 12
#: unknowns of poses and joints, at most: their matrix is dense
MOST = 9000
#: what a joint's turn by one radian, and a centre's shift by one metre, may cost, as shares of r
STIFF_TURN, STIFF_SHIFT = 1e-2, 1.0
#: steps of the inner minimum, at most, for a trial
INNER = 6
#: rows of one block of derivatives
ROWS = 4096
#: squared singular values of a vertex's own directions, as shares of the largest, that count as zero
NULL = 1e-6


class Projected(NamedTuple):
    """A body with its poses, and the squares left on all vertices, at alpha = 0, before and after."""

    body: Body
    poses: Pose
    before: float
    value: float
    damping: float


def projectable(body: Body, frames: int) -> bool:
    """Whether `improve_all` can be used."""
    return isinstance(body.skin, LinearSkin) and _unknowns(body, frames) <= MOST


def improve_all(
    body: Body,
    poses: Pose,
    targets: Float[Array, "F V 3"],
    pairs: Int[np.ndarray, "P 2"],
    damping: float = 1e-3,
    *,
    steps: int = 14,
    samples: int = SAMPLES,
    enough: float = 0.02,
    tries: int = 6,
) -> Projected:
    """Levenberg-Marquardt on the sum of squared distances over poses and joints, with the best
    weights and rest vertices for each: never more than before.

    **Arguments:** `poses` stacked over F frames; `targets` the registered meshes, metres; `pairs` of
    joints whose bones stay equally long; `steps` at most, fewer where two in a row gain less than a
    share `enough`; they rest on some `samples` vertices, to which all others then adapt.

    **Raises:** `ValueError` for a skin that is not linear, and for more unknowns than fit a dense matrix.
    """
    slots, unknowns = shared_slots(body), _unknowns(body, len(targets))
    if not isinstance(body.skin, LinearSkin):
        raise ValueError(f"A {type(body.skin).__name__} cannot be projected; give the body a LinearSkin.")
    if unknowns > MOST:
        raise ValueError(f"{unknowns} unknowns of poses and joints are more than {MOST}; give fewer meshes.")
    start = _squares(body, poses, targets)
    kept = jnp.asarray(spread_vertices(np.asarray(body.skin.parts()), samples))
    some = take_vertices(body, kept)
    shown = targets[:, kept]
    bones = all_bones(body.skeleton, poses)
    some, value = adapt(some, bones, shown)
    moved, idle = poses, 0
    for _ in range(steps):
        matrix, side, measure = _equations(some, moved, bones, shown, slots)
        before = value
        for _ in range(tries):
            # beside Marquardt's shares, what hardly counts is kept from going far
            raised = damping * measure.shares + value * measure.stiffness
            step = _solve(matrix, side, raised, some.skeleton, pairs, slots)
            if step is not None:
                skeleton, there = _move(some.skeleton, moved, *_cut(step, shown, body.skeleton), slots)
                trial_bones = all_bones(skeleton, there)
                trial = eqx.tree_at(lambda b: b.skeleton, some, skeleton)
                trial, trial_value = adapt(trial, trial_bones, shown, INNER)
                if trial_value < value:
                    expected = float(side @ step + raised @ step**2)
                    gain = (value - trial_value) / expected
                    some, moved, bones, value = trial, there, trial_bones, trial_value
                    damping = max(damping * _relief(gain), 1e-7)
                    break
            damping = max(5.0 * damping, 1e-6)
        # a step may gain little and lead to one that gains much
        idle = idle + 1 if value > (1 - enough) * before else 0
        if idle == 2 or value == before:
            break
    whole = eqx.tree_at(lambda b: b.skeleton, body, some.skeleton)
    whole, value = adapt(whole, bones, targets)
    if value < start:
        return Projected(whole, moved, start, value, damping)
    return Projected(body, poses, start, start, damping)


def _unknowns(body: Body, frames: int) -> int:
    return frames * body.skeleton.num_dofs + len(shared_slots(body))


def _relief(gain: float) -> float:
    """What damping is multiplied by, after the share of the expected fall that came true."""
    return 0.2 if gain > 0.7 else 0.5 if gain > 0.4 else 1.0 if gain > 0.2 else 3.0


def spread_vertices(labels: Int[np.ndarray, "V"], count: int) -> Int[np.ndarray, "S"]:
    """About `count` of the vertices, more than their share from parts that have few."""
    sizes = np.bincount(labels)
    shares = np.minimum(sizes, np.maximum(LEAST, count * np.sqrt(sizes) / np.sqrt(sizes).sum())).astype(int)
    groups = (np.flatnonzero(labels == part) for part in range(len(sizes)))
    picked = [
        group[np.linspace(0, len(group) - 1, share).round().astype(int)]
        for group, share in zip(groups, shares, strict=True)
        if share
    ]
    return np.sort(np.concatenate(picked))


def _squares(body: Body, poses: Pose, targets) -> float:
    return float(np.sum(np.square(np.asarray(deform_all(body, poses) - targets, float))))


class _Measure(NamedTuple):
    """What damping counts each unknown by: alike for all numbers of a joint, so that an axis along
    which its motion tells nothing stays where it is."""

    shares: Float[np.ndarray, "N"]
    stiffness: Float[np.ndarray, "N"]


def _equations(body: Body, poses: Pose, bones: Transforms, targets, slots: tuple[int, ...]):
    """The lower half of H and minus half the gradient, frame by frame and then what is shared."""
    frames, dofs = len(targets), body.skeleton.num_dofs
    errors = deform_all(body, poses) - targets
    rows, owners = _own_directions(body, bones, targets)
    count = len(rows)
    spare = -count % ROWS
    rows = np.pad(rows, ((0, spare), (0, 0))).reshape(count + spare, frames, 3)
    owners = jnp.asarray(np.pad(owners, (0, spare)))
    size = frames * dofs + len(slots)
    kind = rows.dtype
    matrix, side = np.zeros((size, size), kind, order="F"), np.zeros(size)
    factor = np.zeros((count, size), kind)
    joint = slice(frames * dofs, size)
    for frame in range(frames):
        pose = jax.tree.map(lambda leaf, f=frame: leaf[f], poses)
        gram, slope, cut = (
            np.asarray(part)
            for part in _of_frame(body, pose, errors[frame], jnp.asarray(rows[:, frame]), owners, slots)
        )
        own = slice(frame * dofs, (frame + 1) * dofs)
        matrix[own, own], matrix[joint, own] = gram[:dofs, :dofs], gram[dofs:, :dofs]
        matrix[joint, joint] += gram[dofs:, dofs:]
        side[own] = -slope[:dofs]
        side[joint] -= slope[dofs:]
        factor[:, own] = cut[:count, :dofs]
        factor[:, joint] += cut[:count, dofs:]
    diagonal = np.diag(matrix).astype(float)
    layout = dof_layout(body.skeleton)
    turning = np.isin(np.arange(dofs), layout.rotations)
    alike = np.concatenate(
        [(2 * np.asarray(layout.joints) + turning + 1000 * f * dofs) for f in range(frames)]
        + [-1 - np.array(slots, int) // 3]
    )
    _, alike = np.unique(alike, return_inverse=True)
    shares = (np.bincount(alike, diagonal) / np.bincount(alike))[alike]
    stiffness = np.full(size, STIFF_TURN)
    stiffness[joint] = STIFF_SHIFT
    (syrk,) = scipy.linalg.get_blas_funcs(("syrk",), (factor,))
    matrix = syrk(-1.0, factor.T, beta=1.0, c=matrix, lower=1, overwrite_c=1)
    return matrix, side, _Measure(shares, stiffness)


@eqx.filter_jit
def _of_frame(body: Body, pose: Pose, errors, rows, owners, slots: tuple[int, ...]):
    """One frame's part of `J^T J`, of `J^T e`, and of own directions times `J`."""
    skeleton = body.skeleton
    transforms = forward_kinematics(skeleton, pose)
    rates = stack_rates(
        pose_rates(skeleton, pose, transforms),
        take_rates(joint_rates(skeleton, pose, transforms), np.array(slots, int)),
    )
    every = jnp.broadcast_to(jnp.eye(3, dtype=body.vertices.dtype), (len(body.vertices), 3, 3))
    moves = body.skin.jacobian(body.vertices, every, skeleton, pose, transforms, rates)
    flat = moves.reshape(-1, moves.shape[2])
    return flat.T @ flat, errors.ravel() @ flat, jnp.einsum("nc,ncd->nd", rows, moves[owners])


def _own_directions(body: Body, bones: Transforms, targets):
    """Orthonormal directions in which a vertex moves by its own unknowns, `(n, 3 F)`, and whose they are."""
    weights = np.asarray(body.skin.influence(body.skeleton.num_joints))
    number = (weights > 0).sum(1)
    order = np.argsort(-weights, 1)[:, : number.max()]
    support = (np.arange(order.shape[1]) < number[:, None])[:, :, None]
    aims = jnp.swapaxes(targets, 0, 1).reshape(len(weights), 1, -1)
    apart = (
        np.take_along_axis(np.asarray(images(bones, body.vertices) - aims), order[:, :, None], 1) * support
    )
    # weights of one sum exchange shares only
    apart = (apart - apart.sum(1, keepdims=True) / number[:, None, None]) * support
    turns = np.asarray(bones.rotations).transpose(1, 3, 0, 2).reshape(weights.shape[1], -1)
    by_place = (weights @ turns).reshape(len(weights), 3, -1)
    columns = np.concatenate([by_place, apart], 1)
    columns /= np.maximum(np.linalg.norm(columns, axis=2, keepdims=True), 1e-6)
    values, vectors = np.linalg.eigh(columns @ columns.transpose(0, 2, 1))
    told = values > NULL * values[:, -1:]
    vectors = vectors / np.sqrt(np.where(told, values, 1.0))[:, None]
    owners, slots = np.nonzero(told)
    return (vectors.transpose(0, 2, 1) @ columns)[owners, slots], owners


def _solve(matrix, side, raised, skeleton: Skeleton, pairs, slots) -> Float[np.ndarray, "N"] | None:
    """The damped step that keeps paired bones equally long; None where rounding left H indefinite."""
    dense = np.asarray(matrix, float, order="F").copy(order="F")
    dense[np.diag_indices_from(dense)] += raised
    try:
        factor = scipy.linalg.cho_factor(dense, lower=True, overwrite_a=True, check_finite=False)
    except np.linalg.LinAlgError:
        return None
    step = scipy.linalg.cho_solve(factor, side, check_finite=False)
    differences, by_centre = (np.asarray(part, float) for part in length_differences(skeleton, pairs))
    if len(differences) == 0:
        return step
    wide = np.pad(by_centre, ((0, 0), (0, 0), (0, 3))).reshape(len(differences), -1)
    rows = np.zeros((len(differences), len(side)))
    rows[:, len(side) - len(slots) :] = wide[:, list(slots)]
    answers = scipy.linalg.cho_solve(factor, rows.T, check_finite=False)
    return step - answers @ np.linalg.lstsq(rows @ answers, rows @ step + differences, rcond=None)[0]


def _cut(step, targets, skeleton: Skeleton) -> tuple[Float[Array, "F D"], Float[Array, "S"]]:
    count = len(targets) * skeleton.num_dofs
    step = jnp.asarray(step, targets.dtype)
    return step[:count].reshape(len(targets), -1), step[count:]


@eqx.filter_jit
def _move(skeleton: Skeleton, poses: Pose, by_frame, shared, slots: tuple[int, ...]):
    moved = jnp.zeros(6 * skeleton.num_joints, shared.dtype).at[np.array(slots, int)].set(shared)
    moved = moved.reshape(-1, 6)
    there = jax.vmap(retract, (None, 0, 0))(skeleton, poses, by_frame)
    return move_joints(skeleton, moved[:, :3], moved[:, 3:]), there
