"""Normal equations of a frame: how pairs pull at its pose, and at the joints that all frames share."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..body.body import Body, pose_body
from ..body.kinematics import forward_kinematics
from ..body.pose import Pose
from ..body.rates import joint_rates, pose_rates, stack_rates, take_rates
from ..body.shape_modes import Modes
from ..energy.term import AbstractEnergy, root
from ..fit.correspond import Pairs, places_on
from ..fit.problem import linearise


def vertex_maps(body: Body, pose: Pose) -> tuple[Float[Array, "V 3 3"], Float[Array, "V 3"]]:
    """`A (V, 3, 3)` and `x (V, 3)`: every posed vertex is `x + A e` where it is at rest by `e` elsewhere
    (Adaptation, 4.1.4: a posed vertex depends linearly on its place at rest)."""
    transforms = forward_kinematics(body.skeleton, pose)

    def deform(shift):
        return body.skin.deform(body.vertices + shift, body.skeleton, pose, transforms)

    still = deform(jnp.zeros(3, body.vertices.dtype))
    columns = [deform(axis) - still for axis in jnp.eye(3, dtype=body.vertices.dtype)]
    return jnp.stack(columns, -1), still


def pair_rows(pairs: Pairs) -> Float[Array, "C 3 3"]:
    """Three directions a pair, weighed: across the surface, and two along it, whose squares count by the pair's share."""
    n = pairs.normals
    axes = jnp.eye(3, dtype=n.dtype)
    first = jnp.cross(n, jnp.where(jnp.abs(n[:, :1]) < 0.6, axes[0], axes[1]))
    first = first / jnp.maximum(jnp.linalg.norm(first, axis=1, keepdims=True), 1e-9)
    second = jnp.cross(n, first)
    by = root(pairs.along)[:, None]
    return root(pairs.weights)[:, None, None] * jnp.stack([n, by * first, by * second], 1)


def num_pairs(pairs: Pairs) -> Float[Array, ""]:
    """How many pairs there are, by their weights; at least one."""
    return jnp.maximum(jnp.sum(pairs.weights > 0), 1).astype(pairs.weights.dtype)


def pair_energy(body: Body, pose: Pose, pairs: Pairs) -> Float[Array, ""]:
    """The sum of squared weighed distances, metres squared."""
    apart = pairs.points - places_on(pairs, pose_body(body, pose).vertices)
    return jnp.sum(jnp.einsum("cra,ca->cr", pair_rows(pairs), apart) ** 2)


def frame_energy(
    body: Body, pose: Pose, pairs: Pairs, prior: AbstractEnergy, weight: Float[Array, ""]
) -> Float[Array, ""]:
    """`Q_data + weight Q_pose` of a frame (eq. 4.3), with `Q_data` the mean over its pairs."""
    beside = prior.residual(pose_body(body, pose))
    return pair_energy(body, pose, pairs) / num_pairs(pairs) + weight * beside @ beside


def frame_equations(
    body: Body, pose: Pose, pairs: Pairs, prior: AbstractEnergy, weight: Float[Array, ""]
) -> tuple[Float[Array, "D D"], Float[Array, "D"]]:
    """Normal equations of `frame_energy` by the numbers of a pose."""
    count = num_pairs(pairs)
    matrix, side, _ = pose_equations(body, pose, pairs)
    return with_prior(matrix / count, side / count, body, pose, prior, weight)


def with_prior(
    matrix: Float[Array, "D D"],
    side: Float[Array, "D"],
    body: Body,
    pose: Pose,
    prior: AbstractEnergy,
    weight: Float[Array, ""],
) -> tuple[Float[Array, "D D"], Float[Array, "D"]]:
    """Normal equations by the numbers of a pose, with those of a weighed prior."""
    residual, jacobian = linearise(prior, body, pose)
    return matrix + weight * jacobian.T @ jacobian, side - weight * jacobian.T @ residual


def pose_equations(
    body: Body, pose: Pose, pairs: Pairs
) -> tuple[Float[Array, "D D"], Float[Array, "D"], Float[Array, ""]]:
    """`J^T J`, `J^T r` and `r^T r` by the numbers of a pose, with `r` what a step is to close."""
    rows, apart = frame_rows(body, pose, pairs, None)
    return rows.T @ rows, rows.T @ apart, apart @ apart


def shared_equations(
    body: Body, pose: Pose, pairs: Pairs, modes: Modes
) -> tuple[Float[Array, "N N"], Float[Array, "N"], Float[Array, ""]]:
    """The same by the numbers of a pose and, behind them, the amounts of the modes, `D + K` numbers."""
    rows, apart = frame_rows(body, pose, pairs, modes)
    return rows.T @ rows, rows.T @ apart, apart @ apart


def frame_rows(
    body: Body, pose: Pose, pairs: Pairs, modes: Modes | None
) -> tuple[Float[Array, "R N"], Float[Array, "R"]]:
    """`J` and `r` of the same, three rows a pair; without modes by the numbers of the pose alone."""
    skeleton = body.skeleton
    transforms = forward_kinematics(skeleton, pose)
    rates = pose_rates(skeleton, pose, transforms)
    if modes is not None:
        centres = np.array([6 * joint + axis for joint in range(skeleton.num_joints) for axis in range(3)])
        rates = stack_rates(rates, take_rates(joint_rates(skeleton, pose, transforms), centres))
    directions = pair_rows(pairs)
    every = pairs.vertices.reshape(-1)
    rest, skin = body.vertices[every], body.skin.take(every)
    # a place moves as its vertices do, each by its share
    by_vertex = pairs.shares[:, :, None, None] * directions[:, None]
    rows = skin.jacobian(rest, by_vertex.reshape(-1, 3, 3), skeleton, pose, transforms, rates)
    rows = jnp.sum(rows.reshape(*pairs.vertices.shape, *rows.shape[1:]), 1)
    maps, places = vertex_maps(body, pose)
    if modes is not None:
        dofs = skeleton.num_dofs
        pulled = jnp.einsum("ckra,ckab->ckrb", by_vertex, maps[pairs.vertices])
        carried = jnp.einsum("ckrb,mckb->crm", pulled, modes.vertices[:, pairs.vertices])
        turned = rows[:, :, dofs:] @ modes.centres.reshape(len(modes.centres), -1).T
        rows = jnp.concatenate([rows[:, :, :dofs], carried + turned], -1)
    apart = jnp.einsum("cra,ca->cr", directions, pairs.points - places_on(pairs, places))
    return rows.reshape(-1, rows.shape[-1]), apart.reshape(-1)


def stack(parts: Sequence):
    """Poses or pairs of single frames as those of all, leaf by leaf."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *parts)


def stack_pairs(parts: Sequence[Pairs]) -> Pairs:
    """Pairs of single frames as those of all; scans of fewer points get pairs of weight zero."""
    count = max(len(part.weights) for part in parts)

    def padded(part: Pairs) -> Pairs:
        extra = (0, count - len(part.weights))
        wide = jax.tree.map(
            lambda leaf: jnp.pad(leaf, (extra, *[(0, 0)] * (leaf.ndim - 1)), mode="edge"), part
        )
        return eqx.tree_at(lambda p: p.weights, wide, jnp.pad(part.weights, extra))

    return stack([padded(part) for part in parts])


def unstack(whole, count: int) -> list:
    """What `stack` made one of, frame by frame."""
    return [jax.tree.map(lambda leaf, i=i: leaf[i], whole) for i in range(count)]
