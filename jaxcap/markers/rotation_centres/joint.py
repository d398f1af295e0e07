"""A joint between two segments: its position in both, and its precision."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class Joint(NamedTuple):
    """The common point of two segments, or their common axis at a hinge.

    Positions are in the segments' own frames, metres. Along a direction that the data do not determine the
    centre is at its prior, and has the prior's standard deviation.
    """

    parent: int
    child: int
    in_parent: Float[np.ndarray, "3"]
    in_child: Float[np.ndarray, "3"]
    #: unit axis of a hinge in both frames; None at a ball joint
    axis_in_parent: Float[np.ndarray, "3"] | None
    axis_in_child: Float[np.ndarray, "3"] | None
    #: root mean square distance between the centre as the two segments carry it, metres
    residual: float
    #: standard deviations of the centre along `directions`, metres, ascending
    deviations: Float[np.ndarray, "3"]
    #: unit directions in the parent's frame, one a row
    directions: Float[np.ndarray, "3 3"]
    #: bound on the precision from the swept arc, metres (Silaghi et al. 1998)
    arc_bound: float
    #: the largest arc about the centre, radians
    swept_angle: float
    method: str

    def flipped(self, rotation: Float[np.ndarray, "3 3"]) -> "Joint":
        """Exchange parent and child.

        `rotation` maps the old parent's frame to the old child's. It rotates the directions of the
        precision.
        """
        return self._replace(
            parent=self.child,
            child=self.parent,
            in_parent=self.in_child,
            in_child=self.in_parent,
            axis_in_parent=self.axis_in_child,
            axis_in_child=self.axis_in_parent,
            directions=self.directions @ rotation.T,
        )
