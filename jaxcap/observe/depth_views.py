"""Depth images of one camera, with the pixels that belong to the person."""

import equinox as eqx
from jaxtyping import Array, Float

from ..arguments import as_jax_array, check_fields
from ..geometry.camera import Camera


class DepthView(eqx.Module):
    """A depth image of one frame, divided into the person and measured background.

    Images are `(height, width)` of the camera.
    """

    camera: Camera
    #: depth of the measured surface along the optical axis, metres; zero where nothing was measured
    depth: Float[Array, "*frames H W"] = eqx.field(converter=as_jax_array)
    #: rising depths, of which the last is that of the person's farthest pixel, metres
    levels: Float[Array, "*frames L"] = eqx.field(converter=as_jax_array)
    #: distance to the nearest pixel of the person that is not farther than each level, pixels
    distances: Float[Array, "*frames L H W"] = eqx.field(converter=as_jax_array)

    def __check_init__(self):
        check_fields(self)
