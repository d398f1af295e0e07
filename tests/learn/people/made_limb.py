"""A limb of any length and radius, made for tests of learning."""

import jax.numpy as jnp
import numpy as np

import jaxcap as jc
from jaxcap.body.skin import LinearSkin, RigidSkin, SwingTwistSkin

SIDES, RINGS = 8, 17


def tube(length: float = 1.0, radius: float = 0.06) -> tuple[np.ndarray, np.ndarray]:
    """A tube along x with a flattened end, so that its twist is visible."""
    rings, sides = np.meshgrid(np.arange(RINGS), np.arange(SIDES), indexing="ij")
    angle = 2 * np.pi * sides / SIDES
    points = np.stack(
        [length * rings / (RINGS - 1), 1.3 * radius * np.cos(angle), radius * np.sin(angle)], -1
    )
    a, b = (rings[:-1] * SIDES + sides[:-1]).ravel(), (rings[:-1] * SIDES + (sides[:-1] + 1) % SIDES).ravel()
    return points.reshape(-1, 3), np.concatenate(
        [np.stack([a, b, a + SIDES], 1), np.stack([b, b + SIDES, a + SIDES], 1)]
    )


def limb(length: float = 1.0, radius: float = 0.06, skin: str = "linear") -> jc.Body:
    """A tube over a chain of three bones: the same weights for every length and radius, joints that move with the length."""
    vertices, faces = tube(length, radius)
    centres = [[0.02 * length, 0, 0], [0.35 * length, 0, 0], [0.7 * length, 0, 0]]
    skeleton = jc.make_skeleton(["root", "middle", "end"], [-1, 0, 1], ["free", "ball", "ball"], centres)
    ramp = np.clip((vertices[:, :1] / length - np.array([0.35, 0.7])) / 0.2 + 0.5, 0, 1)
    part = (ramp > 0.5).sum(1)
    weights = np.stack([1 - ramp[:, 0], ramp[:, 0] - ramp[:, 1], ramp[:, 1]], 1)
    skins = {
        "linear": lambda: LinearSkin(jnp.asarray(weights)),
        "start": lambda: LinearSkin(jnp.asarray(np.eye(3)[part])),
        "rigid": lambda: RigidSkin(jnp.asarray(part)),
        "swing_twist": lambda: SwingTwistSkin(
            jnp.asarray(part), jnp.zeros((len(vertices), 3)), jnp.zeros((len(vertices), 3))
        ),
    }
    return jc.Body(skeleton, skins[skin](), jnp.asarray(vertices), jnp.asarray(faces))
