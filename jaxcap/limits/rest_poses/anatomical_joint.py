"""A joint by its anatomical name and axes, and rotations from one skeleton's rest pose to another's.

`A^T R B` is the rotation of the distal segment relative to the proximal one, for the rotation `R` of a joint from
rest, the axes `A` of the proximal segment and `B` of the distal one at rest. It does not depend on the rest pose.
"""

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ...arguments import check_fields, checked

#: the mirror image of a rotation between anatomical axes, of which Z points to the right
_MIRROR = np.diag([1.0, 1.0, -1.0])


class AnatomicalJoint(eqx.Module):
    """A joint of a person: what it is, and the axes of the segments that it connects, for the skeleton at rest."""

    #: as `knee_r` or `shoulder_l`
    name: str = eqx.field(static=True)
    #: the name in the skeleton
    joint: str = eqx.field(static=True)
    #: columns X forward, Y towards the trunk, Z to the right, in the world
    proximal: Float[Array, "3 3"]
    distal: Float[Array, "3 3"]

    def __check_init__(self):
        check_fields(self)

    @property
    def other_side(self) -> str:
        """The anatomical name of the same joint on the other side."""
        return self.name[:-1] + {"l": "r", "r": "l"}[self.name[-1]]


@checked
def convert_rotations(
    matrices: Float[np.ndarray, "F 3 3"], source: AnatomicalJoint, target: AnatomicalJoint
) -> Float[np.ndarray, "F 3 3"]:
    """Convert rotations of a joint from rest to those from another skeleton's rest pose, with the same pose of the
    segments; they are mirrored between a left and a right joint."""
    of, to = ((np.asarray(each.proximal, float), np.asarray(each.distal, float)) for each in (source, target))
    between = of[0].T @ matrices @ of[1]
    if source.name != target.name:
        between = _MIRROR @ between @ _MIRROR
    return to[0] @ between @ to[1].T


def rest_difference_rotations(
    source: AnatomicalJoint, target: AnatomicalJoint
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3 3"]]:
    """Compute the rotations `L` and `R` for which `L q R` is, from the rest pose of `source`, the rotation that is `q`
    from that of `target`."""
    before = np.asarray(source.proximal, float) @ np.asarray(target.proximal, float).T
    after = np.asarray(target.distal, float) @ np.asarray(source.distal, float).T
    return before, after
