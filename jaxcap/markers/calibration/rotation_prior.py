"""A normal prior of each joint's rotation about its mean.

If a joint hardly rotates about an axis, noise alone makes its bone seem to rotate. Each such rotation
would be false evidence for the position of the centre, the stronger the more frames there are (Neyman and
Scott 1948). So poses are pulled to each joint's mean about axes with rotations that noise explains, and have
a wide prior about the others, so that no bone spins about an axis that its markers hardly determine.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Array, Float

from ...body.pose import Pose
from ...body.skeleton import Skeleton, dof_layout
from ...geometry import rotation
from ..subject import FREE_DEVIATION, Subject

#: least noise deviation of a rotation, radians
MIN_ROTATION_NOISE = 1e-3
#: a rotation with more than this multiple of its noise variance is free
FREE_VARIANCE_RATIO = 2.0
#: prior variance of rotations about all other axes, in units of the noise variance
STIFF_VARIANCE_RATIO = 1e-3
#: prior deviation of rotations that are otherwise free, radians: more than most joints rotate, and little against any
#: marker that is not on the axis
WIDE_DEVIATION = 0.5
#: a frame counts if its variance is at most this multiple of the median
MAX_VARIANCE_RATIO = 3.0


class RotationPrior(eqx.Module):
    """Mean rotations of T ball joints, and roots `R` of the inverse covariances `R^T R` of the rotations about them.

    In float32 an inverse covariance of 1e9 about one axis, and of zero about another, would round to one with
    negative eigenvalues.
    """

    means: Float[Array, "T 4"]
    roots: Float[Array, "T 3 3"]
    joints: tuple[int, ...] = eqx.field(static=True)


def free_rotation_prior(skeleton: Skeleton) -> RotationPrior:
    """Build a prior without information."""
    kinds = zip(skeleton.parents, skeleton.kinds, strict=True)
    joints = tuple(j for j, (parent, kind) in enumerate(kinds) if parent >= 0 and kind == "ball")
    dtype = skeleton.centres.dtype
    means = jnp.tile(jnp.array([1.0, 0, 0, 0], dtype), (len(joints), 1))
    return RotationPrior(means, jnp.zeros((len(joints), 3, 3), dtype), joints)


def free_deviation(subject: Subject) -> float:
    """Return the prior deviation of rotations that are otherwise free: infinite for a subject with a prior of its posture."""
    return WIDE_DEVIATION if subject.posture is None else np.inf


def wide_rotation_prior(skeleton: Skeleton, poses: Pose, deviation: float = WIDE_DEVIATION) -> RotationPrior:
    """Build a weak prior of all rotations about their means, with this deviation, radians.

    A bone with two markers can rotate about the line through both where this line passes near its joint. Its poses would
    rotate at random, which is false evidence for the centre.
    """
    free = free_rotation_prior(skeleton)
    means = mean_rotations(np.asarray(poses.rotations, float)[:, list(free.joints)])
    roots = jnp.broadcast_to(jnp.eye(3, dtype=free.roots.dtype) / deviation, free.roots.shape)
    return RotationPrior(jnp.asarray(means, free.means.dtype), roots, free.joints)


def with_wide_posture(subject: Subject) -> Subject:
    """Give a subject without a prior of its posture a wide one, about rest, as the means of its rotations are not known."""
    if subject.posture is not None:
        return subject
    top = np.array(subject.skeleton.parents)[:, None] < 0
    deviations = np.broadcast_to(np.where(top, FREE_DEVIATION, WIDE_DEVIATION), (len(top), 3))
    posture = jnp.asarray(deviations, subject.offsets.dtype)
    return eqx.tree_at(lambda s: s.posture, subject, posture, is_leaf=lambda leaf: leaf is None)


def rotation_vectors_from_mean(q: Float[np.ndarray, "F J 4"]) -> Float[np.ndarray, "F J 3"]:
    """Compute rotation vectors from each joint's mean rotation, in the bones' own frames, radians."""
    return np.asarray(_rotation_vectors(jnp.asarray(mean_rotations(q)), jnp.asarray(q)), float)


def estimate_rotation_prior(
    skeleton: Skeleton, poses: Pose, covariances: Float[Array, "F D D"], deviation: float = WIDE_DEVIATION
) -> RotationPrior:
    """Estimate the prior from poses that were solved with the wide one, and from their covariances.

    It compares the variance of the poses with that due to noise. Axes with more than `FREE_VARIANCE_RATIO` times the noise
    variance have the wide prior with this `deviation`, as rotations are not normal and those of several joints are correlated.
    """
    free = free_rotation_prior(skeleton)
    slots = dof_layout(skeleton).rotations[np.array(free.joints, int)]
    q = np.asarray(poses.rotations, float)[:, list(free.joints)]
    means = mean_rotations(q)
    turns = np.asarray(_rotation_vectors(jnp.asarray(means), jnp.asarray(q)), float)
    each = np.asarray(covariances, float)[:, slots[:, :, None], slots[:, None, :]]
    # frames with an uncertain bone are no evidence on its rotation
    doubt = np.trace(each, axis1=2, axis2=3)
    shown = (doubt <= MAX_VARIANCE_RATIO * np.median(doubt, 0)).astype(float)
    shown /= shown.sum(0)
    second = np.einsum("fj,fja,fjb->jab", shown, turns, turns)
    noise = np.einsum("fj,fjab->jab", shown, each) + MIN_ROTATION_NOISE**2 * np.eye(3)
    roots = np.zeros_like(second)
    for joint, (moved, known) in enumerate(zip(second, noise, strict=True)):
        # in units of noise, so that the directions separate by their signal
        values, vectors = scipy.linalg.eigh(moved, known)
        wide = 1.0 / (deviation * np.linalg.norm(vectors, axis=0))
        scales = np.where(values > FREE_VARIANCE_RATIO, wide, STIFF_VARIANCE_RATIO**-0.5)
        roots[joint] = scales[:, None] * vectors.T
    dtype = skeleton.centres.dtype
    return RotationPrior(jnp.asarray(means, dtype), jnp.asarray(roots, dtype), free.joints)


def rotation_prior_square(prior: RotationPrior, pose: Pose) -> Float[Array, ""]:
    """Compute the squared deviation of a pose's rotations from the means, in standard deviations."""
    turns = _rotation_vectors(prior.means, pose.rotations[np.array(prior.joints, int)])
    return jnp.sum(jnp.einsum("jab,jb->ja", prior.roots, turns) ** 2)


