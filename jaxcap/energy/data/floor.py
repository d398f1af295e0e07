"""A floor that a body stands on and does not penetrate."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...arguments import check_fields, checked
from ...body.body import Body, Posed
from ...geometry.sampling import even_indices
from ...observe.planes import Plane
from ...value_checks import check_deviations, check_direction, check_values
from .vertices import AbstractVertexEnergy

#: numbers of tested vertices: the lowest at rest, and others spread over the surface
NUM_LOWEST, NUM_SPREAD = 100, 200
#: standard deviation of vertices below a floor that a sensor measured, metres
MEASURED_DEVIATION = 0.02


class Floor(AbstractVertexEnergy):
    """Penetration of vertices below a plane, in standard deviations; zero above it.

    The plane is `up . x = height`.
    """

    vertices: Int[Array, "C"]
    up: Float[Array, "3"]
    #: metres
    height: Float[Array, ""]
    #: standard deviation of the penetration, metres
    deviation: Float[Array, ""]

    def __check_init__(self):
        check_fields(self)
        check_direction("Floor", up=self.up)
        check_deviations("Floor", deviation=self.deviation)

    def residual(self, posed: Posed) -> Float[Array, "C"]:
        return jnp.minimum(self._heights(posed), 0.0) / self.deviation

    def vertex_jacobian(self, posed: Posed):
        below = self._heights(posed) < 0
        return self.vertices, jnp.where(below[:, None, None], self.up, 0.0) / self.deviation

    def _heights(self, posed: Posed) -> Float[Array, "C"]:
        return posed.vertices[self.vertices] @ self.up - self.height


@checked
def make_floor(
    body: Body,
    height: float | Float[Array, ""] = 0.0,
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
    deviation: float | Float[Array, ""] = 0.01,
) -> Floor:
    """Make the floor of a body, tested at its lowest vertices at rest and some others.

    **Arguments:** `height` of the floor along `up`, a vector of any length, metres; `deviation`, the standard
    deviation of the penetration, metres.

    **Raises:** `InputError` where `up` has no direction, the height is not finite or the deviation is not
    above zero.
    """
    check_direction("make_floor", up=up)
    check_values("make_floor", np.isfinite, "a finite number of metres", height=height)
    check_deviations("make_floor", deviation=deviation)
    vertical = np.asarray(up, float) / np.linalg.norm(up)
    heights, dtype = np.asarray(body.vertices, float) @ vertical, body.vertices.dtype
    lowest = np.argsort(heights, kind="stable")[:NUM_LOWEST]
    others = even_indices(len(heights), NUM_SPREAD)
    rows = np.union1d(lowest, others)
    numbers = (jnp.asarray(number, dtype) for number in (vertical, height, deviation))
    return Floor(jnp.asarray(rows, jnp.int32), *numbers)


@checked
def make_measured_floor(body: Body, plane: Plane) -> Floor:
    """Make the floor of a body from a plane that was found in measurements, with a standard deviation of 20 mm."""
    return make_floor(body, plane.offset, tuple(plane.normal.tolist()), MEASURED_DEVIATION)
