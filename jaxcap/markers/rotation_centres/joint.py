"""A joint between two segments: where it is in both, how well that is known, and by what."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class Joint(NamedTuple):
    """The common point of two segments, or the common line where they turn about a hinge.

    Places are in the segments' own frames, metres. Along a direction that the data do not tell the
    centre is where its prior is, and the standard deviation says so.
    """

    parent: int
    child: int
    in_parent: Float[np.ndarray, "3"]
    in_child: Float[np.ndarray, "3"]
    #: unit axis of a hinge, in both frames; none of a ball
    axis_in_parent: Float[np.ndarray, "3"] | None
    axis_in_child: Float[np.ndarray, "3"] | None
    #: root mean square distance of the centre as the two segments carry it, metres
    residual: float
    #: standard deviations of the centre along `directions`, metres, least first
    precision: Float[np.ndarray, "3"]
    #: unit directions in the parent's frame, one a row
    directions: Float[np.ndarray, "3 3"]
    #: the bound on the precision by the arc that was swept, metres (Silaghi et al. 1998)
    bound: float
    #: the largest arc about the centre, radians
    swept: float
    method: str

    def flipped(self, rotation: Float[np.ndarray, "3 3"]) -> "Joint":
        """The same joint with parent and child exchanged; `rotation` is how the old parent's frame lies
        in the old child's, about which the directions of the precision are turned."""
        return self._replace(
            parent=self.child,
            child=self.parent,
            in_parent=self.in_child,
            in_child=self.in_parent,
            axis_in_parent=self.axis_in_child,
            axis_in_child=self.axis_in_parent,
            directions=self.directions @ rotation.T,
        )
