"""Charts of a joint's rotation: one angle, two angles, or a quaternion's vector part."""

from typing import Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..geometry import rotation

ChartKind = Literal["hinge", "universal", "ball"]
#: number of used dimensions, of three, of each chart
DIMENSIONS: dict[str, int] = {"hinge": 1, "universal": 2, "ball": 3}
#: largest norm of a vector part; longer ones are shortened, as the chart ends half a turn from the middle
MAX_NORM = 0.9999


class Chart(eqx.Module):
    """Coordinates `(3,)` of a joint's rotation, about half angles in radians from the middle of the joint's
    range (Limits, section 3.2); unused dimensions are zero.

    - `hinge`: half the angle about `axes[0]`, relative to `middle`.
    - `universal`: halves of two Euler angles, `R = middle Rot(axes[0], a) Rot(axes[1], b)`.
    - `ball`: the vector part of `middle^-1 R` as a quaternion with positive scalar. It is discontinuous
      half a turn from the middle, so ranges must not reach there.
    """

    middle: Float[Array, "4"]
    #: unit axes of hinges (the first) and universal joints (both), rest frame of the world
    axes: Float[Array, "2 3"]
    kind: ChartKind = eqx.field(static=True)

    @property
    def dimension(self) -> int:
        return DIMENSIONS[self.kind]

    def coordinates(self, quaternion: Float[Array, "4"]) -> Float[Array, "3"]:
        """Compute the coordinates of a rotation; of a rotation that the joint's kind does not allow, those
        of its allowed part."""
        relative = rotation.multiply(rotation.conjugate(self.middle), quaternion)
        if self.kind == "ball":
            return jnp.where(relative[0] < 0, -relative[1:], relative[1:])
        if self.kind == "hinge":
            return jnp.zeros(3, quaternion.dtype).at[0].set(rotation.angle_about(relative, self.axes[0]) / 2)
        return jnp.append(rotation.angles_about(relative, *self.axes) / 2, jnp.zeros((), quaternion.dtype))

    def rotation(self, point: Float[Array, "3"]) -> Float[Array, "4"]:
        """Compute the rotation at coordinates: `coordinates(rotation(x)) = x` within the chart."""
        if self.kind == "ball":
            squared = jnp.sum(point**2)
            long = squared > MAX_NORM**2
            length = jnp.sqrt(jnp.where(long, squared, 1.0))
            point = jnp.where(long, point * MAX_NORM / length, point)
            relative = jnp.append(jnp.sqrt(1.0 - jnp.sum(point**2)), point)
        else:
            relative = rotation.about_axis(self.axes[0], 2 * point[0])
            if self.kind == "universal":
                relative = rotation.multiply(relative, rotation.about_axis(self.axes[1], 2 * point[1]))
        return rotation.normalise(rotation.multiply(self.middle, relative))

    def squared_distance(self, a: Float[Array, "3"], b: Float[Array, "3"]) -> Float[Array, ""]:
        """Compute about the square of half the angle between two rotations, from their coordinates.

        For quaternions it is `sin^2` of that half angle, which is the same for `q` and `-q`.
        """
        if self.kind != "ball":
            return jnp.sum((a - self.unwrap(b, a)) ** 2)
        scalars = jnp.sqrt(jnp.maximum(1.0 - jnp.sum(a**2), 1e-12)) * jnp.sqrt(
            jnp.maximum(1.0 - jnp.sum(b**2), 1e-12)
        )
        # |a - b|^2 on the sphere, with less cancellation than 1 - (a . b)^2
        cosine = scalars + jnp.sum(a * b)
        return 1.0 - cosine**2

    def unwrap(self, point: Float[Array, "3"], reference: Float[Array, "3"]) -> Float[Array, "3"]:
        """Add whole turns to the angles of `point` so that it is closest to `reference`."""
        if self.kind == "ball":
            return point
        return reference + (point - reference + jnp.pi / 2) % jnp.pi - jnp.pi / 2
