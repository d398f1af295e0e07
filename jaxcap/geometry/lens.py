"""Distortion of images by lenses."""

from typing import Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..arguments import as_jax_array, check_fields, checked
from ..errors import InputError

#: coefficients of each model, in OpenCV's order
NUM_COEFFICIENTS = {"brown_conrady": 8, "kannala_brandt": 4}
#: largest tangent of an angle to the optical axis, and number of them, by which the range of a lens is found
MAX_RADIUS, NUM_RADII = 5.5, 2401


class Lens(eqx.Module):
    """The distortion of a camera's images, with the models and the order of coefficients of OpenCV.

    `brown_conrady` (Brown 1966, with the rational radial term) has `k1, k2, p1, p2, k3, k4, k5, k6`, and zeros for those
    that a calibration does not have; `kannala_brandt` (Kannala and Brandt 2006, OpenCV's `fisheye`) has `k1, k2, k3, k4`.
    """

    coefficients: Float[Array, "K"] = eqx.field(converter=as_jax_array)
    model: Literal["brown_conrady", "kannala_brandt"] = eqx.field(static=True, default="brown_conrady")

    def __check_init__(self):
        check_fields(self)
        count = NUM_COEFFICIENTS.get(self.model)
        if count is None or self.coefficients.shape != (count,):
            raise InputError(
                f"Lens: the model '{self.model}' has {self.coefficients.shape[0]} coefficients; expected "
                + " or ".join(f"{n} for {name}" for name, n in NUM_COEFFICIENTS.items())
                + "."
            )


@checked
def distort(lens: Lens, rays: Float[Array, "*rays 2"]) -> Float[Array, "*rays 2"]:
    """Distort the directions of rays: `(x / z, y / z)` without the lens to that with it, as in the image."""
    squared = jnp.sum(rays**2, -1, keepdims=True)
    c = lens.coefficients
    if lens.model == "kannala_brandt":
        return rays * _angle_ratio(c, squared)
    k1, k2, p1, p2, k3, k4, k5, k6 = c
    numerator = 1 + squared * (k1 + squared * (k2 + squared * k3))
    denominator = 1 + squared * (k4 + squared * (k5 + squared * k6))
    product = 2 * rays[..., :1] * rays[..., 1:]
    tangential = jnp.array([p1, p2]) * product + jnp.array([p2, p1]) * (squared + 2 * rays**2)
    return rays * (numerator / denominator) + tangential


def _angle_ratio(c: Float[Array, "4"], squared: Float[Array, "*rays 1"]) -> Float[Array, "*rays 1"]:
    """Divide the distorted angle of fisheye lenses by the tangent of the angle; 1 on the axis, smoothly."""
    safe = jnp.where(squared > 1e-12, squared, 1.0)
    angle = jnp.arctan(jnp.sqrt(safe))
    s = angle**2
    bent = angle * (1 + s * (c[0] + s * (c[1] + s * (c[2] + s * c[3]))))
    return jnp.where(squared > 1e-12, bent / jnp.sqrt(safe), 1.0)


def largest_radius(lens: Lens) -> Float[Array, ""]:
    """Find the tangent of the angle up to which the distorted radius grows with the radius: rays beyond have no pixel."""
    radii = jnp.linspace(0.0, MAX_RADIUS, NUM_RADII)
    along = Lens(lens.coefficients.at[2:4].set(0.0), lens.model) if lens.model == "brown_conrady" else lens
    bent = distort(along, jnp.stack([radii, jnp.zeros_like(radii)], -1))[:, 0]
    falling = jnp.diff(bent) <= 0
    return jnp.where(falling.any(), radii[jnp.argmax(falling)], MAX_RADIUS)
