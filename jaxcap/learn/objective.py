"""The objective of learning: distances of a posed body from registered meshes, and a Laplacian term."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..body.body import Body, pose_body
from ..body.pose import Pose
from ..energy.energy import AbstractEnergy, weighted
from ..geometry.laplacian import Conformance, energy

#: the weight of a unit of a user's energy for each vertex, metres squared
UNIT = 1e-3**2


def in_units_of_vertices(terms: AbstractEnergy | None, num_vertices: int) -> AbstractEnergy | None:
    """Scale a user's energies: one unit then weighs as much as a mean vertex error of a millimetre."""
    return None if terms is None else weighted(UNIT * num_vertices, terms)


@eqx.filter_jit
def objective(
    body: Body,
    poses: Pose,
    targets: Float[Array, "F V 3"],
    metric: Conformance,
    terms: AbstractEnergy | None = None,
    frame_weights: Float[Array, "F"] | None = None,
) -> Float[Array, ""]:
    """Evaluate `Q = sum |x - T(v)|^2 + alpha |L(x - T(v))|^2` over all meshes (Adaptation, eq. 3.19).

    Energies `terms` of the posed body add their sums of squares. `frame_weights` are factors of the distances of each mesh, one
    where not given.
    """

    def of_frame(frame):
        pose, target, weight = frame
        posed = pose_body(body, pose)
        value = weight * energy(metric, target - posed.vertices)
        if terms is None:
            return value
        r = terms.residual(posed)
        return value + r @ r

    weights = jnp.ones(len(targets), targets.dtype) if frame_weights is None else frame_weights
    return jnp.sum(jax.lax.map(of_frame, (poses, targets, weights)))
