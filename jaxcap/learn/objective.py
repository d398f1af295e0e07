"""What learning minimises: how far a posed body is from registered meshes, and from their shape."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..body.body import Body
from ..body.kinematics import forward_kinematics
from ..body.pose import Pose
from ..geometry.laplacian import Conformance, energy


def deform(body: Body, pose: Pose) -> Float[Array, "V 3"]:
    """The vertices of a body in a pose, metres."""
    transforms = forward_kinematics(body.skeleton, pose)
    return body.skin.deform(body.vertices, body.skeleton, pose, transforms)


@eqx.filter_jit
def deform_all(body: Body, poses: Pose) -> Float[Array, "F V 3"]:
    """The vertices of a body in every pose of a stack, metres."""
    return jax.lax.map(lambda pose: deform(body, pose), poses)


@eqx.filter_jit
def objective(
    body: Body, poses: Pose, targets: Float[Array, "F V 3"], metric: Conformance
) -> Float[Array, ""]:
    """`Q = sum |x - T(v)|^2 + alpha |L(x - T(v))|^2` over all meshes (Adaptation, eq. 3.19)."""

    def of_frame(frame):
        pose, target = frame
        return energy(metric, target - deform(body, pose))

    return jnp.sum(jax.lax.map(of_frame, (poses, targets)))
