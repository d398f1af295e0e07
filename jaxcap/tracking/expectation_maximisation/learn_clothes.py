"""Learning of clothes from the frames of a sequence."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...body.body import Posed
from ...observe.clouds import Cloud
from .clothes import FIRST_SHARE, Clothes, body_size
from .e_step import Posterior

#: bounds of the shares, and of offsets and deviations as shares of the body's size (3 to 17 cm; 1.5 to 10 cm of a person)
SHARES, OFFSETS, DEVIATIONS = (0.01, 0.95), (0.017, 0.1), (0.009, 0.06)
#: least weight of a new frame; number of points that count as much as the initial share of a part
MIN_RATE, PSEUDO_COUNT = 0.2, 20.0


@jax.default_matmul_precision("highest")
def update_clothes(
    clothes: Clothes, found: Posterior, posed: Posed, cloud: Cloud, sigma: Float[Array, ""]
) -> Clothes:
    """Average the clothes of each part over frames with those of largest expected likelihood in this one.

    A frame counts less where `sigma`, the standard deviation of the skin's points in metres, blurs the clothes.

    **Arguments:** `found` at the pose before the step of EM, with the clothes' posterior; `posed` after it.
    """
    count, size = len(clothes.share), body_size(posed.body) * posed.pose.scale
    parts, vertices = found.parts[:, 0], found.vertices[:, 0]
    away = cloud.points - posed.vertices[vertices]
    outwards = jnp.sum(away * posed.normals[vertices], 1)

    # a displaced limb has as many points inside of it as outside, and clothes none
    own = cloud.weights * jnp.where(outwards > 0, found.possible_clothes, 0.0)
    within = cloud.weights * jnp.where(outwards < 0, found.possible_clothes, 0.0)

    def of_part(values):
        return jnp.zeros(count, values.dtype).at[parts].add(values)

    outside = of_part(own)
    total = jnp.maximum(outside - of_part(within), 0.0)
    skin = jnp.zeros_like(total).at[found.parts].add(cloud.weights[:, None] * found.weights)
    share = (total + PSEUDO_COUNT * FIRST_SHARE) / (total + skin + PSEUDO_COUNT)
    # parts without points in clothes keep their offsets
    sharp = clothes.deviation**2 / (clothes.deviation**2 + sigma**2)
    step = sharp * jnp.maximum(1.0 / (clothes.frames + 2.0), MIN_RATE)
    rate = step * total / (total + PSEUDO_COUNT)
    mean = of_part(own * outwards) / jnp.maximum(outside, 1e-9)
    offset = clothes.offset + rate * (mean - clothes.offset)
    offset = jnp.clip(offset, OFFSETS[0] * size, OFFSETS[1] * size)
    squared = jnp.sum(away**2, 1) + offset[parts] * (offset[parts] - 2.0 * outwards)
    variance = of_part(own * squared) / jnp.maximum(3.0 * outside, 1e-9) - sigma**2
    spread = jnp.sqrt(jnp.maximum(variance, 0.0))
    deviation = clothes.deviation + rate * (spread - clothes.deviation)
    return Clothes(
        jnp.clip(clothes.share + step * (share - clothes.share), *SHARES),
        offset,
        jnp.clip(deviation, DEVIATIONS[0] * size, DEVIATIONS[1] * size),
        clothes.frames + 1.0,
    )
