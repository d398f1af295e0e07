"""Joints' centres with the poses of many frames, the surface following (Adaptation, 4.1.4)."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..body.body import Body
from ..body.pose import Pose, retract
from ..body.symmetry import length_differences
from ..energy.term import AbstractEnergy
from ..fit.arrow import Arrow, solve_arrow
from ..fit.correspond import Pairs
from ..fit.problem import linearise
from ..geometry.procrustes import nearest_rotation
from .equations import Follow, moved_joints, shared_equations

#: pairs that are neighbours say the same: so many count as one
ALIKE = 50.0


class Trust(eqx.Module):
    """What is believed beside the pairs."""

    #: weight of the pose priors against the mean squared distance of a pair, metres squared
    pose: Float[Array, ""]
    #: standard deviation of a joint from where the surface around it says, along each axis, metres
    joint: Float[Array, ""]
    #: standard deviation of a pair's distance, metres
    deviation: Float[Array, ""]


@eqx.filter_jit
def adapt_joints(
    body: Body,
    poses: Pose,
    pairs: Pairs,
    prior: AbstractEnergy,
    follow: Follow,
    mirrored: tuple[tuple[int, int], ...],
    expected: Float[Array, "J 3"],
    trust: Trust,
) -> tuple[Body, Pose]:
    """One Gauss-Newton step on all poses and the joints that they share, a block-arrow; paired bones end
    equally long (eq. 4.13 as a constraint).

    **Arguments:** `poses` and `pairs` stacked over frames; `mirrored` pairs of joints of the left and the right;
    `expected` where joints are by the surface around them (`centres_beside`), which decides where no motion
    tells.
    """
    skeleton, dofs = body.skeleton, body.skeleton.num_dofs

    def of_frame(frame):
        pose, pairs = frame
        matrix, side, _ = shared_equations(body, pose, pairs, follow)
        residual, jacobian = linearise(prior, body, pose)
        # a prior counts as it does for a pose by itself, against the mean of the pairs
        weight = trust.pose * jnp.maximum(jnp.sum(pairs.weights > 0), 1)
        matrix = matrix.at[:dofs, :dofs].add(weight * jacobian.T @ jacobian)
        side = side.at[:dofs].add(-weight * jacobian.T @ residual)
        return matrix[:dofs, :dofs], matrix[:dofs, dofs:], matrix[dofs:, dofs:], side

    frames, coupling, shared, sides = jax.lax.map(of_frame, (poses, pairs))
    diagonal = jnp.diagonal(frames, axis1=1, axis2=2)
    ridge = 1e-3 * diagonal + 1e-6 * jnp.max(diagonal, 1, keepdims=True)
    weight = ALIKE * (trust.deviation / trust.joint) ** 2
    hold = weight * jnp.eye(3 * skeleton.num_joints, dtype=frames.dtype)
    pull = weight * (expected - skeleton.centres).reshape(-1)
    arrow = Arrow(
        frames + jax.vmap(jnp.diag)(ridge),
        coupling,
        jnp.sum(shared, 0) + hold,
        sides[:, :dofs],
        jnp.sum(sides[:, dofs:], 0) + pull,
    )
    differences, by_centre = length_differences(skeleton, np.array(mirrored, int).reshape(-1, 2))
    rows = by_centre.reshape(len(differences), -1)
    by_frame, shifts = solve_arrow(arrow, rows, -differences)
    poses = jax.vmap(retract, (None, 0, 0))(skeleton, poses, by_frame)
    return moved_joints(body, follow, shifts.reshape(-1, 3)), poses


class Beside(NamedTuple):
    """Where the template's joints are in the surface around them."""

    #: (J, V) which vertices tell of each joint's place; rows sum to one
    shares: Float[np.ndarray, "J V"]
    vertices: Float[np.ndarray, "V 3"]
    centres: Float[np.ndarray, "J 3"]


def make_beside(template: Body, width: float = 0.12) -> Beside:
    """Vertices near a joint that it or its parent moves, `width` metres around it."""
    skeleton = template.skeleton
    influence = np.asarray(template.skin.influence(skeleton.num_joints), float)
    vertices, centres = np.asarray(template.vertices, float), np.asarray(skeleton.centres, float)
    parents = np.maximum(np.array(skeleton.parents), 0)
    near = np.exp(-0.5 * np.sum((vertices[:, None] - centres[None]) ** 2, -1) / width**2)
    # a joint within others' skin, such as a hip's socket, is told by what is near
    shares = ((influence + influence[:, parents]) * near + 1e-9 * near + 1e-30).T
    return Beside(shares / shares.sum(1, keepdims=True), vertices, centres)


def centres_beside(beside: Beside, vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "J 3"]:
    """Where joints are when the surface around each has moved by a similarity: what shape alone tells."""
    old, new = beside.shares @ beside.vertices, beside.shares @ vertices
    places = []
    for joint, shares in enumerate(beside.shares):
        before, after = beside.vertices - old[joint], vertices - new[joint]
        turn = nearest_rotation((after * shares[:, None]).T @ before)
        size = np.sqrt((shares @ np.sum(after**2, 1)) / (shares @ np.sum(before**2, 1)))
        places.append(new[joint] + size * turn @ (beside.centres[joint] - old[joint]))
    return np.stack(places)
