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
from ..body.skeleton import Skeleton
from ..fit.correspond import Pairs, places_on

#: squared distances along the surface count by this share of those across it: a nearest vertex is only
#: about the right one
TANGENTIAL = 0.05


class Follow(eqx.Module):
    """How the surface at rest follows its joints when these are moved: each vertex by shares of all
    joints' shifts, those of the two ends of the bones that move it, by where it lies between them."""

    shares: Float[Array, "V J"]


def make_follow(body: Body) -> Follow:
    """A bone that grows takes its skin with it: a vertex beside its start moves with the start, one at its
    end with the joint there; behind joints without children with the joint."""
    skeleton: Skeleton = body.skeleton
    influence = np.asarray(body.skin.influence(skeleton.num_joints), float)
    vertices, centres = np.asarray(body.vertices, float), np.asarray(skeleton.centres, float)
    shares = np.zeros_like(influence)
    for joint in range(skeleton.num_joints):
        children = [child for child, parent in enumerate(skeleton.parents) if parent == joint]
        held = influence[:, joint]
        if not children:
            shares[:, joint] += held
            continue
        # towards each child by how far along the way to it, the rest stays with the joint
        ways = centres[children] - centres[joint]
        lengths = np.maximum(np.sum(ways**2, 1), 1e-12)
        along = np.clip((vertices - centres[joint]) @ ways.T / lengths, 0.0, 1.0)
        along /= np.maximum(along.sum(1, keepdims=True), 1.0)
        for column, child in enumerate(children):
            shares[:, child] += held * along[:, column]
        shares[:, joint] += held * (1.0 - along.sum(1))
    return Follow(jnp.asarray(shares, body.vertices.dtype))


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
    """Three directions a pair, weighed: across the surface, and two along it that count less."""
    n = pairs.normals
    axes = jnp.eye(3, dtype=n.dtype)
    first = jnp.cross(n, jnp.where(jnp.abs(n[:, :1]) < 0.6, axes[0], axes[1]))
    first = first / jnp.maximum(jnp.linalg.norm(first, axis=1, keepdims=True), 1e-9)
    second = jnp.cross(n, first)
    along = jnp.sqrt(jnp.asarray(TANGENTIAL, n.dtype))
    return jnp.sqrt(pairs.weights)[:, None, None] * jnp.stack([n, along * first, along * second], 1)


def pair_energy(body: Body, pose: Pose, pairs: Pairs) -> Float[Array, ""]:
    """The sum of squared weighed distances, metres squared."""
    apart = pairs.points - places_on(pairs, pose_body(body, pose).vertices)
    return jnp.sum(jnp.einsum("cra,ca->cr", pair_rows(pairs), apart) ** 2)


def pose_equations(
    body: Body, pose: Pose, pairs: Pairs
) -> tuple[Float[Array, "D D"], Float[Array, "D"], Float[Array, ""]]:
    """`J^T J`, `J^T r` and `r^T r` by the numbers of a pose, with `r` what a step is to close."""
    rows, apart = _rows(body, pose, pairs, None)
    return rows.T @ rows, rows.T @ apart, apart @ apart


def shared_equations(
    body: Body, pose: Pose, pairs: Pairs, follow: Follow
) -> tuple[Float[Array, "N N"], Float[Array, "N"], Float[Array, ""]]:
    """The same by the numbers of a pose and, behind them, the shifts of all joints' centres, `D + 3 J`
    numbers, with the surface that follows."""
    rows, apart = _rows(body, pose, pairs, follow)
    return rows.T @ rows, rows.T @ apart, apart @ apart


def moved_joints(body: Body, follow: Follow, shifts: Float[Array, "J 3"]) -> Body:
    """The body with its joints' centres shifted, metres, and the surface with them."""
    return eqx.tree_at(
        lambda b: (b.skeleton.centres, b.vertices),
        body,
        (body.skeleton.centres + shifts, body.vertices + follow.shares @ shifts),
    )


def _rows(body: Body, pose: Pose, pairs: Pairs, follow: Follow | None):
    skeleton = body.skeleton
    transforms = forward_kinematics(skeleton, pose)
    rates = pose_rates(skeleton, pose, transforms)
    if follow is not None:
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
    if follow is not None:
        pulled = jnp.einsum("ckra,ckab->ckrb", by_vertex, maps[pairs.vertices])
        carried = jnp.einsum("ckrb,ckj->crjb", pulled, follow.shares[pairs.vertices])
        rows = rows.at[:, :, skeleton.num_dofs :].add(carried.reshape(*carried.shape[:2], -1))
    apart = jnp.einsum("cra,ca->cr", directions, pairs.points - places_on(pairs, places))
    return rows.reshape(-1, rows.shape[-1]), apart.reshape(-1)


def stack(parts: Sequence):
    """Poses or pairs of single frames as those of all, leaf by leaf."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *parts)


def unstack(whole, count: int) -> list:
    """What `stack` made one of, frame by frame."""
    return [jax.tree.map(lambda leaf, i=i: leaf[i], whole) for i in range(count)]