def rotation_prior_equations(
    skeleton: Skeleton, prior: RotationPrior, pose: Pose
) -> tuple[Float[Array, "D D"], Float[Array, "D"]]:
    """Compute `J^T R^T R J` and `J^T R^T R t` of a pose's rotations `t` about the means, by its tangent."""
    joints = np.array(prior.joints, int)
    slots = dof_layout(skeleton).rotations[joints]
    q = pose.rotations[joints]

    def turned(w):
        t = _rotation_vectors(prior.means, rotation.multiply(q, rotation.exp(w)))
        return jnp.sum(t, 0), t

    # each joint's rotation vector depends on its own numbers only
    slope, turns = jax.jacfwd(turned, has_aux=True)(jnp.zeros((len(joints), 3), q.dtype))
    slope = jnp.swapaxes(slope, 0, 1)
    residual = jnp.einsum("jab,jb->ja", prior.roots, turns)
    slope = jnp.einsum("jab,jbc->jac", prior.roots, slope)
    blocks = jnp.einsum("jba,jbc->jac", slope, slope)
    dofs = skeleton.num_dofs
    matrix = jnp.zeros((dofs, dofs), q.dtype).at[slots[:, :, None], slots[:, None, :]].add(blocks)
    return matrix, jnp.zeros(dofs, q.dtype).at[slots].add(jnp.einsum("jba,jb->ja", slope, residual))


def mean_rotations(q: Float[np.ndarray, "F T 4"]) -> Float[np.ndarray, "T 4"]:
    """Find the quaternion that is nearest to all of each joint, whatever their signs."""
    return np.linalg.eigh(np.einsum("fja,fjb->jab", q, q))[1][..., -1]


def _rotation_vectors(means: Float[Array, "T 4"], q: Float[Array, "*F T 4"]) -> Float[Array, "*F T 3"]:
    """Compute rotation vectors from the means, in the bones' own frames."""
    back = jnp.broadcast_to(rotation.conjugate(means), q.shape)
    return rotation.log(rotation.multiply(back, q))
