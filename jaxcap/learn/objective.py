"""The objective of learning: distances of a posed body from registered meshes, and a Laplacian term."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..body.body import Body, pose_body
from ..body.pose import Pose
from ..energy.energy import AbstractEnergy
from ..geometry.laplacian import Conformance, energy


@eqx.filter_jit
def objective(
    body: Body,
    poses: Pose,
    targets: Float[Array, "F V 3"],
    metric: Conformance,
    terms: AbstractEnergy | None = None,
) -> Float[Array, ""]:
    """Evaluate `Q = sum |x - T(v)|^2 + alpha |L(x - T(v))|^2` over all meshes (Adaptation, eq. 3.19).

    Energies `terms` of the posed body add their sums of squares.
    """

    def of_frame(frame):
        pose, target = frame
        posed = pose_body(body, pose)
        value = energy(metric, target - posed.vertices)
        if terms is None:
            return value
        r = terms.residual(posed)
        return value + r @ r

    return jnp.sum(jax.lax.map(of_frame, (poses, targets)))
