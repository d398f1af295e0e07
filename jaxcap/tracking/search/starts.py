"""Starts of a search: a pose in other directions, random neighbours, and limbs that have no points."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from ...body.body import pose_body
from ...body.pose import Pose
from ...body.retraction import retract
from ...body.skeleton import Skeleton, dof_layout
from ...geometry import rotation
from ...observe.clouds import Cloud
from ...stacking import concatenate, take_rows
from ..track_frame import Tracker

#: distance from a vertex within which a point supports it, metres, and the share that is added to the unsupported one of
#: every joint
SUPPORT_RADIUS, UNIFORM_SHARE = 0.06, 0.1


@eqx.filter_jit
def rotated_starts(tracker: Tracker, cloud: Cloud, pose: Pose, count: int, up: Float[Array, "3"]) -> Pose:
    """Rotate a pose about the vertical `up` in `count` equal steps and align the centres of surface and
    cloud; `(count, ...)`.

    The centre is a median, which is robust to outliers.
    """
    skeleton = tracker.body.skeleton
    posed = pose_body(tracker.body, pose)
    middle = jnp.median(posed.vertices, 0)
    points = jnp.where((cloud.weights > 0)[:, None], cloud.points, jnp.nan)
    target = jnp.nanmedian(points, 0)
    angles = jnp.linspace(0.0, 2 * jnp.pi, count, endpoint=False).astype(middle.dtype)
    # a root that only translates has its rotations in the first joint below it
    turner = next((j for j, kind in enumerate(skeleton.kinds) if kind in ("ball", "free")), None)
    mover = next((j for j, kind in enumerate(skeleton.kinds) if kind in ("translate", "free")), None)

    def turn(angle):
        rotations, translations, moved = pose.rotations, pose.translations, middle
        if turner is not None:
            q = rotation.about_axis(up, angle)
            centre = posed.joints[turner]
            moved = rotation.rotate(q, middle - centre) + centre
            rotations = rotations.at[turner].set(rotation.multiply(q, rotations[turner]))
        if mover is not None:
            translations = translations.at[mover].add((target - moved) / pose.scale)
        return Pose(translations, rotations, pose.scale)

    return jax.vmap(turn)(angles)


@eqx.filter_jit
def perturbed_starts(
    skeleton: Skeleton, poses: Pose, count: int, deviations: Float[Array, "D"], key: PRNGKeyArray
) -> Pose:
    """Sample `count` random neighbours of each of P stacked poses, and keep the poses themselves; `(P *
    (count + 1), ...)`.
    """
    num = poses.rotations.shape[0]
    steps = deviations * jax.random.normal(key, (count, num, skeleton.num_dofs), poses.rotations.dtype)
    return _neighbours(skeleton, poses, steps)


@eqx.filter_jit
def subtree_starts(
    skeleton: Skeleton,
    poses: Pose,
    count: int,
    deviations: Float[Array, "D"],
    key: PRNGKeyArray,
    unsupported: Float[Array, "P J"] | None = None,
) -> Pose:
    """Sample neighbours as `perturbed_starts` does, but each moves one random joint and its descendants.

    A lost limb is found again while the rest of the body stays. With the `unsupported` shares of each pose
    (`unsupported_shares`), a joint is chosen the more often the less its surface is supported.
    """
    num = poses.rotations.shape[0]
    which, how = jax.random.split(key)
    below_root = np.array(skeleton.parents) >= 0
    bearers = np.flatnonzero((skeleton.descendants.sum(1) > 1) & below_root)
    bearers = bearers if bearers.size else np.arange(skeleton.num_joints)
    shares = jnp.zeros((num, skeleton.num_joints)) if unsupported is None else unsupported
    odds = jnp.log(shares[:, bearers] + UNIFORM_SHARE)
    joints = jnp.asarray(bearers)[jax.random.categorical(which, odds, axis=1, shape=(count, num))]
    below = jnp.asarray(skeleton.descendants)[joints][..., dof_layout(skeleton).joints]
    near, far = jax.random.split(how)
    steps = deviations * jax.random.normal(near, (count, num, skeleton.num_dofs), poses.rotations.dtype)
    # some steps small, some large enough to turn a hand over
    size = 2.0 ** jax.random.uniform(far, (count, num, 1), poses.rotations.dtype, 0.0, 3.0)
    return _neighbours(skeleton, poses, jnp.where(below, size * steps, 0.0))


def unsupported_shares(tracker: Tracker, poses: Pose, cloud: Cloud) -> Float[Array, "P J"]:
    """Compute, for each joint of P stacked poses, the share of the surface below it that has no point with a similar normal
    within `SUPPORT_RADIUS`; zero normals are similar to all others.

    One by one, so that any number of poses uses one compiled function.
    """
    rows = [take_rows(poses, slice(k, k + 1)) for k in range(poses.rotations.shape[0])]
    return concatenate([_unsupported_shares(tracker, row, cloud) for row in rows])


@eqx.filter_jit
def _unsupported_shares(tracker: Tracker, poses: Pose, cloud: Cloud) -> Float[Array, "P J"]:
    below = jnp.asarray(tracker.body.skeleton.descendants, cloud.points.dtype)
    bones, without_normal = tracker.body.skin.dominant_bones(), ~jnp.any(cloud.normals != 0, 1)

    def of_pose(pose):
        posed = pose_body(tracker.body, pose)
        squared = jnp.sum((posed.vertices[:, None] - cloud.points) ** 2, -1)
        similar = posed.normals @ cloud.normals.T > tracker.mixture.normal_threshold
        supports = (cloud.weights > 0) & (similar | without_normal)
        distances = jnp.min(jnp.where(supports, squared, jnp.inf), 1)
        alone = (distances > SUPPORT_RADIUS**2).astype(below.dtype)
        counts = jnp.stack([alone, jnp.ones_like(alone)], 1)
        sums = jnp.zeros((below.shape[0], 2), below.dtype).at[bones].add(counts)
        missing, total = (below @ sums).T
        return missing / jnp.maximum(total, 1.0)

    return jax.lax.map(of_pose, poses)


def _neighbours(skeleton: Skeleton, poses: Pose, steps: Float[Array, "C P D"]) -> Pose:
    steps = jnp.concatenate([jnp.zeros_like(steps[:1]), steps])
    tiled = jax.tree.map(lambda leaf: jnp.concatenate([leaf] * len(steps)), poses)
    flat = steps.reshape(-1, skeleton.num_dofs)
    return jax.vmap(lambda pose, step: retract(skeleton, pose, step))(tiled, flat)
