"""Limit the number of bones that influence a vertex."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ...arguments import checked
from ...body.body import Body
from ...body.influences import strongest_weights
from ...body.skin import LinearSkin


@checked
def limit_influences(body: Body, max_influences: int = 4) -> Body:
    """Keep the `max_influences` strongest bones of each vertex and renormalise their weights.

    Compare `pose_body` of both bodies to measure the change of the surface.

    **Raises:** `ValueError` if `max_influences` is not positive or the skin does not blend linearly.
    """
    if max_influences < 1:
        raise ValueError(f"The number of influences is {max_influences}; expected at least 1.")
    if not isinstance(body.skin, LinearSkin):
        raise ValueError(
            f"The body has a {type(body.skin).__name__}, and only a LinearSkin can have limited influences; "
            "convert the body by `jaxcap.edit.to_linear_blend`."
        )
    weights = strongest_weights(np.asarray(body.skin.weights), max_influences)
    return eqx.tree_at(lambda b: b.skin, body, LinearSkin(jnp.asarray(weights)))
