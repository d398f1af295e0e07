"""Preservation of surface shape: Laplacian vectors of a posed body compared with those of a mesh."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...arguments import checked
from ...body.body import Body, Posed
from ...geometry.laplacian import Conformance, laplacian, make_conformance
from ..energy import AbstractEnergy


class LaplacianShape(AbstractEnergy):
    """Mean squared difference of the Laplacian vectors of the posed surface from those of a mesh, metres
    squared.

    The Laplacian vector of a vertex is its offset from the mean of its neighbours (Adaptation, eq. 4.12 for
    one mesh).
    """

    metric: Conformance
    vectors: Float[Array, "V 3"]

    def residual(self, posed: Posed) -> Float[Array, "R"]:
        differences = laplacian(self.metric, posed.vertices) - self.vectors
        return differences.reshape(-1) / jnp.sqrt(jnp.asarray(len(differences), differences.dtype))


@checked
def make_laplacian_shape(body: Body, mesh: Float[np.ndarray, "V 3"]) -> LaplacianShape:
    """Make the shape energy of a mesh registered to a body, in the mesh's own pose; metres.

    **Raises:** `ValueError` where it has another number of vertices than the body.
    """
    if mesh.shape != body.vertices.shape:
        raise ValueError(
            f"The mesh has shape {mesh.shape} and the body has {len(body.vertices)} vertices; register the mesh "
            "to the body."
        )
    metric = make_conformance(np.asarray(body.faces), len(body.vertices), 0.0)
    return LaplacianShape(metric, laplacian(metric, jnp.asarray(mesh, body.vertices.dtype)))
