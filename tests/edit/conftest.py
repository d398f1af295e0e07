"""Bodies of several tests of editing."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxcap as jc


@pytest.fixture(scope="module")
def arm() -> jc.Body:
    """Three ball joints a third of a metre apart along x, and a rigid triangle at the end of each bone."""
    skeleton = jc.make_skeleton(
        ("shoulder", "elbow", "wrist"),
        (-1, 0, 1),
        ("ball", "ball", "ball"),
        [[0.0, 0, 0], [1 / 3, 0, 0], [2 / 3, 0, 0]],
    )
    triangle = np.array([[0, 0, 0], [-0.02, 0.01, 0], [-0.02, -0.01, 0]])
    vertices = np.concatenate([triangle + [x, 0, 0] for x in (1 / 3, 2 / 3, 1.0)])
    bones = jnp.repeat(jnp.arange(3), 3)
    return jc.Body(skeleton, jc.body.RigidSkin(bones), jnp.asarray(vertices), jnp.arange(9).reshape(3, 3))
