"""Priors on joint centres, and on rotations, that the motion does not determine.

The prior mean is the centre in a given skeleton, or the middle of the cut between the parts that a joint
connects.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.spatial import KDTree

from ...body.body import Body
from ...body.pose import Pose, rest_pose
from ...body.retraction import difference
from ...body.skeleton import Skeleton, dof_layout
from ...geometry import rotation
from ...geometry.laplacian import Conformance, neighbour_pairs
from ...geometry.mesh import box_diagonal
from ..anatomy.close_joints import hidden_joints, hinges
from .given_centres import GivenCentres

#: mean squared rotation, squared radians, below which a motion does not determine a centre: (1 degree)²
MIN_ROTATION = 0.02**2
#: the same with a given skeleton and rough data: (17 degrees)²
MIN_ROTATION_GIVEN = 0.3**2
#: data are rough if the residual of a coordinate, root mean square, is more than this share of the body's diagonal; with finer
#: data, smaller rotations determine a centre
ROUGH = 0.02
#: weight of a fixed centre, relative to the information of a rotation by one radian
FIXED_WEIGHT = 1e4
#: with a given skeleton, a rotation from rest costs this share of what it costs to move the vertices below the joint by
#: as much at a distance of `LEVER` times the body's diagonal
ROTATION_WEIGHT, LEVER = 1e-3, 0.05
#: a centre is pulled back if it is farther from its position in a given skeleton than this number of distances from there to the
#: nearest vertex, and than this share of the body's diagonal
MAX_DEPTHS, MIN_RADIUS = 2.0, 0.015
#: weight of the distance beyond that, relative to a movement of all vertices below the joint by as much
BEYOND_WEIGHT = 10.0
#: the least number of vertices that the prior of a joint counts: a part may lose all of its vertices while weights are learned
MIN_VERTICES = 10
#: damping of a centre relative to the weight of its prior
DAMPING = 30.0
#: radii of its cut within which a centre is not penalised
MAX_RADII = 1.5
#: vertex error, as a share of the body's diagonal, below which the data are trusted fully
EXACT = 3e-4


class JointCentrePrior(eqx.Module):
    """A quadratic prior on joint centres along directions that their motion does not determine, and on rotations.

    A hinge does not determine the centre along its axis, and a joint that hardly rotates determines nothing.
    There the prior decides: the middle of the cut, or the centre in a given skeleton. Across a hinge, and
    where joints rotate freely, the prior is hundreds of times weaker than the data. It fades for exact data.

    Whatever the data say, a centre outside of a sphere around its mean is pulled back: sliding cloth looks like a rotation about
    a distant point.

    Several joints of a limb share a rotation that only one of them has to make: about the axis of a forearm, elbow and wrist.
    With a given skeleton, a weak prior at rest keeps each from making far too much of it.
    """

    means: Float[Array, "J 3"]
    #: weight of the prior along each direction, in numbers of vertices: a centre at some distance from its mean costs as much as
    #: this many vertices at this distance; zero for roots and where the parts of a joint do not touch
    weights: Float[Array, "J 3 3"]
    #: damping towards the current centre in the same unit: without information, even a weak misfit would move
    #: a centre far over many steps
    damping: Float[Array, "J 3 3"]
    #: weight of a squared rotation from rest in each mesh, vertices times metres squared
    rotations: Float[Array, "F J"]
    #: radii of the spheres around the means, metres; infinite where there are none
    radii: Float[Array, "J"]
    #: weight of the distance from the spheres, in numbers of vertices
    beyond: Float[Array, "J"]

    def energy(self, centres: Float[Array, "J 3"]) -> Float[Array, ""]:
        """Compute half the weighted squares of the distances of centres from their means and spheres, metres squared."""
        away = centres - self.means
        outside = jnp.maximum(_lengths(away) - self.radii, 0.0)
        return 0.5 * (jnp.einsum("ja,jab,jb->", away, self.weights, away) + jnp.sum(self.beyond * outside**2))

    def pull(self, centres: Float[Array, "J 3"]) -> tuple[Float[Array, "J 3"], Float[Array, "J 3 3"]]:
        """Return the negative gradient of `energy` by the centres, and the curvature of the distances from the spheres."""
        away = centres - self.means
        length = _lengths(away)
        outside = jnp.maximum(length - self.radii, 0.0)
        direction = away / length[:, None]
        back = jnp.einsum("jab,jb->ja", self.weights, away) + (self.beyond * outside)[:, None] * direction
        stiff = jnp.where(outside > 0, self.beyond, 0.0)
        return -back, stiff[:, None, None] * direction[:, :, None] * direction[:, None, :]

    def rotation_energy(self, skeleton: Skeleton, poses: Pose) -> Float[Array, ""]:
        """Compute half the weighted squares of the rotations of ball joints from rest in all poses, metres squared."""
        stiffness, back = self.rotations_to_rest(skeleton, poses)
        return 0.5 * jnp.sum(stiffness * back**2)

    def rotations_to_rest(
        self, skeleton: Skeleton, poses: Pose
    ) -> tuple[Float[Array, "F D"], Float[Array, "F D"]]:
        """Return the weight of each degree of freedom of a pose, zero but for ball joints, and the steps that lead to rest."""
        balls = np.array([kind == "ball" for kind in skeleton.kinds])
        slots = dof_layout(skeleton).rotations[balls]
        stiffness = jnp.zeros((len(self.rotations), skeleton.num_dofs), self.rotations.dtype)
        stiffness = stiffness.at[:, slots].set(self.rotations[:, balls, None])
        return stiffness, jax.vmap(difference, (None, 0, None))(skeleton, poses, rest_pose(skeleton))


def given_centre_prior(
    body: Body,
    poses: Pose,
    given: GivenCentres,
    variance: float,
    frame_weights: Float[Array, "F"] | None = None,
) -> JointCentrePrior:
    """Build anchors at the joint centres of a given skeleton, a prior or fixed centres, and at the rotations of its rest.

    Bones that share their vertices with the next ones, such as those of a spine, have no cut, and would
    otherwise drift along the limb.

    **Arguments:** `variance` of a coordinate's error, squared metres: the finer the data, the smaller are the rotations that
    determine a centre, but for `hidden_joints`, and for `hinges` along their axes.
    """
    _, values, axes = motion_information(poses, frame_weights)
    least = least_rotations(body.skeleton, rotation_that_determines(body, variance))
    pull = given_pull(np.maximum(values, 0.0), least)
    weights = np.einsum(
        "jab,jb,jcb->jac", axes, np.full_like(pull, FIXED_WEIGHT) if given.is_fixed else pull, axes
    )
    depths = KDTree(np.asarray(body.vertices, float)).query(np.asarray(given.centres, float))[0]
    radii = np.maximum(MAX_DEPTHS * depths, MIN_RADIUS * box_diagonal(body.vertices))
    return _given_prior(body, given.centres, weights, radii, len(poses.rotations), frame_weights)


def fixed_centre_prior(
    body: Body, num_frames: int, frame_weights: Float[Array, "F"] | None = None
) -> JointCentrePrior:
    """Build anchors that keep all centres of a body where they are."""
    weights = np.broadcast_to(FIXED_WEIGHT * np.eye(3), (body.skeleton.num_joints, 3, 3))
    radii = np.full(body.skeleton.num_joints, np.inf)
    return _given_prior(body, body.skeleton.centres, weights, radii, num_frames, frame_weights)


def _given_prior(
    body: Body,
    centres: Array,
    weights: np.ndarray,
    radii: np.ndarray,
    num_frames: int,
    frame_weights: Array | None,
) -> JointCentrePrior:
    counts = np.maximum(vertices_below(body), MIN_VERTICES) * (np.array(body.skeleton.parents) >= 0)
    frames = _frame_weights(num_frames, frame_weights)
    weights = (frames.sum() * counts)[:, None, None] * weights
    stiffness = ROTATION_WEIGHT * (LEVER * box_diagonal(body.vertices)) ** 2 * np.outer(frames, counts)
    beyond = BEYOND_WEIGHT * frames.sum() * counts
    dtype = body.vertices.dtype
    fields = (centres, weights, weights, stiffness, radii, beyond)
    return JointCentrePrior(*(jnp.asarray(field, dtype) for field in fields))


def rotation_that_determines(body: Body, variance: float) -> float:
    """Compute the mean squared rotation, squared radians, above which data with an error determine a centre better than a
    given skeleton does.

    **Arguments:** `variance` of a coordinate's error, squared metres.
    """
    share = min(1.0, float(np.sqrt(variance)) / (ROUGH * box_diagonal(body.vertices)))
    return max(share * MIN_ROTATION_GIVEN, MIN_ROTATION)


def least_rotations(skeleton: Skeleton, least: float) -> Float[np.ndarray, "J 3"]:
    """Return the mean squared rotations, squared radians, that determine each joint's centre along the axes of `motion_information`.

    They are `least`, but do not fade for `hidden_joints`, and for `hinges` along the first axis, along which the motion shows
    the centre least.
    """
    rotations = np.full((skeleton.num_joints, 3), least)
    rotations[list(hidden_joints(skeleton))] = MIN_ROTATION_GIVEN
    rotations[list(hinges(skeleton)), 0] = MIN_ROTATION_GIVEN
    return rotations


def given_pull(
    information: Float[np.ndarray, "..."], least: Float[np.ndarray, "..."] | float = MIN_ROTATION_GIVEN
) -> Float[np.ndarray, "..."]:
    """Compute the weight of the prior at a given centre, by the mean squared rotation that determines it.

    It is `least` without information, and falls with it; both weigh the same where the rotation is 0.79 times the root of
    `least`.
    """
    return least**2 / (information + least)


def _lengths(vectors: Float[Array, "J 3"]) -> Float[Array, "J"]:
    """Compute lengths, with finite derivatives at zero."""
    return jnp.sqrt(jnp.sum(vectors**2, 1) + jnp.finfo(vectors.dtype).tiny)


def _frame_weights(count: int, weights: Float[Array, "F"] | None) -> Float[np.ndarray, "F"]:
    return np.ones(count) if weights is None else np.asarray(weights, float)


def vertices_below(body: Body) -> Int[np.ndarray, "J"]:
    """Count the vertices of the parts below each joint."""
    return body.skeleton.descendants[:, np.asarray(body.skin.dominant_bones())].sum(1)


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
    pull = given_pull(np.maximum(values, 0.0), MIN_ROTATION)
    doubt = variance / (variance + (EXACT * box_diagonal(body.vertices)) ** 2)
    weights = doubt * np.einsum("jab,jb,jcb->jac", axes, pull, axes)
    beyond = np.einsum("jaa->j", information) / 3 * np.maximum(away / radii - 1, 0.0)
    back = beyond[:, None, None] * np.eye(3)
    frames = _frame_weights(len(poses.rotations), frame_weights)
    scale = (frames.sum() * vertices_below(body) * (count > 0))[:, None, None]
    hold, weights = (scale * (share * weights + back) for share in (DAMPING, 1.0))
    dtype, free = body.vertices.dtype, np.zeros((len(frames), len(scale)))
    spheres = np.full(len(scale), np.inf), np.zeros(len(scale))
    fields = (middles, weights, hold, free, *spheres)
    return JointCentrePrior(*(jnp.asarray(field, dtype) for field in fields))


def motion_information(
    poses: Pose, frame_weights: Float[Array, "F"] | None = None
) -> tuple[Float[np.ndarray, "J 3 3"], Float[np.ndarray, "J 3"], Float[np.ndarray, "J 3 3"]]:
    """Compute the information of each joint's motion on its centre, with eigenvalues and axes; weights as of `objective`."""
    # a constant rotation could also be part of the rest shape
    turns = np.asarray(rotation.to_matrix(poses.rotations), float)
    weights = _frame_weights(len(turns), frame_weights)
    shares = weights / weights.sum()
    deviations = turns - np.einsum("f,fjab->jab", shares, turns)
    information = np.einsum("f,fjab,fjac->jbc", shares, deviations, deviations)
    values, axes = np.linalg.eigh(information)
    return information, values, axes
