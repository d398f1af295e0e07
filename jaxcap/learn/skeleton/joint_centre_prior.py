"""Priors on joint centres that the motion does not determine.

The prior mean is the centre in a given skeleton, or the middle of the cut between the parts that a joint
connects.
"""

from typing import NamedTuple, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...body.body import Body
from ...body.pose import Pose
from ...geometry import rotation
from ...geometry.laplacian import Conformance, neighbour_pairs

#: mean squared rotation, squared radians, below which a motion does not determine a centre: (1 degree)²
MIN_ROTATION = 0.02**2
#: the same with a given skeleton: (17 degrees)²
MIN_ROTATION_GIVEN = 0.3**2
#: weight of a fixed centre, relative to the information of a rotation by one radian
FIXED_WEIGHT = 1e4
#: damping of a centre relative to the weight of its prior
DAMPING = 30.0
#: radii of its cut within which a centre is not penalised
MAX_RADII = 1.5
#: vertex error, as a share of the body's diagonal, below which the data are trusted fully
EXACT = 3e-4


class JointCentrePrior(eqx.Module):
    """A quadratic prior on joint centres along directions that their motion does not determine.

    A hinge does not determine the centre along its axis, and a joint that hardly rotates determines nothing.
    There the prior decides: the middle of the cut, or the centre in a given skeleton. Across a hinge, and
    where joints rotate freely, the prior is hundreds of times weaker than the data. The prior of a cut fades
    for exact data.
    """

    means: Float[Array, "J 3"]
    #: weight of the prior along each direction, relative to the information of a rotation by one radian; zero
    #: for roots and where the parts of a joint do not touch
    weights: Float[Array, "J 3 3"]
    #: damping towards the current centre in the same unit: without information, even a weak misfit would move
    #: a centre far over many steps
    damping: Float[Array, "J 3 3"]
    #: information of the motion along each direction, in the same unit
    information: Float[Array, "J 3 3"]


class GivenCentres(NamedTuple):
    """Joint centres of a given skeleton; with `is_fixed` they are fixed."""

    centres: Float[Array, "J 3"]
    is_fixed: bool = False
    #: unit normals of the planes through joints on the middle of the body, in which their centres stay; zero for other
    #: joints; None if there are no such planes
    normals: Float[Array, "J 3"] | None = None


Given = TypeVar("Given", bound=GivenCentres)


def onto_middle(centres: Float[Array, "J 3"], given: GivenCentres) -> Float[Array, "J 3"]:
    """Move the joints on the middle of the body sideways, so that all are as far from the given planes."""
    assert given.normals is not None
    away = jnp.sum((centres - given.centres) * given.normals, 1)
    members = jnp.any(given.normals != 0, 1)
    mean = jnp.sum(away * members) / jnp.maximum(members.sum(), 1)
    return centres + jnp.where(members, mean - away, 0.0)[:, None] * given.normals


def replace_centres(given: Given, centres: Float[Array, "J 3"]) -> Given:
    """Give new centres; those on the middle of the body all move sideways by the same distance."""
    return given._replace(centres=centres if given.normals is None else onto_middle(centres, given))


def given_centre_prior(
    body: Body, poses: Pose, given: GivenCentres, frame_weights: Float[Array, "F"] | None = None
) -> JointCentrePrior:
    """Build anchors at the joint centres of a given skeleton: a prior, or fixed centres.

    Bones that share their vertices with the next ones, such as those of a spine, have no cut, and would
    otherwise drift along the limb.
    """
    information, values, axes = motion_information(poses, frame_weights)
    pull = given_pull(np.maximum(values, 0.0))
    weights = (
        np.full_like(information, FIXED_WEIGHT) * np.eye(3)
        if given.is_fixed
        else np.einsum("jab,jb,jcb->jac", axes, pull, axes)
    )
    weights *= (np.array(body.skeleton.parents) >= 0)[:, None, None]
    dtype = body.vertices.dtype
    return JointCentrePrior(
        *(jnp.asarray(field, dtype) for field in (given.centres, weights, weights, information))
    )


def given_pull(information: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Compute the weight of the prior at a given centre, by the mean squared rotation that determines it; both weigh the same
    at 13 degrees."""
    return _pull(information, MIN_ROTATION_GIVEN)


def _pull(information: Float[np.ndarray, "..."], least: float) -> Float[np.ndarray, "..."]:
    """Compute the weight of a prior that is `least` without information, and falls with it."""
    return least**2 / (information + least)


def boundary_centre_prior(
    body: Body,
    poses: Pose,
    metric: Conformance,
    variance: float,
    frame_weights: Float[Array, "F"] | None = None,
) -> JointCentrePrior:
    """Build anchors at the middle of the edges between the subtree of a joint and the rest of the body.

    A centre outside the sphere of 1.5 times the cut's radius is penalised even if its motion determines it.
    Otherwise bones with few vertices of their own would use it to stretch.

    **Arguments:** `metric` of the body's mesh, for its edges; `variance` of a coordinate's error, squared
    metres.
    """
    labels, rest = np.asarray(body.skin.dominant_bones()), np.asarray(body.vertices, float)
    inner, outer = neighbour_pairs(metric).T
    ends = (rest[inner] + rest[outer]) / 2
    below = body.skeleton.descendants
    crossing = below[:, labels[inner]] & ~below[:, labels[outer]]
    count = crossing.sum(1)
    middles = crossing @ ends / np.maximum(count, 1)[:, None]
    squares = crossing @ np.sum(ends**2, 1) / np.maximum(count, 1) - np.sum(middles**2, 1)
    radii = MAX_RADII * np.sqrt(np.maximum(squares, 0.0)) + 1e-12
    away = np.linalg.norm(np.asarray(body.skeleton.centres, float) - middles, axis=1)
    information, values, axes = motion_information(poses, frame_weights)
    pull = _pull(np.maximum(values, 0.0), MIN_ROTATION)
    doubt = variance / (variance + (EXACT * np.linalg.norm(np.ptp(rest, axis=0))) ** 2)
    weights = doubt * np.einsum("jab,jb,jcb->jac", axes, pull, axes)
    beyond = np.einsum("jaa->j", information) / 3 * np.maximum(away / radii - 1, 0.0)
    back = beyond[:, None, None] * np.eye(3)
    hold, weights = (((share * weights) + back) * (count > 0)[:, None, None] for share in (DAMPING, 1.0))
    dtype = body.vertices.dtype
    return JointCentrePrior(*(jnp.asarray(field, dtype) for field in (middles, weights, hold, information)))


def motion_information(
    poses: Pose, frame_weights: Float[Array, "F"] | None = None
) -> tuple[Float[np.ndarray, "J 3 3"], Float[np.ndarray, "J 3"], Float[np.ndarray, "J 3 3"]]:
    """Compute the information of each joint's motion on its centre, with eigenvalues and axes; weights as of `objective`."""
    # a constant rotation could also be part of the rest shape
    turns = np.asarray(rotation.to_matrix(poses.rotations), float)
    weights = np.ones(len(turns)) if frame_weights is None else np.asarray(frame_weights, float)
    shares = weights / weights.sum()
    deviations = turns - np.einsum("f,fjab->jab", shares, turns)
    information = np.einsum("f,fjab,fjac->jbc", shares, deviations, deviations)
    values, axes = np.linalg.eigh(information)
    return information, values, axes
