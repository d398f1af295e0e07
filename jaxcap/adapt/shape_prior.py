"""The shape around every vertex, as training meshes show it: Laplacian vectors."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..body.body import Body, deform_all
from ..body.kinematics import forward_kinematics
from ..body.pose import Pose
from ..geometry.laplacian import laplacian, make_conformance


class LaplacianVectors(eqx.Module):
    """What training meshes show around every vertex, as vectors from the mean of its neighbours
    (Adaptation, eq. 4.2), metres.

    Mean and spread are of vectors turned back to rest with the bones that carry each vertex, as
    vectors of different poses point everywhere.
    """

    mean: Float[Array, "V 3"]
    #: root mean square distance from the mean
    spread: Float[Array, "V"]
    #: those of each mesh as it stands, in the world, where they were kept
    vectors: Float[Array, "M V 3"] | None


def laplacian_vectors(
    body: Body, poses: Pose, meshes: Float[Array, "M V 3"] | None = None, keep: bool = False
) -> LaplacianVectors:
    """Uniform Laplacian vectors of meshes registered to a body, `L(v) = v - mean of its neighbours`
    (Adaptation, eq. 4.2).

    **Arguments:** `poses`, those of the body in each mesh, stacked; `meshes`, metres, the body itself in
    the poses where not given; `keep`, to have all M vectors of each vertex too.

    **Raises:** `ValueError` where there is no mesh, there are other numbers of meshes than of poses, or
    of vertices than the body has.
    """
    count = len(poses.rotations) if poses.rotations.ndim == 3 else 0
    if not count:
        raise ValueError("There are no poses of training meshes; give them stacked over frames.")
    meshes = deform_all(body, poses) if meshes is None else meshes
    if meshes.shape[:2] != (count, len(body.vertices)):
        raise ValueError(
            f"There are {meshes.shape[0]} meshes of {meshes.shape[1]} vertices for {count} poses of a body of "
            f"{len(body.vertices)}; register them to the body."
        )
    metric = make_conformance(np.asarray(body.faces), len(body.vertices), 0.0)
    vectors = _of_each(metric, jnp.asarray(meshes))
    resting = _turned_back(body, poses, vectors)
    mean = jnp.mean(resting, 0)
    spread = jnp.sqrt(jnp.mean(jnp.sum((resting - mean) ** 2, -1), 0))
    return LaplacianVectors(mean, spread, vectors if keep else None)


@eqx.filter_jit
def _of_each(metric, meshes):
    return jax.lax.map(lambda mesh: laplacian(metric, mesh), meshes)


@eqx.filter_jit
def _turned_back(body: Body, poses: Pose, vectors):
    """Vectors carried from each pose back to rest, by the mean rotation of each vertex's bones."""
    influence = body.skin.influence(body.skeleton.num_joints)

    def back(pair):
        pose, own = pair
        turns = forward_kinematics(body.skeleton, pose).rotations / pose.scale
        left, _, right = jnp.linalg.svd(jnp.einsum("vb,bij->vij", influence, turns))
        # the rotation nearest to the mean: a reflection has its last axis turned over
        sign = jnp.linalg.det(left @ right)
        nearest = (left * jnp.stack([jnp.ones_like(sign), jnp.ones_like(sign), sign], -1)[:, None]) @ right
        return jnp.einsum("vji,vj->vi", nearest, own) / pose.scale

    return jax.lax.map(back, (poses, vectors))
