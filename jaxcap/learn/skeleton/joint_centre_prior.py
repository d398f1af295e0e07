"""Where joints stand that no motion tells: where a skeleton has them, or amid the cut between the parts they join."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...body.body import Body
from ...body.pose import Pose
from ...geometry import rotation
from ...geometry.laplacian import Conformance, neighbour_pairs

#: mean squared turn, radians, below which a motion counts as too little to tell: 1 degree
LITTLE = 0.02**2
#: the same where a skeleton says where its joints stand: 17 degrees
LITTLE_GIVEN = 0.3**2
#: how much a centre that is kept weighs beside a turn of one radian
KEPT = 1e4
#: how many times stiffer a centre is held where it stands than it is pulled
HOLD = 30.0
#: radii of its cut within which a centre may be
REACH = 1.5
#: error of a vertex, as a share of the body's diagonal, below which data are trusted to tell all they can
EXACT = 3e-4


class Anchors(eqx.Module):
    """A quadratic pull on joints' centres, along what their motion does not tell.

    A hinge does not tell where along its axis it stands, and a joint that hardly turns tells
    nothing: there the middle of the cut decides, or the place that a given skeleton has. Across a
    hinge, and where joints turn freely, the pull is hundreds of times weaker than the data; that to
    a cut fades where these are exact.
    """

    middles: Float[Array, "J 3"]
    #: how much the pull weighs along each direction, beside what a turn of one radian tells; zero for
    #: roots and where the parts of a joint do not touch
    weights: Float[Array, "J 3 3"]
    #: the same for how stiffly a centre is held where it stands: where nothing is told, even a weak
    #: misfit would drive it far in many steps
    hold: Float[Array, "J 3 3"]
    #: how much the motion tells along each direction, in the same measure
    told: Float[Array, "J 3 3"]


class Given(NamedTuple):
    """Where a given skeleton has its joints, and whether they stay there."""

    centres: Float[Array, "J 3"]
    keep: bool = False


def given_anchors(body: Body, poses: Pose, given: Given) -> Anchors:
    """Anchors where a given skeleton has its joints: a prior beside what motion tells, or all that counts. Bones that share their vertices with the next ones, as those of a spine do, have no cut, and would else wander along the limb."""
    told, values, axes = _told(poses)
    pull = LITTLE_GIVEN**2 / (np.maximum(values, 0.0) + LITTLE_GIVEN)
    weights = (
        np.full_like(told, KEPT) * np.eye(3) if given.keep else np.einsum("jab,jb,jcb->jac", axes, pull, axes)
    )
    weights *= (np.array(body.skeleton.parents) >= 0)[:, None, None]
    dtype = body.vertices.dtype
    return Anchors(*(jnp.asarray(field, dtype) for field in (given.centres, weights, weights, told)))


def cut_anchors(body: Body, poses: Pose, metric: Conformance, variance: float) -> Anchors:
    """Anchors amid the edges that lead from all that hangs below a joint to the rest of the body.

    A centre that has left the sphere of one and a half times the cut's radius is pulled the more,
    whatever its motion tells: bones with few vertices of their own would else use it to stretch.

    **Arguments:** `metric` of the body's mesh, for its edges; `variance` of a coordinate's error, squared metres.
    """
    labels, rest = np.asarray(body.skin.parts()), np.asarray(body.vertices, float)
    inner, outer = neighbour_pairs(metric).T
    ends = (rest[inner] + rest[outer]) / 2
    below = body.skeleton.descent
    crossing = below[:, labels[inner]] & ~below[:, labels[outer]]
    count = crossing.sum(1)
    middles = crossing @ ends / np.maximum(count, 1)[:, None]
    squares = crossing @ np.sum(ends**2, 1) / np.maximum(count, 1) - np.sum(middles**2, 1)
    radii = REACH * np.sqrt(np.maximum(squares, 0.0)) + 1e-12
    away = np.linalg.norm(np.asarray(body.skeleton.centres, float) - middles, axis=1)
    told, values, axes = _told(poses)
    pull = LITTLE**2 / (np.maximum(values, 0.0) + LITTLE)
    doubt = variance / (variance + (EXACT * np.linalg.norm(np.ptp(rest, axis=0))) ** 2)
    weights = doubt * np.einsum("jab,jb,jcb->jac", axes, pull, axes)
    beyond = np.einsum("jaa->j", told) / 3 * np.maximum(away / radii - 1, 0.0)
    back = beyond[:, None, None] * np.eye(3)
    hold, weights = (((share * weights) + back) * (count > 0)[:, None, None] for share in (HOLD, 1.0))
    dtype = body.vertices.dtype
    return Anchors(*(jnp.asarray(field, dtype) for field in (middles, weights, hold, told)))


def _told(
    poses: Pose,
) -> tuple[Float[np.ndarray, "J 3 3"], Float[np.ndarray, "J 3"], Float[np.ndarray, "J 3 3"]]:
    """How much each joint's motion tells of its centre, and along which axes."""
    # a turn that never changes could as well be in the rest shape
    turns = np.asarray(rotation.to_matrix(poses.rotations), float)
    apart = turns - turns.mean(0)
    told = np.einsum("fjab,fjac->jbc", apart, apart) / len(turns)
    values, axes = np.linalg.eigh(told)
    return told, values, axes
